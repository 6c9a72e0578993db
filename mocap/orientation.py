"""Rotations as matrices: exponential, logarithm, projection, interpolation.

`R_a_b` maps coordinates in frame b to coordinates in frame a. All functions are vectorised over
leading axes. Quaternions appear only in the conversions at the bottom, for formats and viewers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

# World axes. AMASS and most sensors are z-up, the project is y-up: v_yup = R_YUP_ZUP v_zup, which is
# the transpose of the design's A = [[1,0,0],[0,0,-1],[0,1,0]] (ours to AMASS).
R_ZUP_YUP: Array = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
R_YUP_ZUP: Array = R_ZUP_YUP.T.copy()
# ISB segment axes (x forward, y up, z right) in ours (z forward, y up, x left).
R_OURS_ISB: Array = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
GRAVITY = 9.80665  # m/s^2, along -y


def hat(v: ArrayLike) -> Array:
    """Skew matrix (...,3,3) with hat(v) u = v x u."""
    v = np.asarray(v, float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp(w: ArrayLike) -> Array:
    """Rotation matrix (...,3,3) of a rotation vector (...,3) in rad: Exp(w) (Rodrigues)."""
    w = np.asarray(w, float)
    return Rotation.from_rotvec(w.reshape(-1, 3)).as_matrix().reshape(*w.shape[:-1], 3, 3)


def log(R: ArrayLike) -> Array:
    """Rotation vector (...,3) in rad, norm at most pi, of a rotation matrix (...,3,3): Log(R).

    NaN matrices give NaN vectors.
    """
    R = np.asarray(R, float)
    flat = R.reshape(-1, 3, 3)
    finite = np.isfinite(flat).all(axis=(1, 2))
    out = np.full((len(flat), 3), np.nan)
    if finite.any():
        out[finite] = Rotation.from_matrix(flat[finite], assume_valid=True).as_rotvec()
    return out.reshape(*R.shape[:-2], 3)


def angle(R: ArrayLike) -> Array:
    """Geodesic angle (...) in rad, in [0, pi]: |Log(R)|, exact at zero and at pi."""
    return np.linalg.norm(log(R), axis=-1)


def angle_between(Ra: ArrayLike, Rb: ArrayLike) -> Array:
    """Geodesic distance (...) in rad between rotations (...,3,3): |Log(Ra^T Rb)|."""
    return angle(np.swapaxes(np.asarray(Ra, float), -1, -2) @ np.asarray(Rb, float))


def right_jacobian_inv(w: ArrayLike) -> Array:
    """J_r^-1(w) (...,3,3): Log(Exp(w) Exp(d)) = w + J_r^-1(w) d + O(d^2).

    J_r^-1 = I + hat(w)/2 + (1/t^2 - (1 + cos t)/(2 t sin t)) hat(w)^2, t = |w|.
    """
    w = np.asarray(w, float)
    t = np.linalg.norm(w, axis=-1)
    small = t < 1e-3
    ts = np.where(small, 1.0, t)
    # (1 + cos t) / sin t = cot(t/2) keeps the value finite up to pi.
    c = np.where(small, 1 / 12 + t**2 / 720, 1 / ts**2 - 1 / (2 * ts * np.tan(ts / 2)))
    W = hat(w)
    return np.eye(3) + W / 2 + c[..., None, None] * (W @ W)


def right_jacobian(w: ArrayLike) -> Array:
    """J_r(w) (...,3,3): Exp(w + d) = Exp(w) Exp(J_r(w) d) + O(d^2)."""
    w = np.asarray(w, float)
    t = np.linalg.norm(w, axis=-1)
    small = t < 1e-3
    ts = np.where(small, 1.0, t)
    a = np.where(small, 0.5 - t**2 / 24, (1 - np.cos(ts)) / ts**2)
    b = np.where(small, 1 / 6 - t**2 / 120, (ts - np.sin(ts)) / ts**3)
    W = hat(w)
    return np.eye(3) - a[..., None, None] * W + b[..., None, None] * (W @ W)


def project(M: ArrayLike) -> Array:
    """The rotation nearest to each matrix (...,3,3) in the Frobenius norm (SVD, det +1)."""
    M = np.asarray(M, float)
    U, _, Vt = np.linalg.svd(M)
    d = np.sign(np.linalg.det(U @ Vt))
    U[..., :, 2] *= d[..., None]
    return U @ Vt


def is_rotation(R: ArrayLike, tolerance: float = 1e-3) -> NDArray[np.bool_]:
    """Whether each matrix (...,3,3) is orthonormal with det +1 within `tolerance` (max norm)."""
    R = np.asarray(R, float)
    with np.errstate(invalid="ignore"):
        off = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2))
        return (off <= tolerance) & (np.linalg.det(R) > 0)


def rot_x(a: ArrayLike) -> Array:
    """Rotation (...,3,3) about x by `a` rad."""
    return exp(np.multiply.outer(np.asarray(a, float), [1.0, 0, 0]))


def rot_y(a: ArrayLike) -> Array:
    """Rotation (...,3,3) about y (up, the heading axis) by `a` rad."""
    a = np.asarray(a, float)
    out = np.zeros((*a.shape, 3, 3))
    out[..., 0, 0] = out[..., 2, 2] = np.cos(a)
    out[..., 0, 2] = np.sin(a)
    out[..., 2, 0] = -out[..., 0, 2]
    out[..., 1, 1] = 1
    return out


def rot_z(a: ArrayLike) -> Array:
    """Rotation (...,3,3) about z by `a` rad."""
    return exp(np.multiply.outer(np.asarray(a, float), [0, 0, 1.0]))


def heading(R: ArrayLike) -> Array:
    """Yaw (...) in rad that R_world_x adds about y: the best R_y(a) for R in the Frobenius norm."""
    R = np.asarray(R, float)
    return np.arctan2(R[..., 0, 2] - R[..., 2, 0], R[..., 0, 0] + R[..., 2, 2])


def mean(R: ArrayLike, weights: Array | None = None) -> Array:
    """Chordal mean (3,3) of rotations (N,3,3)."""
    return project(np.average(np.asarray(R, float), axis=0, weights=weights))


def interpolate(times: ArrayLike, R: ArrayLike, at: ArrayLike) -> Array:
    """Rotations (N,...,3,3) at `times` (N,), slerped to times `at` (M,): (M,...,3,3).

    Geodesic interpolation R_k Exp(s Log(R_k^T R_{k+1})). Outside the range the ends hold.
    """
    times, R, at = np.asarray(times, float), np.asarray(R, float), np.asarray(at, float)
    if len(times) == 1:
        return np.repeat(R, len(at), axis=0)
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    s = np.clip((at - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)
    step = log(np.swapaxes(R[k], -1, -2) @ R[k + 1])
    return R[k] @ exp(step * s.reshape(-1, *[1] * (step.ndim - 1)))


def from_quat(q: ArrayLike, scalar_first: bool = True) -> Array:
    """Rotation matrices (...,3,3) of quaternions (...,4), normalised; NaN stays NaN."""
    q = np.asarray(q, float)
    flat = q.reshape(-1, 4)
    ok = np.isfinite(flat).all(axis=1) & (np.linalg.norm(flat, axis=1) > 1e-9)
    out = np.full((len(flat), 3, 3), np.nan)
    if ok.any():
        out[ok] = Rotation.from_quat(flat[ok], scalar_first=scalar_first).as_matrix()
    return out.reshape(*q.shape[:-1], 3, 3)


def to_quat(R: ArrayLike, scalar_first: bool = True) -> Array:
    """Quaternions (...,4) of rotation matrices (...,3,3), scalar part not negative."""
    R = np.asarray(R, float)
    q = Rotation.from_matrix(R.reshape(-1, 3, 3), assume_valid=True)
    return q.as_quat(canonical=True, scalar_first=scalar_first).reshape(*R.shape[:-2], 4)
