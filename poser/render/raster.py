"""Triangles to pixels: a z-buffer in numpy, with smooth shading and shadows on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array


@dataclass(frozen=True)
class Camera:
    """A pinhole that looks from `eye` at `target`, both (3,) m, y up; focal: pixels; size: width, height."""

    eye: Array
    target: Array
    focal: float
    size: tuple[int, int]

    @property
    def R_world_camera(self) -> Array:
        """Columns: right, down and forward in the world."""
        forward = self.target - self.eye
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward], axis=-1)

    def project(self, p_world: Array) -> Array:
        """(...,3): pixels x and y, and depth in m, of points (...,3) m before the camera."""
        q = (p_world - self.eye) @ self.R_world_camera
        scale = self.focal / np.maximum(q[..., 2:], 1e-3)
        centre = np.array(self.size) / 2
        return np.concatenate([q[..., :2] * scale + centre, q[..., 2:]], axis=-1)


@dataclass(frozen=True)
class Hits:
    """What covered pixels show: flat index (N,), triangle (N,), where in it (N,3), depth (N,) m."""

    pixel: NDArray[np.int64]
    face: NDArray[np.int64]
    share: Array
    depth: Array


def hits(seen: Array, faces: NDArray[np.int32], size: tuple[int, int], cull: bool = True) -> Hits:
    """The nearest triangle at every pixel.

    seen: (V,3) of `Camera.project`. faces: (F,3), counter-clockwise seen from outside; with `cull` those that
    face away are left out. Depth is interpolated as 1/z, which is linear on the screen.
    """
    width, height = size
    x, y = seen[faces, 0], seen[faces, 1]
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    low_x = np.clip(np.ceil(x.min(axis=1) - 0.5), 0, width).astype(np.int64)
    low_y = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, height).astype(np.int64)
    wide = np.clip(np.floor(x.max(axis=1) + 0.5), 0, width).astype(np.int64) - low_x
    high = np.clip(np.floor(y.max(axis=1) + 0.5), 0, height).astype(np.int64) - low_y
    # y points down: a triangle that is counter-clockwise to the eye has a negative area.
    ok = (area < 0 if cull else area != 0) & (wide > 0) & (high > 0)
    ok &= seen[faces, 2].min(axis=1) > 0.05
    kept = np.flatnonzero(ok)
    x, y, area, wide, high = x[kept], y[kept], area[kept], wide[kept], high[kept]
    inverse = 1.0 / seen[faces[kept], 2]
    # Barycentric coordinates and 1/z as planes over the screen: a + b px + c py.
    nxt, last = [1, 2, 0], [2, 0, 1]
    b = (y[:, nxt] - y[:, last]) / area[:, None]
    c = (x[:, last] - x[:, nxt]) / area[:, None]
    a = (x[:, nxt] * y[:, last] - x[:, last] * y[:, nxt]) / area[:, None]
    plane_z = np.stack([(v * inverse).sum(axis=1) for v in (a, b, c)], axis=-1)
    count = wide * high
    which = np.repeat(np.arange(len(kept)), count)
    within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(within, wide[which])
    ix, iy = low_x[kept][which] + column, low_y[kept][which] + row
    px, py = ix + 0.5, iy + 0.5
    share = a[which] + b[which] * px[:, None] + c[which] * py[:, None]
    inside = (share >= -1e-9).all(axis=1)
    which, share, pixel = which[inside], share[inside], (iy * width + ix)[inside]
    pz = plane_z[which]
    near = pz[:, 0] + pz[:, 1] * px[inside] + pz[:, 2] * py[inside]
    order = np.argsort(near, kind="stable")  # the nearest is written last and stays
    first = np.full(width * height, -1, np.int64)
    first[pixel[order]] = order
    best = first[first >= 0]
    return Hits(pixel[best], kept[which[best]], share[best], 1.0 / near[best])
