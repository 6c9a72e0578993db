"""Anthropometric terms: the pose prior and the joint limits, over the active body angles."""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from sip.kinematics import BODY
from sip.terms.base import Point, Stencil, Term


class PosePrior(Term):
    """Residual (T,b): weight L^T (theta - mu), L L^T = (Sigma + floor^2 I)^-1, theta the b active body
    angles.

    mean (b,) and covariance (b,b) of training motion in rad and rad^2 (SIP, eq. 12: a Gaussian over
    poses). weight: 0.3 counts a pose for a tenth of an independent one, since neighbouring frames are not
    independent.
    """

    name, constant = "prior", True

    def __init__(self, mean: Array, covariance: Array, floor: float, weight: float):
        self.mean = mean
        precision = np.linalg.inv(covariance + floor**2 * np.eye(len(mean)))
        self.L = weight * np.linalg.cholesky(precision)

    def residual(self, point: Point) -> Array:
        return (point.x[:, BODY] - self.mean) @ self.L

    def stencil(self, point: Point) -> Stencil:
        return Stencil({0: self.L.T[None]}, BODY)


class Limits(Term):
    """Residual (T,b): how far each body angle is past its limit, over sigma; zero inside.

    lower, upper (b,) rad; sigma rad. One-sided: max(0, theta - upper) - max(0, lower - theta).
    """

    name = "limits"

    def __init__(self, lower: Array, upper: Array, sigma: float):
        self.lower, self.upper, self.sigma = lower, upper, sigma

    def residual(self, point: Point) -> Array:
        theta = point.x[:, BODY]
        return (theta - np.clip(theta, self.lower, self.upper)) / self.sigma

    def stencil(self, point: Point) -> Stencil:
        past = (self.residual(point) != 0).astype(float)
        return Stencil({0: past}, BODY, 1 / self.sigma, diagonal=True)
