"""Orientation: Log(R_meas^T R_y(heading) R_world_bone(x) Exp(mounting)) / sigma per sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array
from sip.solvers.band import Band
from sip.terms.base import Point, add_stencil, squared


class Orientation:
    """Residual (T,S,3) in sigmas: the rotation vector between measured and modelled bone (SIP, eq. 6).

    sigma: rad. valid (T,S): samples that count. border: whether
    mounting and heading are unknowns.
    """

    name, reach, constant = "orientation", 0, False

    def __init__(self, sigma: float, valid: NDArray[np.bool_], border: bool):
        self.weight = valid.astype(float)[..., None] / sigma
        self.border = border

    def residual(self, point: Point) -> Array:
        return point.e * self.weight

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        T = len(grad)
        r = v * self.weight
        grad += (r.reshape(T, 1, -1) @ point.e_x.reshape(T, r[0].size, -1))[:, 0]
        if self.border:
            grad_u[:, :4] += (r[..., None, :] @ point.e_u)[..., 0, :].sum(axis=0)

    def hessian(self, point: Point, band: Band) -> None:
        T, S = self.weight.shape[:2]
        J = (point.e_x * self.weight[..., None]).reshape(T, 3 * S, -1)
        add_stencil(band, {0: J}, slice(None))
        if not self.border:
            return
        G = point.e_u * self.weight[..., None]
        coupled = np.swapaxes(J.reshape(T, S, 3, -1), 2, 3) @ G  # (T,S,c,4)
        border = band.border.reshape(T, -1, S, 7)
        border[..., :4] += np.swapaxes(coupled, 1, 2)
        corner = band.corner.reshape(S, 7, S, 7)
        for s in range(S):
            flat = G[:, s].reshape(3 * T, 4)
            corner[s, :4, s, :4] += flat.T @ flat
