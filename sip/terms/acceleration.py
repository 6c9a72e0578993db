"""Acceleration: R_y(heading) (p_{t-1} - 2 p_t + p_{t+1}) rate^2 + R_meas bias - acc_meas, robust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.orientation import Array
from sip.solvers.band import Band
from sip.terms.base import CONSTANTS, Point, Term, add_constants, add_pairs


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
        key = self, "jacobian"
        if key not in point.kept:
            point.kept[key] = self._compute_jacobian(point)
        J, G = point.kept[key]
        return J, G

    def _compute_jacobian(self, point: Point) -> tuple[Array, Array | None]:
        if not self.border:
            return point.p_x * self.scale, None
        Ry = ori.rot_y(point.u[:, 3])
        return (Ry * self.scale) @ point.p_x, self._of_constants(point, Ry)

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
        spread = _spread(v)
        T = len(grad)
        grad += (spread.reshape(T, 1, -1) @ J.reshape(T, spread[0].size, -1))[:, 0]
        if G is not None:
            grad_u[:, 3:] += (v[..., None, :] @ G)[..., 0, :].sum(axis=0)

    def hessian(self, point: Point, band: Band) -> None:
        r = self.residual(point)
        J, G = self._jacobian(point)
        M, S = r.shape[:2]
        if M <= 0:
            return
        w2 = self.weight**2 / self._robust(r)[..., None]  # (M,S,1)
        # Residual t is w_t (J_{t-1} - 2 J_t + J_{t+1}): gather the weights of each pair of frames first.
        T = len(J)
        padded = np.zeros((M + 4, S, 1))
        padded[2:-2] = w2
        # before[t]: weight of the residual centred on t + 1, in which frame t has coefficient 1.
        before, here, after = (padded[2 - lead :][:T] for lead in (0, 1, 2))
        pairs = ((before + 4 * here + after), -2 * (before + here)[:-1], before[:-2])
        for d, weight in enumerate(pairs):
            add_pairs(band, d, J, weight[..., None])
        if G is None:
            return
        coupled = np.swapaxes(J, 2, 3) @ _spread(G * w2[..., None])  # (T,S,c,4)
        border = band.border.reshape(*band.border.shape[:2], S, CONSTANTS)
        border[..., 3:] += np.swapaxes(coupled, 1, 2)
        add_constants(band, G * np.sqrt(w2)[..., None], slice(3, None))


def _spread(v: Array) -> Array:
    """(M+2,...): what each frame has of v (M,...): entry t is 1, -2, 1 times that of t, t+1, t+2."""
    out = np.zeros((len(v) + 2, *v.shape[1:]))
    out[:-2] += v
    out[1:-1] -= 2 * v
    out[2:] += v
    return out
