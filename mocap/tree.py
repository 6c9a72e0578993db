"""SMPL's joint tree: names and parents of the 24 joints, and the kinematics of any tree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap.orientation import Array

JOINTS: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle",
    "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hand", "right_hand",
)  # fmt: skip
PARENTS: tuple[int, ...] = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21,
)  # fmt: skip


def offsets(parents: Sequence[int], rest: Array) -> Array:
    """Each joint in its parent's frame (J,3) m, of rest positions (J,3); the root's is its rest position."""
    of_parent = np.where(np.array(parents)[:, None] < 0, 0.0, rest[list(parents)])
    return np.asarray(rest - of_parent)


def rotations(parents: Sequence[int], R_parent_joint: Array) -> Array:
    """R_world_joint (...,J,3,3) = R_world_parent R_parent_joint."""
    R = np.array(R_parent_joint, float)
    for j, p in enumerate(parents):
        if p >= 0:
            R[..., j, :, :] = R[..., p, :, :] @ R[..., j, :, :]
    return R


def positions(
    parents: Sequence[int], offsets: Array, R_world_joint: Array, p_world_root: Array
) -> Array:
    """p_world_joint (...,J,3) m = p_world_parent + R_world_parent offset; the root (...,3) as given."""
    p = np.empty(R_world_joint.shape[:-1])
    p[..., 0, :] = p_world_root
    for j, parent in enumerate(parents):
        if parent >= 0:
            arm = R_world_joint[..., parent, :, :] @ offsets[j]
            p[..., j, :] = p[..., parent, :] + arm
    return p
