"""Sensors are where their accelerations say, relative to the pelvis sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hybrid import motion_filter, rotations
from hybrid.motion_filter import FilterNoise, SensorMotion
from hybrid.point_kinematics import Configuration
from hybrid.tasks.task import Frame, Residual, Task, TaskResult
from hybrid.worn import Worn
from mocap.orientation import Array


class PositionState(NamedTuple):
    """motion: the sensors' filters, p relative to the pelvis sensor. refused_s (S,): for how long each one's
    predictions have been refused. refused (S,): whether this frame's was."""

    motion: SensorMotion
    refused_s: Array
    refused: np.ndarray


class Position(Task):
    """(p - p_predicted) / sigma of each limb's sensor, sigma the motion filter's (`hybrid.motion_filter`).

    gate_sigma: predicted positions further off are refused, in sigmas of the innovation. robust_sigma: beyond
    it the cost is linear. restart_after_s: of refusals in a row, after which a sensor's filter starts anew.
    noise: the filters'. Says nothing where no sensor is worn at the pelvis.
    """

    def __init__(
        self,
        gate_sigma: float = 4.0,
        robust_sigma: float = 2.0,
        restart_after_s: float = 0.25,
        noise: FilterNoise | None = None,
    ) -> None:
        self.gate_sigma, self.robust_sigma = gate_sigma, robust_sigma
        self.restart_after_s = restart_after_s
        self.noise = noise or FilterNoise()

    def start(self, worn: Worn) -> PositionState:
        """Filters that have not started."""
        S = len(worn.joint)
        return PositionState(motion_filter.stopped(S), np.zeros(S), np.zeros(S, bool))

    def evidence(self, frame: Frame, state: PositionState) -> TaskResult:
        """Predicts to the frame's time. Counts "position refused": predictions past the gate."""
        worn, sample = frame.worn, frame.sample
        if worn.pelvis is None:
            return TaskResult(None, state)
        acc = np.where(sample.valid[:, None], sample.acc_world, np.nan)
        motion = motion_filter.predict(state.motion, acc - acc[worn.pelvis], frame.dt, self.noise)
        use = (motion.running & worn.limbs).nonzero()[0]
        p, J = relative(frame.at, worn.pelvis)
        placed = residual(
            p[use], J[use], motion.p[use], motion.covariance[use, 0],
            frame.sigma.ravel() ** 2, self.gate_sigma, self.robust_sigma,
        )  # fmt: skip
        refused = np.zeros(len(worn.joint), bool)
        refused[use] = placed.refused
        counts = {"position refused": int(refused.sum())}
        return TaskResult(placed.term, PositionState(motion, state.refused_s, refused), counts)

    def follow(
        self, frame: Frame, state: PositionState, dv: Array
    ) -> tuple[PositionState, Mapping[str, int]]:
        """The filters after the solve. Counts "filter restarted"."""
        worn, sample, motion = frame.worn, frame.sample, state.motion
        if worn.pelvis is None:
            return state, {}
        p, J = relative(frame.at, worn.pelvis)
        solved = p + J @ dv.ravel()
        refused_s = np.where(state.refused, state.refused_s + frame.dt, 0.0)
        again = refused_s > self.restart_after_s
        measured = sample.valid & np.isfinite(sample.acc_world).all(axis=1)
        begin = worn.limbs & ~motion.running & measured & measured[worn.pelvis]
        used = motion.running & worn.limbs & ~state.refused
        variance = self.noise.solved_variance(frame.dt)
        motion = motion_filter.update(motion, solved, used, variance)
        motion = motion_filter.start(motion, solved, begin | again, self.noise)
        refused_s = np.where(again, 0.0, refused_s)
        counts = {"filter restarted": int(again.sum())}
        return PositionState(motion, refused_s, state.refused), counts


def relative(at: Configuration, origin: int) -> tuple[Array, Array]:
    """p (S,3) m of all sensors relative to the sensor `origin`, world axes, and J (S,3,n)."""
    return at.p_world - at.p_world[origin], at.J_position - at.J_position[origin]


class Placed(NamedTuple):
    """The term, how far off each prediction is in sigmas, and which ones the gate refused."""

    term: Residual
    innovation: Array
    refused: np.ndarray


def residual(
    p: Array, J: Array, predicted: Array, variance: Array, prior: Array, gate: float, robust: float
) -> Placed:
    """(p - predicted) / sqrt(variance) for sensor positions p (m,3) m with Jacobians J (m,3,n).

    predicted (m,3) m, variance (m,) m^2 per axis: the motion filter's. prior (n,): variance in rad^2 of
    dv by the network, from which the innovation's own variance follows: variance + tr(J prior J^T) / 3.
    A prediction more than `gate` sigmas of the innovation away is refused; one more than `robust` sigmas
    of its own away counts linearly (Huber: weight robust / distance).
    """
    distance = rotations.norm(p - predicted)
    spread = variance + (J**2 @ prior).sum(axis=1) / 3
    innovation = distance / np.sqrt(spread)
    refused = ~(innovation <= gate)
    sigmas = distance / np.sqrt(variance)
    weight = np.where(refused, 0.0, np.minimum(1.0, robust / np.maximum(sigmas, 1e-9)))
    root = np.sqrt(weight / variance)
    e = np.where(refused[:, None], 0.0, p - predicted) * root[:, None]
    term = Residual(e.ravel(), (J * root[:, None, None]).reshape(-1, J.shape[-1]))
    return Placed(term, innovation, refused)
