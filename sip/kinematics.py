"""Forward kinematics and rotation algebra as CasADi expressions, from the same `Skeleton` as Pinocchio.

Unknowns of one frame, x in R^n: [p_world_root (3) m, w (3), rotation vectors (3 each) of the active body
joints, rad], with R_world_root = R_ref Exp(w) and R_parent_joint_j = Exp(theta_j). Active joints are those
above a sensor; what no sensor can see follows from the prior (`sip.prior`).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import Skeleton

ROOT_P, ROOT_W, BODY = slice(0, 3), slice(3, 6), slice(6, None)
# Below these squared norms the series is exact to rounding; above, the closed form is.
_EXP_SERIES, _LOG_SERIES, _JACOBIAN_SERIES = 1e-6, 1e-8, 1e-3


def hat(v: Any) -> Any:
    """Skew matrix of a CasADi 3-vector."""
    return ca.skew(v)


def exp(w: Any) -> Any:
    """Exp(w) (3,3), differentiable at zero (Taylor series there)."""
    t2 = ca.dot(w, w)
    small = t2 < _EXP_SERIES
    safe = ca.if_else(small, 1.0, t2)
    t = ca.sqrt(safe)
    a = ca.if_else(small, 1 - t2 / 6 + t2**2 / 120, ca.sin(t) / t)
    b = ca.if_else(small, 0.5 - t2 / 24 + t2**2 / 720, (1 - ca.cos(t)) / safe)
    W = hat(w)
    return ca.SX.eye(3) + a * W + b * (W @ W)


def right_jacobian(w: Any) -> Any:
    """J_r(w): Exp(w + d) = Exp(w) Exp(J_r(w) d) + O(d^2)."""
    t2 = ca.dot(w, w)
    small = t2 < _JACOBIAN_SERIES
    safe = ca.if_else(small, 1.0, t2)
    t = ca.sqrt(safe)
    a = ca.if_else(small, 0.5 - t2 / 24 + t2**2 / 720, (1 - ca.cos(t)) / safe)
    b = ca.if_else(small, 1 / 6 - t2 / 120 + t2**2 / 5040, (t - ca.sin(t)) / (safe * t))
    W = hat(w)
    return ca.SX.eye(3) - a * W + b * (W @ W)


def right_jacobian_inv(w: Any) -> Any:
    """J_r^-1(w): Log(Exp(w) Exp(d)) = w + J_r^-1(w) d + O(d^2); J_l^-1 is its transpose."""
    t2 = ca.dot(w, w)
    small = t2 < _JACOBIAN_SERIES
    safe = ca.if_else(small, 1.0, t2)
    t = ca.sqrt(safe)
    closed = 1 / safe - ca.cos(t / 2) / (2 * t * ca.sin(t / 2))
    c = ca.if_else(small, 1 / 12 + t2 / 720 + t2**2 / 30240, closed)
    W = hat(w)
    return ca.SX.eye(3) + W / 2 + c * (W @ W)


def log(R: Any) -> Any:
    """Log(R) (3,), differentiable at the identity; singular only at a half turn.

    With v = vee(R - R^T)/2 = sin(t) axis and c = (tr R - 1)/2: t = atan2(|v|, c), Log = v t/|v|.
    """
    v = 0.5 * ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    c = 0.5 * (ca.trace(R) - 1)
    s2 = ca.dot(v, v)
    small = s2 < _LOG_SERIES
    s = ca.sqrt(ca.if_else(small, 1.0, s2))
    near = ca.if_else(c > 0, 1 + s2 / 6, np.pi / np.sqrt(_LOG_SERIES))
    return v * ca.if_else(small, near, ca.atan2(s, c) / s)


def forward(
    skeleton: Skeleton, x: Any, R_ref: Any, active: tuple[int, ...]
) -> tuple[dict[int, Any], dict[int, Any]]:
    """R_world_joint and p_world_joint of the root and the active joints, as CasADi expressions.

    active: body joints in the order of their columns of x; the ancestors of each must be among them.
    """
    R: dict[int, Any] = {0: R_ref @ exp(x[ROOT_W])}
    p: dict[int, Any] = {0: x[ROOT_P]}
    for i, j in enumerate(active):
        parent = skeleton.parents[j]
        R[j] = R[parent] @ exp(x[6 + 3 * i : 9 + 3 * i])
        p[j] = p[parent] + R[parent] @ ca.DM(skeleton.offsets[j])
    return R, p


ALL_JOINTS = tuple(range(1, 24))


def numeric_forward(skeleton: Skeleton) -> ca.Function:
    """CasADi function (x (75), R_ref (3,3)) -> R (3, 3*24), p (3, 24): what tests hold against Pinocchio."""
    x, R_ref = ca.SX.sym("x", 75), ca.SX.sym("R_ref", 3, 3)
    R, p = forward(skeleton, x, R_ref, ALL_JOINTS)
    joints = range(24)
    stacked = [ca.horzcat(*[R[j] for j in joints]), ca.horzcat(*[p[j] for j in joints])]
    return ca.Function("forward", [x, R_ref], stacked)


def unpack(
    p_root: Array,
    R_root: Array,
    theta: Array,
    rate_hz: float,
    skeleton: Skeleton,
    start_s: float = 0.0,
) -> Motion:
    """The motion of root positions (T,3) m, root rotations (T,3,3) and all 69 body angles (T,69) rad.

    start_s: time of its first frame in s.
    """
    R = np.empty((len(theta), 24, 3, 3))
    R[:, 0] = R_root
    R[:, 1:] = ori.exp(theta.reshape(-1, 23, 3))
    return Motion(rate_hz, R, p_root, skeleton, start_s)


def recentre(x: Array, R_ref: Array) -> tuple[Array, Array]:
    """The same motion with w = 0: R_ref takes w in, so that w never wraps around."""
    x = x.copy()
    R_ref = ori.project(R_ref @ ori.exp(x[:, ROOT_W]))
    x[:, ROOT_W] = 0
    return x, R_ref
