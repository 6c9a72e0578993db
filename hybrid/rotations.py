"""Exp, Log and their Jacobians for the few rotations of one frame.

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
# Of 1 + trace, 154 degrees; beyond, R - R^T becomes too small to tell the axis from.
NEAR_HALF_TURN = 0.2
_EYE = np.eye(3)
_HAT = ori.hat(_EYE).reshape(3, 9)  # hat(v) = v @ _HAT, row by row
# R.ravel() @ _QUATERNION: the vector of R - R^T, and the trace.
_QUATERNION = np.column_stack([_HAT.T, _EYE.ravel()])
_ONE = np.array([0.0, 0.0, 0.0, 1.0])


def hat(v: Array) -> Array:
    """Skew matrices (...,3,3) of vectors (...,3), hat(v) u = v x u."""
    return (v @ _HAT).reshape(*v.shape, 3)


def norm(v: Array) -> Array:
    """|v| (...) of vectors (...,n)."""
    return np.sqrt(np.vecdot(v, v))


def quaternion(R: Array) -> Array:
    """Unit quaternions (...,4), scalar last, of rotation matrices (...,3,3).

    The vector of R - R^T and 1 + trace are 4 cos(t/2) (sin(t/2) axis, cos(t/2)).
    """
    q = R.reshape(*R.shape[:-2], 9) @ _QUATERNION + _ONE
    if q[..., 3].min(initial=4.0) < NEAR_HALF_TURN:
        return ori.to_quat(R, scalar_first=False)
    return q / norm(q)[..., None]


def log(R: Array) -> Array:
    """Rotation vectors (...,3) rad, norm at most pi, of rotation matrices (...,3,3): Log(R)."""
    q = quaternion(R)
    v, w = q[..., :3], q[..., 3]
    sine = norm(v)
    return v * (2 * np.arctan2(sine, w) / np.maximum(sine, SMALLEST))[..., None]


def exp(w: Array) -> Array:
    """Rotation matrices (...,3,3) of rotation vectors (...,3) rad: Exp(w).

    I + sin t / t hat(w) + (1 - cos t)/t^2 hat(w)^2, t = |w|; 1 - cos t = 2 sin^2(t/2).
    """
    W = hat(w)
    t = np.maximum(norm(w), SMALLEST)[..., None, None]
    return _EYE + np.sin(t) / t * W + 2 * (np.sin(t / 2) / t) ** 2 * (W @ W)


def right_jacobian(w: Array) -> Array:
    """J_r(w) (...,3,3): Exp(w + d) = Exp(w) Exp(J_r(w) d) + O(d^2).

    J_r = I - (1 - cos t)/t^2 hat(w) + (t - sin t)/t^3 hat(w)^2, t = |w|; 1 - cos t = 2 sin^2(t/2).
    """
    W = hat(w)
    t = np.maximum(norm(w), SMALLEST)[..., None, None]
    return _EYE - 2 * (np.sin(t / 2) / t) ** 2 * W + (1 - np.sin(t) / t) / t**2 * (W @ W)


def right_jacobian_inv(w: Array) -> Array:
    """J_r^-1(w) (...,3,3): Log(Exp(w) Exp(d)) = w + J_r^-1(w) d + O(d^2).

    J_r^-1 = I + hat(w)/2 + (1 - t/2 cot(t/2))/t^2 hat(w)^2, t = |w|.
    """
    W = hat(w)
    half = np.maximum(norm(w), SMALLEST)[..., None, None] / 2
    return _EYE + W / 2 + (1 - half / np.tan(half)) / (4 * half**2) * (W @ W)
