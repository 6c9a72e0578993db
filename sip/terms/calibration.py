"""Self-calibration: what keeps mounting, heading and acceleration bias of each sensor near zero."""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from sip.solvers.band import Band
from sip.terms.base import Point, squared


class SensorConstants:
    """Residual (S,7): [mounting (3) rad, heading (1) rad, bias (3) m/s^2] over their sigmas.

    sigma: (7,), an infinitesimal one pins a quantity to zero.
    """

    name, reach, constant = "sensor_constants", 0, True

    def __init__(self, sigma: Array):
        self.sigma = sigma

    def residual(self, point: Point) -> Array:
        return point.u / self.sigma

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        grad_u += v / self.sigma

    def hessian(self, point: Point, band: Band) -> None:
        g = np.arange(len(band.corner))
        band.corner[g, g] += np.tile(self.sigma**-2.0, len(g) // 7)
