"""Frames of joints and small pieces of geometry that finding them takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.findings import Finding
from mocap.formats._source import INDEX
from mocap.orientation import Array

T_POSE_FRAMES = 3  # dropped where a file starts with a T-pose that is not part of the motion
SNAP_DEG = 35.0  # a local axis this near to an anatomical one is taken for it
SIDES = (("left", 1.0), ("right", -1.0))
X, Y, Z = np.eye(3)
# Directions of thighs, shanks, upper arms and forearms in the T-pose.
STRAIGHT = {INDEX[f"{s}_{j}"]: d for s, side in SIDES
            for j, d in (("hip", -Y), ("knee", -Y), ("shoulder", side * X), ("elbow", side * X))}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Neutral:
    """Our axes in the local axes of a foreign skeleton's joints.

    F_j (3,3): column k is our axis k (left, up, forward in the T-pose) in the coordinates of the source joint
    that plays our joint j. U (3,3): the source's world to ours. F: by our joint index. F_spine: of each spine
    joint. own_limbs: whether limbs point as the source's bones do; else as the frames say. t_pose_frames: how
    many frames go with a T-pose that is no part of the motion.
    """

    U: Array
    F: dict[int, Array]
    F_spine: tuple[Array, ...]
    assumed: tuple[Finding, ...]
    doubts: tuple[Finding, ...] = ()
    own_limbs: bool = True
    t_pose_frames: int = T_POSE_FRAMES


def unit(v: Array) -> Array:
    """v / |v| along the last axis; zero stays zero."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300))


def minimal_rotation(a: Array, b: Array) -> Array:
    """The rotation (3,3) by the smallest angle that takes the direction of a (3,) to that of b."""
    a, b = unit(np.asarray(a, float)), unit(np.asarray(b, float))
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis, sine = np.cross(a, np.eye(3)[np.argmin(np.abs(a))]), 1.0
        return ori.exp(np.pi * unit(axis))
    return ori.exp(axis / sine * np.arctan2(sine, cosine))


def frame(d: Array, h: Array) -> Array:
    """Orthonormal columns [d, h made normal to d, their cross product] of directions (3,)."""
    d = unit(d)
    h = unit(h - (h @ d) * d)
    return np.column_stack([d, h, np.cross(d, h)])


def snapped(F: Array) -> tuple[Array, float]:
    """The nearest rotation that permutes axes, and how far it is in deg; F itself beyond SNAP_DEG."""
    # tr(F^T P) = 1 + 2 cos(angle)
    best = _PERMUTATIONS[int(np.argmax(np.einsum("ab,nab->n", F, _PERMUTATIONS)))]
    off = float(np.degrees(ori.angle_between(F, best)))
    return (best, off) if off <= SNAP_DEG else (F, off)


def _permutations() -> Array:
    """The 24 rotations (24,3,3) that take coordinate axes to coordinate axes."""
    axes = [s * a for a in np.eye(3) for s in (1.0, -1.0)]
    return np.array(
        [np.column_stack([a, b, np.cross(a, b)]) for a in axes for b in axes if abs(a @ b) < 0.5]
    )


_PERMUTATIONS = _permutations()
