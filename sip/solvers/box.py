"""Newton steps between bounds: a convex quadratic over the block band with a box on each unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array
from sip.solvers.band import Band, Factor

_PASSES = 4  # changes of the active set in one step; the first few settle nearly all


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds lower <= x <= upper, both (T,n), infinite where there is none."""

    lower: Array
    upper: Array

    def clip(self, x: Array) -> Array:
        """The point of the box next to x (T,n)."""
        return np.clip(x, self.lower, self.upper)

    def free(self, x: Array, grad: Array) -> NDArray[np.bool_]:
        """(T,n): False where x lies on a bound and the gradient pushes against it."""
        return ~(((x <= self.lower) & (grad > 0)) | ((x >= self.upper) & (grad < 0)))


def reduced(band: Band, free: NDArray[np.bool_]) -> Band:
    """The band with the identity in the rows and columns that are not free."""
    T, k1 = band.blocks.shape[:2]
    f = free.astype(float)
    blocks = band.blocks.copy()
    for d in range(min(k1, T)):
        blocks[: T - d, d] *= f[d:, :, None] * f[: T - d, None, :]
    index = np.arange(blocks.shape[2])
    blocks[:, 0, index, index] += 1 - f
    return Band(blocks, band.border * f[..., None], band.corner)


def bounded_step(
    band: Band,
    grad: Array,
    grad_u: Array,
    damping: Array,
    corner_damping: float,
    x: Array,
    box: Box,
) -> tuple[Array, Array, bool]:
    """The d = [dx (T,n), du (g,)] that minimises g d + d (H + D) d / 2 with x + dx in the box.

    Primal-dual active set (Hintermueller, Ito, Kunisch, 2003): unknowns on a bound are held there, the
    others solved for; then those past a bound join, and those whose multiplier -(g + (H + D) d) points
    inward leave, until nothing changes. x: (T,n) inside the box. damping: (n,), D's diagonal.
    Where the set has not settled after a few passes the step is clipped and False returned with it: it
    may be no descent at all. Raises NotPositiveDefinite.
    """
    low, high = box.lower - x, box.upper - x
    side = np.where(box.free(x, grad), 0, np.where(grad > 0, -1, 1))
    for _ in range(_PASSES):
        free = side == 0
        held = np.where(side < 0, low, np.where(side > 0, high, 0.0))
        held[free] = 0
        Hx, Hu = band.dot(held, np.zeros_like(grad_u))
        factor = Factor(reduced(band, free), damping, corner_damping)
        dx, du = factor.solve(np.where(free, -(grad + Hx), 0.0), -(grad_u + Hu))
        dx = np.where(free, dx, held)
        Hx, _ = band.dot(dx, du)
        force = -(grad + Hx + damping * dx)
        new = np.where(dx > high, 1, np.where(dx < low, -1, 0))
        new = np.where((side > 0) & (force > 0), 1, np.where((side < 0) & (force < 0), -1, new))
        settled = np.array_equal(new, side)
        if settled:
            break
        side = new
    return np.clip(dx, low, high), du, settled
