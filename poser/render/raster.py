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
    face away are left out. Each triangle is cut into rows of pixels; 1/depth is linear along them.
    """
    width, height = size
    x, y = seen[faces, 0], seen[faces, 1]
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    first = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, height).astype(np.int64)
    count = np.clip(np.ceil(y.max(axis=1) - 0.5), 0, height).astype(np.int64) - first
    # y points down: a triangle that is counter-clockwise to the eye has a negative area.
    ok = (area < 0 if cull else area != 0) & (count > 0) & (seen[faces, 2].min(axis=1) > 0.05)
    kept = np.flatnonzero(ok)
    x, y, area, first, count = x[kept], y[kept], area[kept], first[kept], count[kept]
    # Barycentric coordinates as planes over the screen, a + b px + c py, and from them 1/depth.
    nxt, last = [1, 2, 0], [2, 0, 1]
    b = (y[:, nxt] - y[:, last]) / area[:, None]
    c = (x[:, last] - x[:, nxt]) / area[:, None]
    a = (x[:, nxt] * y[:, last] - x[:, last] * y[:, nxt]) / area[:, None]
    inverse = 1.0 / seen[faces[kept], 2]
    za, zb, zc = ((v * inverse).sum(axis=1) for v in (a, b, c))
    of, row = _spread(count)
    row += first[of]
    start, stop = _span(x, y, of, np.asarray(row + 0.5), width)
    in_row, column = _spread(stop - start)
    column += start[in_row]
    pixel = row[in_row] * width + column
    near = (za + zb * 0.5)[of] + zc[of] * (row + 0.5)
    near = near[in_row] + zb[of][in_row] * column
    nearest = np.zeros(width * height)
    np.maximum.at(nearest, pixel, near)
    best = np.flatnonzero(near == nearest[pixel])
    owner = np.full(width * height, -1, np.int64)  # two may be as near
    owner[pixel[best]] = best
    best = owner[owner >= 0]
    face, py, px = of[in_row[best]], row[in_row[best]] + 0.5, column[best] + 0.5
    share = a[face] + b[face] * px[:, None] + c[face] * py[:, None]
    return Hits(pixel[best], kept[face], share, 1.0 / near[best])


def _spread(count: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of counts (N,): to which each of all belongs, and its number among those."""
    of = np.repeat(np.arange(len(count)), count)
    return of, np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)


def _span(
    x: Array, y: Array, of: NDArray[np.int64], at: Array, width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First pixel, and the one after the last, of triangles (x, y: (N,3)) `of` (R,) in the rows `at` (R,)."""
    low, high = np.full(len(of), np.inf), np.full(len(of), -np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        yi, yj, xi, xj = y[of, i], y[of, j], x[of, i], x[of, j]
        crossed = (np.minimum(yi, yj) <= at) & (at < np.maximum(yi, yj))
        share = (at - yi) / np.where(yi == yj, 1.0, yj - yi)
        cut = xi + share * (xj - xi)
        low = np.where(crossed, np.minimum(low, cut), low)
        high = np.where(crossed, np.maximum(high, cut), high)
    start = np.clip(np.ceil(low - 0.5), 0, width).astype(np.int64)
    stop = np.clip(np.ceil(high - 0.5), 0, width).astype(np.int64)
    return start, np.maximum(start, stop)
