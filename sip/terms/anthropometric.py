"""Anthropometric terms: the pose prior and the joint limits, over the active body angles."""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from sip.kinematics import BODY
from sip.solvers.band import Band
from sip.terms.base import Point, squared


class PosePrior:
    """Residual (T,b): weight L^T (theta - mu), L L^T = (Sigma + floor^2 I)^-1, theta the b active body
    angles.

    mean (b,) and covariance (b,b) of training motion in rad and rad^2 (SIP, eq. 12: a Gaussian over
    poses). weight: 0.3 counts a pose for a tenth of an independent one, since neighbouring frames are not
    independent.
    """

    name, reach, constant = "prior", 0, True

    def __init__(self, mean: Array, covariance: Array, floor: float, weight: float):
        self.mean = mean
        precision = np.linalg.inv(covariance + floor**2 * np.eye(len(mean)))
        self.L = weight * np.linalg.cholesky(precision)
        self.H = self.L @ self.L.T

    def residual(self, point: Point) -> Array:
        return (point.x[:, BODY] - self.mean) @ self.L

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        grad[:, BODY] += v @ self.L.T

    def hessian(self, point: Point, band: Band) -> None:
        band.blocks[:, 0, BODY, BODY] += self.H


class Limits:
    """Residual (T,b): how far each body angle is past its limit, over sigma; zero inside.

    lower, upper (b,) rad; sigma rad. One-sided: max(0, theta - upper) - max(0, lower - theta).
    """

    name, reach, constant = "limits", 0, False

    def __init__(self, lower: Array, upper: Array, sigma: float):
        self.lower, self.upper, self.sigma = lower, upper, sigma

    def residual(self, point: Point) -> Array:
        theta = point.x[:, BODY]
        return (theta - np.clip(theta, self.lower, self.upper)) / self.sigma

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        grad[:, BODY] += np.where(self.residual(point) != 0, v, 0.0) / self.sigma

    def hessian(self, point: Point, band: Band) -> None:
        past = self.residual(point) != 0
        index = np.arange(6, point.x.shape[1])
        band.blocks[:, 0, index, index] += past / self.sigma**2
