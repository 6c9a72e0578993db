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
            grad_u[:, :4] += np.einsum("tsi,tsic->sc", r, point.e_u, optimize=True)

    def hessian(self, point: Point, band: Band) -> None:
        T, S = self.weight.shape[:2]
        J = (point.e_x * self.weight[..., None]).reshape(T, 3 * S, -1)
        add_stencil(band, {0: J}, slice(None))
        if not self.border:
            return
        G = point.e_u * self.weight[..., None]
        J = J.reshape(T, S, 3, -1)
        for s in range(S):
            cols = slice(7 * s, 7 * s + 4)
            band.border[:, :, cols] += np.swapaxes(J[:, s], 1, 2) @ G[:, s]
            band.corner[cols, cols] += np.einsum("tic,tid->cd", G[:, s], G[:, s])
