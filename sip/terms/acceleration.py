"""Acceleration: R_y(heading) (p_{t-1} - 2 p_t + p_{t+1}) rate^2 + R_meas bias - acc_meas, robust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.orientation import Array
from sip.solvers.band import Band
from sip.terms.base import Point, Term


class Acceleration(Term):
    """Residual (T-2,S,3) in sigmas, of frames 1..T-2 (SIP, eq. 8; the stencil is DIP's eq. 3).

    Pseudo-Huber on the norm of each sensor's vector: cost delta^2 (sqrt(1 + |r|^2/delta^2) - 1), delta in
    sigmas; the Gauss-Newton matrix carries the weights 1/sqrt(1 + |r|^2/delta^2).
    sigma: m/s^2. valid (T,S). R_meas, acc_meas: as measured, zero where invalid.
    """

    name, reach = "acceleration", 2

    def __init__(
        self,
        sigma: float,
        delta: float,
        rate_hz: float,
        acc_meas: Array,
        R_meas: Array,
        valid: NDArray[np.bool_],
        border: bool,
    ):
        ok = valid[1:-1]
        self.weight = ok.astype(float)[..., None] / sigma
        self.delta, self.scale = delta, rate_hz**2
        self.acc = np.where(ok[..., None], acc_meas[1:-1], 0.0)
        self.R = np.where(ok[..., None, None], R_meas[1:-1], 0.0)
        self.border = border

    def _second_difference(self, point: Point) -> Array:
        p = point.p
        return (p[:-2] - 2 * p[1:-1] + p[2:]) * self.scale

    def residual(self, point: Point) -> Array:
        if self not in point.kept:
            point.kept[self] = self._residual(point)
        return np.asarray(point.kept[self])

    def _residual(self, point: Point) -> Array:
        a = self._second_difference(point)
        if self.border:
            a = (ori.rot_y(point.u[:, 3]) @ a[..., None])[..., 0]
            a = a + (self.R @ point.u[:, 4:, None])[..., 0]
        return (a - self.acc) * self.weight

    def _robust(self, r: Array) -> Array:
        """sqrt(1 + |r|^2/delta^2) per sensor and frame."""
        return np.sqrt(1 + np.einsum("tsi,tsi->ts", r, r) / self.delta**2)

    def loss(self, residual: Array) -> float:
        return self.delta**2 * float((self._robust(residual) - 1).sum())

    def _jacobian(self, point: Point) -> tuple[Array, Array | None]:
        """d (heading-turned position)/dx (T,S,3,c) and d residual/du (T-2,S,3,4): heading, bias."""
        if not self.border:
            return point.p_x * self.scale, None
        Ry = ori.rot_y(point.u[:, 3])
        J = Ry @ (point.p_x * self.scale)
        return J, self._of_constants(point, Ry)

    def _of_constants(self, point: Point, Ry: Array) -> Array:
        """d residual/du (T-2,S,3,4): y x (turned acceleration) for the heading, R_meas for the bias."""
        turned = (Ry @ self._second_difference(point)[..., None])[..., 0]
        G = np.zeros((*turned.shape, 4))
        G[..., 0, 0], G[..., 2, 0] = turned[..., 2], -turned[..., 0]
        G[..., 1:] = self.R
        return G

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        v = v * self.weight / self._robust(self.residual(point))[..., None]
        J, G = self._jacobian(point)
        # Each residual touches three frames with 1, -2, 1: difference v first, then one product a frame.
        spread = np.zeros((len(J), *v.shape[1:]))
        for k, c in enumerate((1.0, -2.0, 1.0)):
            spread[k : k + len(v)] += c * v
        T = len(grad)
        grad += (spread.reshape(T, 1, -1) @ J.reshape(T, spread[0].size, -1))[:, 0]
        if G is not None:
            grad_u[:, 3:] += (v[..., None, :] @ G)[..., 0, :].sum(axis=0)

    def hessian(self, point: Point, band: Band) -> None:
        r = self.residual(point)
        w = (self.weight / np.sqrt(self._robust(r))[..., None])[..., None]
        J, G = self._jacobian(point)
        M, S = r.shape[:2]
        if M <= 0:
            return
        # Residual t is w_t (J_{t-1} - 2 J_t + J_{t+1}): gather the weights of each pair of frames first.
        T, w2 = len(J), w**2
        zero = np.zeros((1, *w2.shape[1:]))
        before, here, after = (
            np.concatenate([*[zero] * lead, w2, *[zero] * (2 - lead)]) for lead in (0, 1, 2)
        )
        # before[t]: weight of the residual centred on t + 1, in which frame t has coefficient 1.
        flat = J.reshape(T, 3 * S, -1)
        pairs = ((before + 4 * here + after), -2 * (before + here)[:-1], before[:-2])
        for d, weight in enumerate(pairs):
            left = (J[d:] * weight).reshape(T - d, 3 * S, -1)
            H = np.swapaxes(left, 1, 2) @ flat[: T - d]
            band.blocks[: T - d, d] += H
        if G is None:
            return
        G = G * w
        own = np.swapaxes(J, 2, 3)  # (T,S,c,3)
        border = band.border.reshape(*band.border.shape[:2], S, 7)
        for k, c in enumerate((1.0, -2.0, 1.0)):
            coupled = own[k : k + M] @ (c * G * w)
            border[k : k + M, ..., 3:] += np.swapaxes(coupled, 1, 2)
        corner = band.corner.reshape(S, 7, S, 7)
        for s in range(S):
            rows = G[:, s].reshape(3 * M, 4)
            corner[s, 3:, s, 3:] += rows.T @ rows
