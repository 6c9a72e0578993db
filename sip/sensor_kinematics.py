"""Sensors on the body: what their orientations and places are at the unknowns of a frame, with Jacobians."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array
from mocap.skeleton import Skeleton
from sip import kinematics as kin
from sip.over_frames import OverFrames


class SensorKinematics:
    """Orientation residual and position of every sensor in one frame, with Jacobians, mapped over frames.

    CasADi expressions of the skeleton. The Jacobians are written out in their geometric form, which is
    some fifty times cheaper to evaluate than those of automatic differentiation (a test holds one against
    the other): a change d of the rotation vector theta_j turns everything below joint j by
    A_j d, A_j = R_world_j J_r(theta_j), about the joint's place, so that
        de/dtheta_j = J_l^-1(e) R_meas^T R_y A_j,    dp/dtheta_j = -hat(p - p_j) A_j.
    active: the body joints above any sensor, in the order of their columns of x; n = 6 + 3 len(active).
    """

    def __init__(self, skeleton: Skeleton, joint: NDArray[np.int64], placement: Array):
        S = len(joint)
        self.S = S
        chains = [skeleton.ancestors(int(j)) for j in joint]
        self.active = tuple(sorted({j for chain in chains for j in chain} - {0}))
        self.n = n = 6 + 3 * len(self.active)
        at = {0: 3} | {j: 6 + 3 * i for i, j in enumerate(self.active)}
        x, R_ref = ca.SX.sym("x", n), ca.SX.sym("R_ref", 3, 3)
        R_meas, u = ca.SX.sym("R_meas", 3, 3 * S), ca.SX.sym("u", 4, S)
        R, p = kin.forward(skeleton, x, R_ref, self.active)
        A = {j: R[j] @ kin.right_jacobian(x[c : c + 3]) for j, c in at.items()}
        e, seats = [], []
        e_x, p_x, e_u = ca.SX(3 * S, n), ca.SX(3 * S, n), ca.SX(3, 4 * S)
        for s in range(S):
            j, rows = int(joint[s]), slice(3 * s, 3 * s + 3)
            mounting = kin.exp(u[:3, s])
            to_sensor = R_meas[:, rows].T @ kin.exp(ca.vertcat(0, u[3, s], 0))
            e.append(kin.log(to_sensor @ R[j] @ mounting))
            seats.append(p[j] + R[j] @ ca.DM(placement[s]))
            J = kin.right_jacobian_inv(e[s])
            left = J.T @ to_sensor  # J_l^-1(e) = J_r^-1(e)^T
            p_x[rows, :3] = ca.SX.eye(3)
            for i in chains[s]:
                columns = slice(at[i], at[i] + 3)
                e_x[rows, columns] = left @ A[i]
                p_x[rows, columns] = -kin.hat(seats[s] - p[i]) @ A[i]
            e_u[:, 4 * s : 4 * s + 3] = J @ kin.right_jacobian(u[:3, s])
            e_u[:, 4 * s + 3] = J.T @ R_meas[:, rows].T @ ca.vertcat(0, 1, 0)
        inputs = [x, R_ref, R_meas, u]
        values = ca.horzcat(ca.vertcat(*e), ca.vertcat(*seats))
        self.values = OverFrames(ca.Function("values", inputs, [values], {"cse": True}))
        full = [values, ca.densify(e_x.T), ca.densify(p_x.T), ca.densify(e_u)]
        self.full = OverFrames(ca.Function("full", inputs, full, {"cse": True}))

    def evaluate(
        self, x: Array, R_ref: Array, R_meas: Array, u: Array, jacobian: bool
    ) -> tuple[Array, ...]:
        """e, p (T,S,3) and, with `jacobian`, e_x, p_x (T,S,3,n) and e_u (T,S,3,4)."""
        T, S, n = len(x), self.S, self.n
        inputs = (
            x,
            np.swapaxes(R_ref, -1, -2),
            np.swapaxes(R_meas, -1, -2),
            np.broadcast_to(u[:, :4], (T, S, 4)),
        )
        values, *rest = (self.full if jacobian else self.values)(*inputs)
        e, p = values.reshape(T, 2, S, 3).swapaxes(0, 1)
        if not jacobian:
            return e, p
        e_x, p_x = (a.reshape(T, S, 3, n) for a in rest[:2])
        return e, p, e_x, p_x, np.swapaxes(rest[2].reshape(T, S, 4, 3), -1, -2)
