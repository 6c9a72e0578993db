"""What a term is, the point that it is evaluated at, and how its Jacobian makes gradient and matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from mocap.orientation import Array
from sip.solvers.band import Band

CONSTANTS = 7  # per sensor: mounting (3) rad, heading (1) rad, bias (3) m/s^2


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


def _all() -> slice:
    return slice(None)


@dataclass(frozen=True, eq=False)
class Stencil:
    """The Jacobian of a term: residual i, of m values, is of the unknowns of the frames i + o alone.

    blocks[o] (M,m,c), o >= 0: its derivative with respect to `columns` of frame i + o, before `weight`
    multiplies it; (1,m,c) where it is the same for all i. diagonal: (M,c) or (1,c) instead, value k is of
    column k alone. weight: 1/sigma, what broadcasts to (M,m). of_sensors (M,S,m/S,w): where the values are
    the sensors' one after the other, their derivative with respect to `constants` of that sensor's u.
    """

    blocks: Mapping[int, Array]
    columns: slice | Sequence[int] = field(default_factory=_all)
    weight: Array | float = 1.0
    diagonal: bool = False
    of_sensors: Array | None = None
    constants: slice = field(default_factory=_all)


class Term:
    """A sum of squares of whitened residuals (weight = 1/sigma), half of it: 1/2 |r(x, u)|^2.

    A term has `name`, `reach`, `residual` and `stencil`; what follows from them is here. A term whose matrix
    can be had for less, or that is robust, has its own `loss`, `pullback` and `hessian` instead.
    name: as in reports. reach: how many frames apart its unknowns may lie. constant: the matrix does not
    depend on the point.
    """

    name: str
    reach: int = 0
    constant: bool = False

    def residual(self, point: Point) -> Array:
        """Whitened residuals, in sigmas: one of any shape for each frame that has `reach` more behind it."""
        raise NotImplementedError

    def stencil(self, point: Point) -> Stencil:
        """The derivative of `residual`."""
        raise NotImplementedError

    def loss(self, residual: Array) -> float:
        """Half the (robust) sum of squares of whitened residuals, all of them or some frames'."""
        r = residual.ravel()
        return 0.5 * float(r @ r)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        """Add J^T W v to grad (T,n) and grad_u (S,7): J whitened, W the robust weights at the point.

        With v the residual this is the gradient.
        """
        s = self.stencil(point)
        if s.of_sensors is not None:
            of = v.reshape(*s.of_sensors.shape[:2], 1, -1) @ (s.of_sensors * _rows(s))
            grad_u[:, s.constants] += of[:, :, 0].sum(axis=0)
        M = len(point.x) - self.reach
        if M <= 0 or not s.blocks:
            return
        rows = v.reshape(M, -1) * s.weight
        for o, J in s.blocks.items():
            if s.diagonal:
                back = rows * J
            else:
                back = rows @ J[0] if len(J) == 1 else (rows[:, None] @ J)[:, 0]
            grad[o : o + M, s.columns] += back

    def hessian(self, point: Point, band: Band) -> None:
        """Add the Gauss-Newton matrix J^T W J."""
        s = self.stencil(point)
        M = len(point.x) - self.reach
        G = None if s.of_sensors is None else s.of_sensors * _rows(s)
        if G is not None:
            add_constants(band, G, s.constants)
        if M <= 0:
            return
        index = np.arange(point.x.shape[1])[s.columns]
        columns = (s.columns, s.columns) if isinstance(s.columns, slice) else np.ix_(index, index)
        weight = np.asarray(s.weight) if s.diagonal else np.asarray(s.weight)[..., None]
        blocks = {o: J * weight for o, J in s.blocks.items()}
        for b, Jb in blocks.items():
            for a, Ja in blocks.items():
                if a < b:
                    continue
                here = band.blocks[b : b + M, a - b]
                if s.diagonal:
                    here[:, index, index] += Ja * Jb
                else:
                    here[:, *columns] += np.swapaxes(Ja, 1, 2) @ Jb
            if G is not None:
                split = Jb.reshape(*G.shape[:3], -1)
                coupled = np.swapaxes(split, 2, 3) @ G  # (M,S,c,w)
                border = band.border.reshape(len(band.border), -1, G.shape[1], CONSTANTS)
                border[b : b + M, s.columns, :, s.constants] += np.swapaxes(coupled, 1, 2)


def _rows(s: Stencil) -> Array:
    """The weights of the residuals, as they multiply `of_sensors`."""
    assert s.of_sensors is not None
    M, S, m, _ = s.of_sensors.shape
    return np.broadcast_to(s.weight, (M, S * m)).reshape(M, S, m, 1)


def add_constants(band: Band, G: Array, constants: slice) -> None:
    """Add sum_i G_i^T G_i of whitened residuals' G (M,S,m,w) to what is of each sensor's own constants."""
    S = G.shape[1]
    corner = band.corner.reshape(S, CONSTANTS, S, CONSTANTS)
    rows = G.swapaxes(0, 1).reshape(S, -1, G.shape[-1])
    each = np.arange(S)
    corner[each, constants, each, constants] += rows.swapaxes(1, 2) @ rows


def add_pairs(band: Band, d: int, J: Array, weight: Array) -> None:
    """Add sum_t J_{t+d}^T weight_t J_t to the d-th block diagonal.

    J (T,...,c): derivatives of one quantity of each frame. weight (T-d,...,1): the product of what the two
    frames of a pair have in the residuals that they share.
    """
    T, c = len(J), J.shape[-1]
    left = (J[d:] * weight).reshape(T - d, -1, c)
    band.blocks[: T - d, d] += np.swapaxes(left, 1, 2) @ J[: T - d].reshape(T - d, -1, c)


def difference_stencil(order: int) -> dict[int, float]:
    """Coefficients {offset: c} of the forward difference of that order: 2 -> {0: 1, 1: -2, 2: 1}."""
    c = np.array([1.0])
    for _ in range(order):
        c = np.convolve(c, [-1.0, 1.0])
    return {i: float(v) for i, v in enumerate(c)}
