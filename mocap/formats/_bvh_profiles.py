"""What tools expect of a BVH file: names of joints, and the pose in which all rotations are zero."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS
from mocap.stances import pose_bones

Profile = Literal["smpl", "mixamo", "unity", "cmu"]
Rest = Literal["t", "a"]
PROFILES: tuple[Profile, ...] = get_args(Profile)
RESTS: tuple[Rest, ...] = get_args(Rest)
A_POSE_DEG = 45.0  # arms below the horizontal

_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
_SIDE = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist", "hand")
_NAMES: dict[Profile, tuple[str, str]] = {
    "mixamo": (
        "Hips Spine Spine1 Spine2 Neck Head",
        "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand HandMiddle1",
    ),
    "unity": (
        "Hips Spine Chest UpperChest Neck Head",
        "UpperLeg LowerLeg Foot Toes Shoulder UpperArm LowerArm Hand MiddleProximal",
    ),
    "cmu": (
        "Hips LowerBack Spine Spine1 Neck Head",
        "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand FingerBase",
    ),
}
_PREFIX: dict[Profile, str] = {"mixamo": "mixamorig:"}


def names(profile: Profile) -> tuple[str, ...]:
    """The name of each of our 24 joints."""
    if profile == "smpl":
        return JOINTS
    trunk, side = (words.split() for words in _NAMES[profile])
    found = dict(zip(_TRUNK, trunk, strict=True))
    for where in ("Left", "Right"):
        found |= {f"{where.lower()}_{j}": where + s for j, s in zip(_SIDE, side, strict=True)}
    return tuple(_PREFIX.get(profile, "") + found[j] for j in JOINTS)


def _turned(rest: Rest) -> tuple[Array, Array]:
    """Global rotations (24,3,3) of the rest pose, A, and those of each joint's parent."""
    A = pose_bones(np.arange(24), "n", A_POSE_DEG if rest == "a" else 0.0)
    return A, np.concatenate([np.eye(3)[None], A[list(PARENTS[1:])]])


def at_rest(motion: Motion, rest: Rest) -> tuple[Array, Array]:
    """Offsets (24,3) m of a rest pose with every joint's axes along the world's, and the local rotations
    (T,24,3,3) that take that pose to the motion's: offset_j = A_parent o_j, R'_j = A_parent R_j A_j^T.
    """
    A, above = _turned(rest)
    offsets = (above @ motion.skeleton.offsets[..., None])[..., 0]
    return offsets, above @ motion.R_parent_joint @ np.swapaxes(A, -1, -2)


def in_t_pose(offsets: Array, rest: Rest) -> Array:
    """Inverse of `at_rest` for offsets (24,3)."""
    return np.asarray((np.swapaxes(_turned(rest)[1], -1, -2) @ offsets[..., None])[..., 0])


def from_rest(R: Array, rest: Rest) -> Array:
    """Inverse of `at_rest` for local rotations (T,24,3,3)."""
    A, above = _turned(rest)
    return np.asarray(np.swapaxes(above, -1, -2) @ R @ A)


def ends(rest: Rest, where: dict[str, tuple[float, float, float]]) -> dict[str, Array]:
    """Where bones without a joint beyond them end, m, in the axes of the rest pose."""
    A = _turned(rest)[0]
    return {name: A[JOINTS.index(name)] @ end for name, end in where.items()}
