"""Where the root is: foot contacts, leg kinematics, the pelvis sensor's acceleration, and the ground.

A foot that stands does not move, so the root moves as the leg under it says: v_root = -d/dt (p_foot -
p_root). Which foot stands is not measured; the evidence is its height over the lower foot and its speed
under the present estimate of the root's velocity. A Kalman filter per axis (position, velocity) takes the
pelvis acceleration as input, each foot's velocity with a deviation that grows as the evidence shrinks, and
the ground's height from the lower foot. In a jump both feet are fast or the body falls freely, and the
filter runs on the accelerometer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.skeleton import TOES, Skeleton

LEGS = ((1, 2), (4, 5), (7, 8), TOES)  # left and right: hip, knee, ankle, toe
UP = np.array([0.0, 1.0, 0.0])
_JOINTS = np.array(LEGS)


@dataclass(frozen=True)
class ContactNoise:
    """1 sigma. acc: m/s^2, correlated over acc_s, of the pelvis acceleration (bias and heading in it);
    blind_acc, blind_s: the same where it is not measured. foot_speed: m/s of a standing foot by the leg
    kinematics. height: m over the lower foot, and speed: m/s, at which a foot is no longer believed to
    stand. ground: m, of the ground's height by the lower foot. fall: share of gravity in the downward
    acceleration at which no foot stands.
    """

    acc: float = 0.3
    acc_s: float = 0.5
    blind_acc: float = 2.0
    blind_s: float = 0.2
    foot_speed: float = 0.1
    height: float = 0.03
    speed: float = 0.25
    ground: float = 0.03
    fall: float = 0.7


@dataclass(frozen=True, eq=False)
class RootState:
    """p (3,) m and v (3,) m/s of the pelvis joint in the world, the ground at y = 0.

    NaN in p: not placed yet. covariance (3,3): rows pp m^2, pv m^2/s, vv m^2/s^2, columns the axes.
    soles (2,2,3) m: see `Contact.soles`, a frame ago; None at the start and after a gap.
    standing (2,): the belief that each foot stands, 0 to 1.
    """

    p: Array
    v: Array
    covariance: Array
    soles: Array | None
    standing: Array

    @property
    def std_m(self) -> Array:
        """(3,) m: deviation of the root's position."""
        return np.sqrt(self.covariance[0])


def start() -> RootState:
    """Not placed yet."""
    return RootState(np.full(3, np.nan), np.zeros(3), np.zeros((3, 3)), None, np.zeros(2))


class Contact:
    """The constants of a skeleton; all that changes is in `RootState`."""

    def __init__(self, skeleton: Skeleton, noise: ContactNoise | None = None) -> None:
        self.noise = noise or ContactNoise()
        rest = skeleton.rest_positions
        floor = rest[list(TOES), 1].min() - skeleton.sole
        # T_parent_joint (4,2,4,4) of the legs at rest; each frame puts its rotations into a copy.
        self._legs = np.tile(np.eye(4), (4, 2, 1, 1))
        self._legs[..., :3, 3] = skeleton.offsets[_JOINTS]
        # The sole is flat in the rest pose: each point lies straight under its joint.
        self._under = np.zeros((2, 2, 4, 1))
        self._under[..., 1, 0] = floor - rest[_JOINTS[2:], 1]
        self._under[..., 3, 0] = 1.0

    def soles(self, R_parent_joint: Array) -> Array:
        """(2,2,3) m: points under ankle and toe (first axis) of left and right, relative to the
        pelvis joint, world axes, of local rotations (24,3,3).
        """
        T = self._legs.copy()
        T[..., :3, :3] = R_parent_joint[_JOINTS]
        T_root_ankle = T[0] @ T[1] @ T[2]
        T_root_foot = np.array([T_root_ankle, T_root_ankle @ T[3]])
        return (T_root_foot @ self._under)[..., :3, 0] @ R_parent_joint[0].T

    def step(
        self,
        state: RootState,
        soles: Array,
        acc_pelvis: Array,
        dt: float,
        at: Array,
    ) -> RootState:
        """One frame of dt s. soles: see `soles`. acc_pelvis (3,) m/s^2, NaN where not measured.

        at (3,) m: where to start, horizontally; the height comes from the ground. After a gap
        (state.soles None) the path goes on where it was.
        """
        n = self.noise
        lowest = float(soles[..., 1].min())
        if state.soles is None:
            p = np.where(np.isfinite(state.p), state.p, at)
            p[1] = -lowest
            covariance = np.outer([n.ground**2, 0.0, n.speed**2], np.ones(3))
            return RootState(p, np.zeros(3), covariance, soles, np.ones(2) / 2)
        measured = bool(np.isfinite(acc_pelvis).all())
        acc = acc_pelvis if measured else np.zeros(3)
        sigma, memory = (n.acc, n.acc_s) if measured else (n.blind_acc, n.blind_s)
        p = state.p + state.v * dt + acc * dt**2 / 2
        v = state.v + acc * dt
        S = 2 * sigma**2 * memory
        # Exact for white acceleration of density S: see `hybrid.motion_filter`.
        pp, pv, vv = state.covariance
        pp = pp + 2 * dt * pv + dt**2 * vv + S * dt**3 / 3
        pv = pv + dt * vv + S * dt**2 / 2
        vv = vv + S * dt
        # Of each foot the point that stands is the lower one.
        lower = soles[..., 1].argmin(axis=0)
        foot = soles[lower, [0, 1]]
        velocity = (foot - state.soles[lower, [0, 1]]) / dt
        standing = self._standing(foot[:, 1] - lowest, velocity, v, acc, vv)
        # Two measurements of one velocity are one: their mean, weighted by their information.
        information = np.maximum(standing, 1e-3) ** 4 / n.foot_speed**2
        variance = 1 / information.sum()
        gain_p, gain_v = pv / (vv + variance), vv / (vv + variance)
        error = -variance * (information @ velocity) - v
        p, v = p + gain_p * error, v + gain_v * error
        pp, pv, vv = pp - gain_p * pv, pv - gain_p * vv, vv - gain_v * vv
        # Whoever is below the ground by more than the ground is uncertain, is not: standing or not.
        sure = 1.0 if p[1] < -lowest - n.ground else max(standing.max(), 1e-3)
        total = pp + n.ground**2 / sure**4
        gain_p, gain_v = UP * pp / total, UP * pv / total
        error = -lowest - p
        p, v = p + gain_p * error, v + gain_v * error
        covariance = np.array([pp - gain_p * pp, pv - gain_p * pv, vv - gain_v * pv])
        return RootState(p, v, covariance, soles, standing)

    def _standing(
        self, height: Array, velocity: Array, v_root: Array, acc: Array, vv: Array
    ) -> Array:
        """(2,): belief that each foot stands, from its height, its speed and the body's fall."""
        n = self.noise
        speed_squared = ((velocity + v_root) ** 2).sum(axis=1)
        # An uncertain root velocity makes every foot look fast: that much proves nothing.
        allowed = n.speed**2 + vv.sum()
        falling = min(max(-acc[1] / (n.fall * ori.GRAVITY), 0.0), 1.0)
        doubt = (height / n.height) ** 2 + speed_squared / allowed
        return np.exp(-doubt / 2) * (1 - falling**4)
