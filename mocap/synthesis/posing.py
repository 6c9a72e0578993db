"""From a handful of intuitive curves to a motion with planted feet.

A `Score` says where pelvis and toes are and how trunk and arms are held, frame by frame; `pose` solves
the legs for it in closed form (a ball hip and a hinge knee that only bends forward), so that a foot
whose curve stands still stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import TABLE_STATURE, TOES, Skeleton

ARM_DOWN = np.deg2rad(80.0)  # the N-pose of the design: upper arms 80 degrees below the T-pose
COLLAR_SHARE = 0.2  # of an arm raised sideways, the part that the collar turns
SPINE = (3, 6, 9)
HIPS, KNEES, ANKLES = (1, 2), (4, 5), (7, 8)
COLLARS, SHOULDERS, ELBOWS, WRISTS = (13, 14), (16, 17), (18, 19), (20, 21)
SIDES = (1.0, -1.0)  # left, right: the sign that mirrors a rotation about y or z


@dataclass(eq=False)
class Score:
    """Curves over T frames, all zero in the N-pose; lengths in m for a body of `TABLE_STATURE`.

    pelvis (T,3): shift of the pelvis. turn (T,3): rotation vector of the pelvis, rad. toes (T,2,3):
    shift of the left and the right toe joint. heel (T,2): rad, the foot's pitch about the toes, heel up
    positive. bend (T,3): rad, pitch forward, yaw and roll of the trunk, shared by three spine joints.
    nod (T,): rad, the head's pitch forward. raised (T,2): rad, arms raised sideways from the N-pose.
    forward (T,2): rad, arms swung forward. elbow (T,2): rad, elbows flexed.
    """

    t: Array
    rate_hz: float
    pelvis: Array
    turn: Array
    toes: Array
    heel: Array
    bend: Array
    nod: Array
    raised: Array
    forward: Array
    elbow: Array

    @classmethod
    def blank(cls, seconds: float, rate_hz: float) -> Score:
        """The N-pose for `seconds`."""
        T = max(1, round(seconds * rate_hz))
        zeros = [np.zeros((T, *s)) for s in ((3,), (3,), (2, 3), (2,), (3,), (), (2,), (2,), (2,))]
        return cls(np.arange(T) / rate_hz, rate_hz, *zeros)


def step(x: Array | float) -> Array:
    """Smooth step from 0 at x <= 0 to 1 at x >= 1, three continuous derivatives:
    35 x^4 - 84 x^5 + 70 x^6 - 20 x^7."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)


def step_integral(x: Array) -> Array:
    """Integral of `step` from 0 to x."""
    c = np.clip(x, 0.0, 1.0)
    return c**5 * (7 - 14 * c + 10 * c**2 - 2.5 * c**3) + np.maximum(x - 1, 0)


def bump(x: Array) -> Array:
    """256 x^4 (1-x)^4: from 0 at x <= 0 over 1 at x = 1/2 to 0 at x >= 1, three continuous derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return 256 * (x * (1 - x)) ** 4


def plateau(t: Array, start: float, rise: float, end: float) -> Array:
    """0, then up to 1 between `start` and `start + rise`, and down again between `end - rise` and `end`."""
    return step((t - start) / rise) * step((end - t) / rise)


def pose(score: Score, skeleton: Skeleton | None = None) -> Motion:
    """The motion of a score; the floor is y = 0. Raises PoserError where a foot is out of reach."""
    body = skeleton or Skeleton.default()
    scale = body.stature / TABLE_STATURE
    T = len(score.t)
    rest = body.rest_positions - body.rest_positions[0]
    stand = np.array([0.0, body.standing_height, 0.0])
    R = np.tile(np.eye(3), (T, 24, 1, 1))
    p_root = stand + scale * score.pelvis
    R[:, 0] = ori.exp(score.turn)
    for side in (0, 1):
        R_foot = ori.rot_x(score.heel[:, side])
        toe = stand + rest[TOES[side]] + scale * score.toes[:, side]
        ankle = toe - R_foot @ body.offsets[TOES[side]]
        _leg(R, body, side, p_root, ankle, R_foot)
        R[:, TOES[side]] = ori.rot_x(-score.heel[:, side])  # toes stay level
        _arm(R, side, score)
    for j in SPINE:
        R[:, j] = ori.exp(score.bend / len(SPINE))
    R[:, 15] = ori.rot_x(score.nod)
    return Motion(score.rate_hz, R, p_root, body)


def _arm(R: Array, side: int, score: Score) -> None:
    sign = SIDES[side]
    raised = score.raised[:, side]
    R[:, COLLARS[side]] = ori.rot_z(sign * COLLAR_SHARE * raised)
    down = ARM_DOWN - (1 - COLLAR_SHARE) * raised
    R[:, SHOULDERS[side]] = ori.rot_x(-score.forward[:, side]) @ ori.rot_z(-sign * down)
    R[:, ELBOWS[side]] = ori.rot_y(-sign * score.elbow[:, side])


def _leg(R: Array, body: Skeleton, side: int, p_root: Array, ankle: Array, R_foot: Array) -> None:
    """Hip, knee and ankle that put the ankle at `ankle` (T,3) m and the foot at `R_foot` (T,3,3).

    With thigh a and shank b at rest, the knee's flexion x solves |a + R_x(x) b| = d, d the distance from
    hip to ankle: C + A cos x + B sin x = (d^2 - |a|^2 - |b|^2) / 2. The hip then turns a + R_x(x) b onto
    the ankle's direction and keeps the knee's axis in the plane of that direction and the pelvis' x.
    """
    a, b = body.offsets[KNEES[side]], body.offsets[ANKLES[side]]
    R_pelvis = R[:, 0]
    to_ankle = np.einsum("tji,tj->ti", R_pelvis, ankle - p_root) - body.offsets[HIPS[side]]
    wanted = (np.sum(to_ankle**2, axis=1) - a @ a - b @ b) / 2 - a[0] * b[0]
    A, B = a[1] * b[1] + a[2] * b[2], a[2] * b[1] - a[1] * b[2]
    cosine = wanted / np.hypot(A, B)
    if (cosine > 1).any():
        t = int(np.argmax(cosine))
        raise PoserError(f"frame {t}: the {('left', 'right')[side]} foot is out of the leg's reach")
    flexion = np.arctan2(B, A) + np.arccos(cosine)
    R_knee = ori.rot_x(flexion)
    axis = np.broadcast_to([1.0, 0, 0], to_ankle.shape)
    R_hip = _frame(to_ankle, axis) @ np.swapaxes(_frame(a + R_knee @ b, axis), -1, -2)
    R[:, HIPS[side]], R[:, KNEES[side]] = R_hip, R_knee
    R[:, ANKLES[side]] = np.swapaxes(R_pelvis @ R_hip @ R_knee, -1, -2) @ R_foot


def _frame(u: Array, v: Array) -> Array:
    """Right-handed frames (T,3,3) whose first axis is u and whose second lies in the plane of u and v."""
    x = u / np.linalg.norm(u, axis=1, keepdims=True)
    y = v - x * np.sum(x * v, axis=1, keepdims=True)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)
