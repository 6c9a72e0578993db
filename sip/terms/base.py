"""What a term is, the point that it is evaluated at, and how its Jacobian enters the band."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np

from mocap.orientation import Array
from sip.solvers.band import Band


@dataclass
class Point:
    """Unknowns, and the kinematics already computed at them: a term never sees stale ones.

    x (T,n), R_ref (T,3,3), u (S,7): per sensor mounting (3) rad, heading (1) rad, bias (3) m/s^2.
    e (T,S,3) rad: Log(R_meas^T R_y(heading) R_bone Exp(mounting)), zero where not measured.
    p (T,S,3) m: sensor positions. With Jacobians: e_x, p_x (T,S,3,n),
    e_u (T,S,3,4) for mounting and heading; else None. kept: what a term computed here once, by term.
    """

    x: Array
    R_ref: Array
    u: Array
    e: Array
    p: Array
    e_x: Any = None
    p_x: Any = None
    e_u: Any = None
    kept: dict[Any, Any] = field(default_factory=dict, init=False)

    def __getstate__(self) -> dict[str, Any]:
        """Without what can be computed again."""
        return vars(self) | {"kept": {}}

    def slice(self, start: int, stop: int) -> Point:
        """Frames start to stop-1; the constants are the same."""
        return Point(
            *(a if name == "u" or a is None else a[start:stop] for name, a in self._parts())
        )

    def then(self, other: Point) -> Point:
        """These frames and those, at the same constants."""
        pairs = zip(self._parts(), other._parts(), strict=True)
        return Point(
            *(
                a if name == "u" or a is None else np.concatenate([a, b])
                for (name, a), (_, b) in pairs
            )
        )

    def _parts(self) -> list[tuple[str, Any]]:
        return [(f.name, getattr(self, f.name)) for f in fields(self) if f.name != "kept"]


class Term(Protocol):
    """A sum of squares of whitened residuals (weight = 1/sigma), possibly robust.

    name: as in reports. reach: how many frames apart its unknowns may lie. constant: the Hessian of the
    term does not depend on the point.
    """

    name: str
    reach: int
    constant: bool

    def residual(self, point: Point) -> Array:
        """Whitened residuals, in sigmas."""
        ...

    def loss(self, residual: Array) -> float:
        """Half the (robust) sum of squares of whitened residuals, all of them or some frames'."""
        ...

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        """Add J^T W v to grad (T,n) and grad_u (S,7): J whitened, W the robust weights at the point.

        With v the residual this is the gradient.
        """
        ...

    def hessian(self, point: Point, band: Band) -> None:
        """Add the Gauss-Newton matrix J^T W J."""
        ...


def squared(residual: Array) -> float:
    """Half the sum of squares."""
    r = residual.ravel()
    return 0.5 * float(r @ r)


def add_pairs(band: Band, d: int, J: Array, weight: Array) -> None:
    """Add sum_t J_{t+d}^T weight_t J_t to the d-th block diagonal.

    J (T,...,c): derivatives of one quantity of each frame. weight (T-d,...,1): the product of what the two
    frames of a pair have in the residuals that they share.
    """
    T, c = len(J), J.shape[-1]
    left = (J[d:] * weight).reshape(T - d, -1, c)
    band.blocks[: T - d, d] += np.swapaxes(left, 1, 2) @ J[: T - d].reshape(T - d, -1, c)


def add_stencil(band: Band, jacobians: dict[int, Array], columns: slice) -> None:
    """Add sum_i (sum_o J_o[i])^T (...) for residual i with unknowns of frames i + o.

    jacobians[o] is (M,m,c), o >= 0: the derivative of residual i, whitened, with respect to the columns
    `columns` of frame i + o.
    """
    for b, Jb in jacobians.items():
        for a, Ja in jacobians.items():
            if a >= b:
                H = np.swapaxes(Ja, 1, 2) @ Jb
                band.blocks[b : b + len(Jb), a - b, columns, columns] += H


def add_diagonal_stencil(
    band: Band, coefficients: dict[int, float], weight: Array, columns: slice, count: int
) -> None:
    """The same for residuals r_i = sum_o c_o x_{i+o} weight on `columns`: diagonal blocks only.

    weight: (c,) 1/sigma of each column. count: number of residuals.
    """
    index = np.arange(band.blocks.shape[2])[columns]
    for b, cb in coefficients.items():
        for a, ca in coefficients.items():
            if a >= b:
                band.blocks[b : b + count, a - b, index, index] += ca * cb * weight**2


def difference_stencil(order: int) -> dict[int, float]:
    """Coefficients {offset: c} of the forward difference of that order: 2 -> {0: 1, 1: -2, 2: 1}."""
    c = np.array([1.0])
    for _ in range(order):
        c = np.convolve(c, [-1.0, 1.0])
    return {i: float(v) for i, v in enumerate(c)}
