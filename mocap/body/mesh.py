"""The free mesh: an adult of 6,000 vertices, fitted to any skeleton.

`mesh.npz` is made by `scripts/make_body.py` from MakeHuman's data, which are CC0 1.0 (`LICENSE.md` here).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from mocap.body.skin import Skin
from mocap.orientation import Array, exp
from mocap.skeleton import REST, TABLE_STATURE, Skeleton

FILE = Path(__file__).with_name("mesh.npz")
LIMBS = {1: 4, 2: 5, 4: 7, 5: 8, 13: 16, 14: 17, 16: 18, 17: 19, 18: 20, 19: 21}
"""Joints whose bone is a limb, and the joint where it ends."""


@cache
def baked() -> Skin:
    """The mesh on the joints of the table, `mocap.skeleton.REST`."""
    with np.load(FILE) as file:
        weights = np.zeros((len(file["vertices"]), 24))
        rows = np.arange(len(weights))[:, None]
        np.add.at(weights, (rows, file["joints"]), file["weights"].astype(float))
        weights /= weights.sum(axis=1, keepdims=True)
        vertices = file["vertices"].astype(float) - REST[0]
        skin = Skin(vertices, file["faces"].astype(np.int32), weights, REST - REST[0])
    for array in (skin.vertices, skin.faces, skin.weights, skin.rest):
        array.setflags(write=False)
    return skin


def mesh_skin(skeleton: Skeleton) -> Skin:
    """The mesh on the joints of `skeleton`.

    v = sum_j w_j (A_j (v_0 - rest0_j) + rest_j): A_j scales with the stature, and a limb's A_j turns its
    bone onto the skeleton's and stretches it to that length.
    """
    table = baked()
    rest = skeleton.rest_positions - skeleton.rest_positions[0]
    A = np.tile(np.eye(3) * skeleton.stature / TABLE_STATURE, (24, 1, 1))
    for j, end in LIMBS.items():
        A[j] = _limb(table.rest[end] - table.rest[j], rest[end] - rest[j], A[j, 0, 0])
    return Skin(table.posed(A, rest), table.faces, table.weights, rest)


def _limb(d: Array, to: Array, scale: float) -> Array:
    """The least rotation of d onto `to`, after a stretch along d to the length of `to` and `scale` across."""
    length, wanted = np.linalg.norm(d), np.linalg.norm(to)
    if wanted < 1e-6:
        return scale * np.eye(3)
    u, w = d / length, to / wanted
    axis, sine = np.cross(u, w), np.linalg.norm(np.cross(u, w))
    if sine > 1e-9:
        axis = axis / sine * np.arctan2(sine, u @ w)
    stretch = scale * np.eye(3) + (wanted / length - scale) * np.outer(u, u)
    return np.asarray(exp(axis) @ stretch)
