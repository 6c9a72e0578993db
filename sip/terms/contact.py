"""Contact: sqrt(w) (q_{t+1} - q_t) rate / sigma: a point of the sole that stands does not move."""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from sip.soles import Soles
from sip.terms.base import Point, Stencil, Term


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

    def stencil(self, point: Point) -> Stencil:
        if self not in point.kept:
            point.kept[self] = self.soles.evaluate(point.x, point.R_ref)[1]
        J = point.kept[self].reshape(len(point.x), 3 * self.soles.P, -1)
        weight = np.repeat(self.weight, 3, axis=2).reshape(len(self.weight), -1)
        return Stencil({0: -J[:-1], 1: J[1:]}, weight=weight)
