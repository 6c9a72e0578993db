"""Log and the Jacobians of Exp for the few rotations of one frame.

The same functions as in `mocap.orientation`, for finite input alone and with fewer calls of numpy and scipy,
whose overhead is all that they cost at this size: a third of the time, ten times a frame.
"""

from __future__ import annotations

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array

# In place of an angle of zero. No series is needed for small angles: a quotient that loses digits there
# is multiplied by the square of the angle.
SMALLEST = 1e-30
_EYE = np.eye(3)
_HAT = ori.hat(_EYE).reshape(3, 9)  # hat(v) = v @ _HAT, row by row
# Of a matrix, row by row: the vector of R - R^T, which is 2 sin(t) times the axis, and the trace.
_SINE_AND_TRACE = np.column_stack([_HAT.T, _EYE.ravel()])


def hat(v: Array) -> Array:
    """Skew matrices (...,3,3) of vectors (...,3), hat(v) u = v x u."""
    return (v @ _HAT).reshape(*v.shape, 3)


def norm(v: Array) -> Array:
    """|v| (...) of vectors (...,3)."""
    return np.sqrt(np.vecdot(v, v))


def log(R: Array) -> Array:
    """Rotation vectors (...,3) rad, norm at most pi, of rotation matrices (...,3,3): Log(R).

    t = atan2(2 sin t, 2 cos t), where 2 cos t = trace - 1; the axis is that of R - R^T.
    """
    values = R.reshape(-1, 9) @ _SINE_AND_TRACE
    v, cosine = values[:, :3], values[:, 3] - 1
    if cosine.min(initial=2.0) < -1.8:  # near a half turn R - R^T vanishes and says no axis
        return ori.log(R)
    sine = norm(v)
    return (v * (np.arctan2(sine, cosine) / np.maximum(sine, SMALLEST))[:, None]).reshape(
        R.shape[:-1]
    )


def right_jacobian(w: Array) -> Array:
    """J_r(w) (...,3,3): Exp(w + d) = Exp(w) Exp(J_r(w) d) + O(d^2).

    J_r = I - (1 - cos t)/t^2 hat(w) + (t - sin t)/t^3 hat(w)^2, t = |w|; 1 - cos t = 2 sin^2(t/2).
    """
    t = np.maximum(norm(w), SMALLEST)[..., None, None]
    W = hat(w)
    return _EYE - 2 * (np.sin(t / 2) / t) ** 2 * W + (1 - np.sin(t) / t) / t**2 * (W @ W)


def right_jacobian_inv(w: Array) -> Array:
    """J_r^-1(w) (...,3,3): Log(Exp(w) Exp(d)) = w + J_r^-1(w) d + O(d^2).

    J_r^-1 = I + hat(w)/2 + (1 - t/2 cot(t/2))/t^2 hat(w)^2, t = |w|.
    """
    t = np.maximum(norm(w), SMALLEST)[..., None, None]
    W = hat(w)
    return _EYE + W / 2 + (1 - t / 2 / np.tan(t / 2)) / t**2 * (W @ W)
