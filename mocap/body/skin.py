"""A skin on the 24 joints, and linear blend skinning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array


@dataclass(frozen=True, eq=False)
class Skin:
    """V vertices (V,3) m of the rest pose with the pelvis joint at the origin, F faces (F,3), weights
    (V,24) that sum to 1, and rest (24,3) m, the joints of that pose.

    Faces are counter-clockwise seen from outside.
    """

    vertices: Array
    faces: NDArray[np.int32]
    weights: Array
    rest: Array

    def posed(self, R_world_joint: Array, p_world_joint: Array) -> Array:
        """Vertices (...,V,3) m of global rotations (...,24,3,3) and joints (...,24,3) m.

        v_world = sum_j w_j (R_world_j (v - rest_j) + p_world_j): linear blend skinning.
        """
        R = np.asarray(R_world_joint, float)
        shift = p_world_joint - (R @ self.rest[..., None])[..., 0]
        flat = R.reshape(*R.shape[:-2], 9)
        turn = (self.weights @ flat).reshape(*R.shape[:-3], len(self.vertices), 3, 3)
        return np.asarray((turn @ self.vertices[..., None])[..., 0] + self.weights @ shift)

    def normals(self, vertices: Array) -> Array:
        """Unit normals (V,3) at `vertices` (V,3), outwards: the mean of the faces around, by their area."""
        corner = vertices[self.faces]
        n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        at = self.faces.ravel()
        sums = [np.bincount(at, np.repeat(n[:, k], 3), minlength=len(vertices)) for k in range(3)]
        out = np.stack(sums, axis=-1)
        return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12))

    def largest(self, count: int = 4) -> tuple[NDArray[np.int64], Array]:
        """The `count` joints (V,count) that move each vertex most and their weights, which sum to 1."""
        joints = np.argsort(-self.weights, axis=1, kind="stable")[:, :count]
        kept = np.take_along_axis(self.weights, joints, axis=1)
        kept = kept / kept.sum(axis=1, keepdims=True)
        return np.where(kept > 0, joints, 0), kept
