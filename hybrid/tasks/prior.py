"""The pose stays near the network's, as near as the network is sure of it."""

from __future__ import annotations

import numpy as np

from hybrid import rotations
from hybrid.tasks.task import Frame, Residual, Task
from mocap.orientation import Array


class NetworkPrior(Task):
    """L Log(R_net^T R) of the free joints, L^T L the inverse covariance of the network's errors.

    Both come with the frame (`hybrid.network_errors`).
    """

    def term(self, frame: Frame) -> Residual:
        """Residual (3F,) and Jacobian (3F,3F)."""
        return residual(frame.xi, frame.whitener)


def residual(xi: Array, whitener: Array) -> Residual:
    """L Log(R_net^T R) of the free joints: xi (F,3) rad now, whitener L (3F,3F), L^T L = Lambda_net.

    R = R_net Exp(xi) and Log(Exp(xi) Exp(dv)) = xi + J_r^-1(xi) dv.
    """
    F = len(xi)
    J = np.zeros((F, 3, F, 3))
    f = np.arange(F)
    J[f, :, f, :] = rotations.right_jacobian_inv(xi)
    return Residual(whitener @ xi.ravel(), whitener @ J.reshape(3 * F, 3 * F))
