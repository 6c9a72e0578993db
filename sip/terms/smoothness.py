"""Smoothness: a difference of second or third order of every angle and of the root, and the gauge."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mocap.orientation import Array
from sip import kinematics as kin
from sip.kinematics import ROOT_P, ROOT_W
from sip.over_frames import OverFrames
from sip.solvers.band import Band
from sip.terms.base import Point, add_diagonal_stencil, add_stencil, difference_stencil, squared


def _apply(stencil: dict[int, float], x: Array) -> Array:
    """sum_o c_o x_{i+o} for every i that has all of them."""
    M = len(x) - max(stencil)
    if M <= 0:
        return np.zeros((0, *x.shape[1:]))
    return np.sum([c * x[o : o + M] for o, c in stencil.items()], axis=0)


class LinearSmoothness:
    """Residual (T-order, c): difference of the given order of some columns of x, times rate^order / sigma.

    order 2: angular or linear acceleration, sigma in rad/s^2 or m/s^2; order 3: jerk, sigma per s^3.
    sigma: (c,).
    """

    constant = True

    def __init__(self, name: str, columns: slice, order: int, sigma: Array, rate_hz: float):
        self.name, self.columns, self.reach = name, columns, order
        self.stencil = difference_stencil(order)
        self.weight = rate_hz**order / np.asarray(sigma, float)

    def residual(self, point: Point) -> Array:
        return _apply(self.stencil, point.x[:, self.columns]) * self.weight

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        v = v * self.weight
        for o, c in self.stencil.items():
            grad[o : o + len(v), self.columns] += c * v

    def hessian(self, point: Point, band: Band) -> None:
        M = len(point.x) - self.reach
        if M > 0:
            add_diagonal_stencil(band, self.stencil, self.weight, self.columns, M)


class RootSmoothness:
    """Residual (T-order,3): difference of order-1 of the root's angular velocity, over sigma.

    Velocity v_t = Log(R_t^T R_{t+1}) rate in the body's frame; R_t = R_ref_t Exp(w_t). sigma in rad/s^2
    (order 2) or rad/s^3 (order 3).
    """

    name, constant = "smoothness", False

    def __init__(self, order: int, sigma: float, rate_hz: float):
        self.reach = order
        self.stencil = difference_stencil(order - 1)
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
        return _apply(self.stencil, v) * self.weight

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def _jacobians(self, point: Point) -> dict[int, Array]:
        if self in point.kept:
            return dict(point.kept[self])
        A, B = (np.swapaxes(a, -1, -2) for a in self._slopes(*self._inputs(point)))
        M = len(point.x) - self.reach
        J = {o: np.zeros((M, 3, 3)) for o in range(self.reach + 1)}
        for o, c in self.stencil.items():
            J[o] += c * A[o : o + M] * self.weight
            J[o + 1] += c * B[o : o + M] * self.weight
        point.kept[self] = J
        return J

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        if len(point.x) > self.reach:
            for o, J in self._jacobians(point).items():
                grad[o : o + len(v), ROOT_W] += np.einsum("ti,tic->tc", v, J)

    def hessian(self, point: Point, band: Band) -> None:
        if len(point.x) > self.reach:
            add_stencil(band, self._jacobians(point), ROOT_W)


class Gauge:
    """Residual (T,3): root position over sigma (100 m): nothing measures where the person stands."""

    name, reach, constant = "gauge", 0, True

    def __init__(self, sigma: float):
        self.sigma = sigma

    def residual(self, point: Point) -> Array:
        return point.x[:, ROOT_P] / self.sigma

    def loss(self, residual: Array) -> float:
        return squared(residual)

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        grad[:, ROOT_P] += v / self.sigma

    def hessian(self, point: Point, band: Band) -> None:
        band.blocks[:, 0, [0, 1, 2], [0, 1, 2]] += 1 / self.sigma**2
