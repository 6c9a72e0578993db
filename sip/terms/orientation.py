"""Orientation: Log(R_meas^T R_y(heading) R_world_bone(x) Exp(mounting)) / sigma per sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array
from sip.terms.base import Point, Stencil, Term


class Orientation(Term):
    """Residual (T,S,3) in sigmas: the rotation vector between measured and modelled bone (SIP, eq. 6).

    sigma: rad. valid (T,S): samples that count. border: whether
    mounting and heading are unknowns.
    """

    name = "orientation"

    def __init__(self, sigma: float, valid: NDArray[np.bool_], border: bool):
        self.weight = valid.astype(float)[..., None] / sigma
        self.border = border

    def residual(self, point: Point) -> Array:
        return point.e * self.weight

    def stencil(self, point: Point) -> Stencil:
        T, S = self.weight.shape[:2]
        weight = np.broadcast_to(self.weight, (T, S, 3)).reshape(T, 3 * S)
        blocks = {0: point.e_x.reshape(T, 3 * S, -1)}
        of = point.e_u if self.border else None
        return Stencil(blocks, weight=weight, of_sensors=of, constants=slice(0, 4))
