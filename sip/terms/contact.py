"""Contact: sqrt(w) (q_{t+1} - q_t) rate / sigma: a point of the sole that stands does not move."""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from sip.soles import Soles
from sip.solvers.band import Band
from sip.terms.base import Point, Term, add_pairs


class Contact(Term):
    """Residual (T-1,P,3) in sigmas: velocity of the sole's points over sigma (m/s), weighted by the belief
    w (T-1,P) that each stands, which is that of the pose the solve came from (`sip.soles.standing`).

    Nothing is said about where the ground lies: a stance on a stair or a chair is one like any other.
    """

    name, reach = "contact", 1

    def __init__(self, soles: Soles, stands: Array, sigma: float, rate_hz: float):
        self.soles = soles
        self.weight = np.sqrt(stands)[..., None] * (rate_hz / sigma)

    def residual(self, point: Point) -> Array:
        return np.diff(self.soles.places(point.x, point.R_ref), axis=0) * self.weight

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        J = self._slopes(point)
        v = v * self.weight
        spread = np.zeros((len(J), *v.shape[1:]))
        spread[1:] += v
        spread[:-1] -= v
        T = len(grad)
        grad += (spread.reshape(T, 1, -1) @ J.reshape(T, spread[0].size, -1))[:, 0]

    def hessian(self, point: Point, band: Band) -> None:
        J, w2 = self._slopes(point), np.zeros((len(point.x) + 1, *self.weight.shape[1:], 1))
        w2[1:-1] = self.weight[..., None] ** 2
        # Residual t is w_t (J_{t+1} - J_t).
        add_pairs(band, 0, J, w2[1:] + w2[:-1])
        add_pairs(band, 1, J, -w2[1:-1])

    def _slopes(self, point: Point) -> Array:
        if self not in point.kept:
            point.kept[self] = self.soles.evaluate(point.x, point.R_ref)[1]
        return np.asarray(point.kept[self])
