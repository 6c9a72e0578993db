"""Capsules along the bones: what a body looks like without a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.body.skin import Skin
from mocap.orientation import Array
from mocap.skeleton import JOINTS, TABLE_STATURE, Skeleton

SIDES, RINGS = 14, 5  # of a capsule: around, and from the equator of a cap to its pole
_LIMBS = {"pelvis": 0.085, "hip": 0.070, "knee": 0.048, "ankle": 0.038, "foot": 0.034, "spine1": 0.090,
          "spine2": 0.095, "spine3": 0.095, "neck": 0.048, "head": 0.085, "collar": 0.060,
          "shoulder": 0.044, "elbow": 0.035, "wrist": 0.030, "hand": 0.030}  # fmt: skip
RADII: tuple[float, ...] = tuple(_LIMBS[name.split("_")[-1]] for name in JOINTS)
"""Radius in m of the capsules that start at each joint, on a body of `TABLE_STATURE`."""
_ENDS = {"head": (0.0, 0.10, 0.02), "left_foot": (0.0, 0.0, 0.06), "right_foot": (0.0, 0.0, 0.06),
         "left_hand": (0.07, 0.0, 0.0), "right_hand": (-0.07, 0.0, 0.0)}  # fmt: skip


def capsule_skin(skeleton: Skeleton) -> Skin:
    """A capsule for every bone, and for head, hands and feet what is beyond their joints."""
    rest = skeleton.rest_positions - skeleton.rest_positions[0]
    scale = skeleton.stature / TABLE_STATURE
    vertices, faces, owners = [], [], []
    count = 0
    for j, start, end in _bones(skeleton, rest, scale):
        v, f = capsule(start, end, RADII[j] * scale)
        vertices.append(v)
        faces.append(f + count)
        owners += [j] * len(v)
        count += len(v)
    weights = np.eye(len(rest))[owners]
    return Skin(np.concatenate(vertices), np.concatenate(faces), weights, rest)


def _bones(skeleton: Skeleton, rest: Array, scale: float) -> list[tuple[int, Array, Array]]:
    """Joint that moves it, start and end of every capsule."""
    bones = [(p, rest[p], rest[j]) for j, p in enumerate(skeleton.parents) if p >= 0]
    return bones + [
        (j, rest[j], rest[j] + scale * np.array(_ENDS[name]))
        for j, name in enumerate(skeleton.names)
        if name in _ENDS
    ]


def capsule(start: Array, end: Array, radius: float) -> tuple[Array, NDArray[np.int32]]:
    """Vertices (N,3) and outward faces (M,3) of all points within `radius` of the segment."""
    axis = end - start
    length = float(np.linalg.norm(axis))
    z = axis / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    x = np.cross(z, [0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    # Rings from the south pole over the cylinder to the north pole; the poles are rings of equal points.
    tilt = np.linspace(-np.pi / 2, 0, RINGS + 1)
    angle = np.concatenate([tilt, -tilt[::-1]])
    along = radius * np.sin(angle) + np.r_[np.zeros(RINGS + 1), np.full(RINGS + 1, length)]
    around = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    circle = np.cos(around)[:, None] * x + np.sin(around)[:, None] * y
    points = start + along[:, None, None] * z + (radius * np.cos(angle))[:, None, None] * circle
    ring = np.arange(len(angle) - 1)[:, None] * SIDES
    a = ring + np.arange(SIDES)
    b = ring + (np.arange(SIDES) + 1) % SIDES
    quads = np.stack([a, b, b + SIDES, a + SIDES], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return points.reshape(-1, 3), faces.astype(np.int32)
