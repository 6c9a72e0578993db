"""Self-calibration: what keeps mounting, heading and acceleration bias of each sensor near zero."""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from sip.terms.base import Point, Stencil, Term


class SensorConstants(Term):
    """Residual (S,7): [mounting (3) rad, heading (1) rad, bias (3) m/s^2] over their sigmas.

    sigma: (7,), an infinitesimal one pins a quantity to zero.
    """

    name, constant = "sensor_constants", True

    def __init__(self, sigma: Array):
        self.sigma = sigma

    def residual(self, point: Point) -> Array:
        return point.u / self.sigma

    def stencil(self, point: Point) -> Stencil:
        G = np.broadcast_to(np.diag(1 / self.sigma), (1, len(point.u), *[len(self.sigma)] * 2))
        return Stencil({}, of_sensors=G)
