"""Points of the soles as functions of the unknowns, and whether they stand."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.ndimage import convolve1d

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.skeleton import TOES, Skeleton
from sip import kinematics as kin
from sip.kinematics import ROOT_P
from sip.over_frames import OverFrames
from sip.prior import Conditioned

LEGS = ((1, 4, 7), (2, 5, 8))  # hip, knee, ankle


class Soles:
    """Heel and ball of each foot below a knee that moves: q (T,P,3) m, with Jacobians (T,P,3,n).

    Both points are rigid with the ankle's bone: where the sole of the rest pose lies straight under ankle
    and toe joint. An ankle without a sensor beyond it is no unknown: its rotation vector is the prior's mean
    given the others, mu + G (theta - mu_active), and so depends on all of them.
    """

    def __init__(self, skeleton: Skeleton, active: tuple[int, ...], prior: Conditioned):
        rest = skeleton.rest_positions
        floor = rest[list(TOES), 1].min() - skeleton.sole
        legs = [leg for leg in LEGS if leg[1] in active]
        self.P = 2 * len(legs)
        self.n = n = 6 + 3 * len(active)
        at = {0: 3} | {j: 6 + 3 * i for i, j in enumerate(active)}
        x, R_ref = ca.SX.sym("x", n), ca.SX.sym("R_ref", 3, 3)
        R, p = kin.forward(skeleton, x, R_ref, active)
        A = {j: R[j] @ kin.right_jacobian(x[c : c + 3]) for j, c in at.items()}
        points, q_x = [], ca.SX(3 * self.P, n)
        for side, (hip, knee, ankle) in enumerate(legs):
            toe = TOES[LEGS.index((hip, knee, ankle))]
            chain = list(skeleton.ancestors(knee))
            if ankle in active:
                R_ankle, slope = R[ankle], None
                chain.append(ankle)
            else:
                rows = np.searchsorted(prior.passive, np.r_[3 * ankle - 3 : 3 * ankle])
                gain, mean = prior.gain[rows], prior.prior.mean[prior.passive[rows]]
                theta = ca.DM(mean) + ca.DM(gain) @ (x[6:] - ca.DM(prior.mean))
                R_ankle = R[knee] @ kin.exp(theta)
                slope = R_ankle @ kin.right_jacobian(theta) @ ca.DM(gain)
            p_ankle = p[knee] + R[knee] @ ca.DM(skeleton.offsets[ankle])
            for k, joint in enumerate((ankle, toe)):
                seat = rest[joint] - rest[ankle]
                seat[1] = floor - rest[ankle, 1]
                q = p_ankle + R_ankle @ ca.DM(seat)
                points.append(q)
                own = slice(3 * (2 * side + k), 3 * (2 * side + k) + 3)
                q_x[own, :3] = ca.SX.eye(3)
                if slope is not None:
                    q_x[own, 6:] = -kin.hat(q - p_ankle) @ slope
                for i in chain:
                    q_x[own, at[i] : at[i] + 3] += -kin.hat(q - p[i]) @ A[i]
        inputs, values = [x, R_ref], ca.vertcat(*points) if points else ca.SX(0, 1)
        self._values = OverFrames(ca.Function("soles", inputs, [values], {"cse": True}))
        full = [values, ca.densify(q_x.T)]
        self._full = OverFrames(ca.Function("soles_full", inputs, full, {"cse": True}))

    def places(self, x: Array, R_ref: Array) -> Array:
        """q (T,P,3) m."""
        return self._values(x, np.swapaxes(R_ref, -1, -2))[0].reshape(len(x), self.P, 3)

    def evaluate(self, x: Array, R_ref: Array) -> tuple[Array, Array]:
        """q (T,P,3) m and dq/dx (T,P,3,n)."""
        q, q_x = self._full(x, np.swapaxes(R_ref, -1, -2))
        return q.reshape(len(x), self.P, 3), q_x.reshape(len(x), self.P, 3, self.n)


def standing(
    q: Array, x: Array, rate_hz: float, height_m: float, speed_mps: float, fall: float = 0.7
) -> Array:
    """(T-1,P): the belief that a point of the sole stands still from one frame to the next.

    Evidence: its height over the lowest point, its speed, and the body's fall: who falls freely touches
    nothing. height_m, speed_mps: one sigma of each; fall: share of gravity in the root's downward
    acceleration at which no foot stands. The speed is that under the root's velocity that the feet themselves
    tell: the path in x may have drifted off at any speed.
    """
    T, P = q.shape[:2]
    if T < 2 or not P:
        return np.zeros((max(T - 1, 0), P))
    middle = (q[1:, :, 1] + q[:-1, :, 1]) / 2
    low = np.exp(-(((middle - middle.min(axis=1, keepdims=True)) / height_m) ** 2) / 2)
    moved = np.diff(q - x[:, None, ROOT_P], axis=0) * rate_hz  # relative to the root
    down = -root_acceleration(x[:, ROOT_P][:, 1], rate_hz)[:-1]
    falling = np.clip(down / (fall * ori.GRAVITY), 0, 1)
    firm = low * (1 - falling**4)[:, None]
    stands = firm
    for wide in (4.0, 2.0, 1.0, 1.0):
        root = -(stands[..., None] * moved).sum(axis=1)
        root = smoothed(root, rate_hz) / (smoothed(stands.sum(axis=1), rate_hz)[:, None] + 1e-6)
        speed = np.linalg.norm(moved + root[:, None], axis=-1)
        stands = firm * np.exp(-((speed / (wide * speed_mps)) ** 2) / 2)
    return np.asarray(stands)


def smoothed(a: Array, rate_hz: float, over_s: float = 0.05) -> Array:
    """Along time (T,...), by exponential weights that reach `over_s` to either side."""
    k = int(3 * over_s * rate_hz)
    kernel = np.exp(-np.abs(np.arange(-k, k + 1)) / (over_s * rate_hz))
    return np.asarray(convolve1d(a, kernel / kernel.sum(), axis=0, mode="nearest"))


def root_acceleration(y: Array, rate_hz: float, over_s: float = 0.1) -> Array:
    """(T,) m/s^2 of a height (T,) m, from differences over `over_s` to either side; the ends hold."""
    k = max(1, round(over_s / 2 * rate_hz))
    T = len(y)
    if 2 * k >= T:
        return np.zeros(T)
    inner = (y[2 * k :] - 2 * y[k:-k] + y[: -2 * k]) * (rate_hz / k) ** 2
    return np.concatenate([np.full(k, inner[0]), inner, np.full(k, inner[-1])])
