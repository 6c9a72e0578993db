"""Smoothness: a difference of second or third order of every angle and of the root, and the gauge."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mocap.orientation import Array
from sip import kinematics as kin
from sip.kinematics import ROOT_P, ROOT_W
from sip.over_frames import OverFrames
from sip.terms.base import Point, Stencil, Term, difference_stencil


def _apply(stencil: dict[int, float], x: Array) -> Array:
    """sum_o c_o x_{i+o} for every i that has all of them."""
    M = len(x) - max(stencil)
    if M <= 0:
        return np.zeros((0, *x.shape[1:]))
    return np.sum([c * x[o : o + M] for o, c in stencil.items()], axis=0)


class LinearSmoothness(Term):
    """Residual (T-order, c): difference of the given order of some columns of x, times rate^order / sigma.

    order 2: angular or linear acceleration, sigma in rad/s^2 or m/s^2; order 3: jerk, sigma per s^3.
    sigma: (c,).
    """

    constant = True

    def __init__(self, name: str, columns: slice, order: int, sigma: Array, rate_hz: float):
        self.name, self.columns, self.reach = name, columns, order
        self.coefficients = difference_stencil(order)
        self.weight = rate_hz**order / np.asarray(sigma, float)

    def residual(self, point: Point) -> Array:
        return _apply(self.coefficients, point.x[:, self.columns]) * self.weight

    def stencil(self, point: Point) -> Stencil:
        blocks = {o: np.full((1, len(self.weight)), c) for o, c in self.coefficients.items()}
        return Stencil(blocks, self.columns, self.weight, diagonal=True)


class RootSmoothness(Term):
    """Residual (T-order,3): difference of order-1 of the root's angular velocity, over sigma.

    Velocity v_t = Log(R_t^T R_{t+1}) rate in the body's frame; R_t = R_ref_t Exp(w_t). sigma in rad/s^2
    (order 2) or rad/s^3 (order 3).
    """

    name = "smoothness"

    def __init__(self, order: int, sigma: float, rate_hz: float):
        self.reach = order
        self.coefficients = difference_stencil(order - 1)
        self.weight = rate_hz**order / sigma
        w0, w1 = ca.SX.sym("w0", 3), ca.SX.sym("w1", 3)
        M = ca.SX.sym("M", 3, 3)  # R_ref_t^T R_ref_{t+1}
        v = kin.log(kin.exp(w0).T @ M @ kin.exp(w1))
        inputs, slopes = [w0, w1, M], [ca.densify(ca.jacobian(v, w)) for w in (w0, w1)]
        self._value = OverFrames(ca.Function("velocity", inputs, [v]))
        self._slopes = OverFrames(ca.Function("velocity_slopes", inputs, slopes))

    @staticmethod
    def _inputs(point: Point) -> tuple[Array, Array, Array]:
        w = point.x[:, ROOT_W]
        M = np.swapaxes(point.R_ref[:-1], -1, -2) @ point.R_ref[1:]
        return w[:-1], w[1:], np.swapaxes(M, -1, -2)

    def residual(self, point: Point) -> Array:
        if len(point.x) <= self.reach:
            return np.zeros((0, 3))
        v = self._value(*self._inputs(point))[0][:, 0]
        return _apply(self.coefficients, v) * self.weight

    def stencil(self, point: Point) -> Stencil:
        if self not in point.kept:
            point.kept[self] = self._jacobians(point)
        return Stencil(point.kept[self], ROOT_W, self.weight)

    def _jacobians(self, point: Point) -> dict[int, Array]:
        M = len(point.x) - self.reach
        J = {o: np.zeros((M, 3, 3)) for o in range(self.reach + 1)}
        A, B = (np.swapaxes(a, -1, -2) for a in self._slopes(*self._inputs(point)))
        for o, c in self.coefficients.items():
            J[o] += c * A[o : o + M]
            J[o + 1] += c * B[o : o + M]
        return J


class Gauge(Term):
    """Residual (T,3): root position over sigma (100 m): nothing measures where the person stands."""

    name, constant = "gauge", True

    def __init__(self, sigma: float):
        self.sigma = sigma

    def residual(self, point: Point) -> Array:
        return point.x[:, ROOT_P] / self.sigma

    def stencil(self, point: Point) -> Stencil:
        return Stencil({0: np.ones((1, 3))}, ROOT_P, 1 / self.sigma, diagonal=True)
