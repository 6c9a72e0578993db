"""Network: L^T (scale * Log(R_network^T R(x))) over the unknown joints, as sure as its errors are small."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

from mocap.orientation import Array
from sip import kinematics as kin
from sip.belief import FrameBeliefs
from sip.kinematics import ROOT_W
from sip.over_frames import OverFrames
from sip.solvers.band import Band
from sip.terms.base import Point, Term


@cache
def _functions() -> tuple[OverFrames, OverFrames]:
    """Of theta (3) and M (3,3): e = Log(M Exp(theta)), and e with J_r^-1(e) J_r(theta) = de/dtheta."""
    theta, M = ca.SX.sym("theta", 3), ca.SX.sym("M", 3, 3)
    e = kin.log(M @ kin.exp(theta))
    J = kin.right_jacobian_inv(e) @ kin.right_jacobian(theta)
    return (
        OverFrames(ca.Function("network", [theta, M], [e], {"cse": True})),
        OverFrames(ca.Function("network_slope", [theta, M], [ca.horzcat(e, J)], {"cse": True})),
    )


class NetworkPose(Term):
    """Residual (T,3a) in sigmas, of the a joints that the belief is about: the whitened rotation vectors from
    the network's joints to the model's; correlated as the network's errors are.
    """

    name = "network"

    def __init__(self, belief: FrameBeliefs):
        self.belief = belief
        self.columns = slice(ROOT_W.start if belief.root else ROOT_W.stop, None)

    def _inputs(self, point: Point) -> tuple[Array, Array]:
        R = self.belief.R
        T, a = R.shape[:2]
        M = R
        if self.belief.root:
            # The function takes matrices transposed: (R_net^T R_ref)^T.
            M = np.concatenate([np.swapaxes(point.R_ref, 1, 2)[:, None] @ R[:, :1], R[:, 1:]], 1)
        return point.x[:, self.columns].reshape(T * a, 3), M.reshape(T * a, 3, 3)

    def residual(self, point: Point) -> Array:
        e = _functions()[0](*self._inputs(point))[0].reshape(len(point.x), 1, -1)
        return ((e * self.belief.scale[:, None]) @ self.belief.L)[:, 0]

    def _slopes(self, point: Point) -> Array:
        """de/dtheta (T,a,3,3) of each joint, transposed."""
        if self not in point.kept:
            out = _functions()[1](*self._inputs(point))[0][:, 1:]
            point.kept[self] = out.reshape(len(point.x), -1, 3, 3)
        return np.asarray(point.kept[self])

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        J = self._slopes(point)
        back = (self.belief.L @ v[..., None])[..., 0] * self.belief.scale
        back = back.reshape(*J.shape[:2], 3, 1)
        grad[:, self.columns] += (J @ back).reshape(len(v), -1)

    def hessian(self, point: Point, band: Band) -> None:
        T, a = self.belief.R.shape[:2]
        J = self._slopes(point) * self.belief.scale.reshape(T, a, 1, 3)
        H = np.broadcast_to(self.belief.H, (T, 3 * a, 3 * a)).reshape(T, a, 3, 3 * a)
        # J is block-diagonal, so both products go joint by joint.
        half = (J @ H).reshape(T, 3 * a, 3 * a).swapaxes(1, 2)
        whole = (J @ half.reshape(T, a, 3, 3 * a)).reshape(T, 3 * a, 3 * a)
        band.blocks[:, 0, self.columns, self.columns] += whole
