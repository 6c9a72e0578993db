"""IMUPoser's joint rotation refinement (Mollyn et al. 2023, 4.4): ten Adam steps on the limbs with a device.

For a wrist the elbow and the shoulder turn, for the head neck and head, for a pocket the hip, so that the
bone with the device agrees with the measured orientation M. The loss is the mean square over devices and
entries of R_world_bone - M; the paper leaves the parameters of the rotations open. Here each step moves on
the rotations themselves: R Exp(-step), with Adam's moments (Kingma & Ba 2015) of the gradient with respect
to a rotation vector on the right of R. With S = R_world_bone^T M and v = (S32 - S23, S13 - S31, S21 - S12),
|R_world_bone Exp(d) - M|^2 (Frobenius norm) has the gradient -2 v at d = 0; for the joint before it, whose
child turns by R_b, the gradient is R_b times that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import PoserError, SensorError
from mocap.estimator import Estimator, Pose, Sample
from mocap.orientation import Array
from mocap.skeleton import PARENTS, Skeleton

CHAINS: dict[int, tuple[int, ...]] = {
    18: (16, 18), 19: (17, 19), 15: (12, 15), 1: (1,), 2: (2,),
}  # fmt: skip
"""Joint of an instrumented bone -> the joints that turn for it, from the root outwards."""


@dataclass(frozen=True)
class AdamSettings:
    """steps: per frame (4.4). learning_rate: rad per step, about; the paper states none, this
    one is from validation clips (`benchmarks/networks.py --adam`). The rest are
    Adam's own constants."""

    steps: int = 10
    learning_rate: float = 0.02
    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8

    def __post_init__(self) -> None:
        if self.steps < 0 or not self.learning_rate > 0:
            raise PoserError("Adam needs steps of zero or more and a learning rate above zero")


def refine(
    R_parent_joint: Array, joints: tuple[int, ...], R_measured: Array, settings: AdamSettings
) -> Array:
    """Local rotations (24,3,3) after the steps, for measured rotations (n,3,3) of the bones `joints`."""
    R = np.array(R_parent_joint)
    if not joints or settings.steps == 0:
        return R
    R_world = Skeleton.default().rotations(R)
    # Chains do not meet: nothing before a chain's first joint moves.
    before = [R_world[p] if (p := PARENTS[CHAINS[j][0]]) >= 0 else np.eye(3) for j in joints]
    moving = [j for joint in joints for j in CHAINS[joint]]
    first, second = np.zeros((len(moving), 3)), np.zeros((len(moving), 3))
    for k in range(1, settings.steps + 1):
        g = gradient(R, joints, before, R_measured)
        first = settings.beta1 * first + (1 - settings.beta1) * g
        second = settings.beta2 * second + (1 - settings.beta2) * g * g
        m, v = first / (1 - settings.beta1**k), second / (1 - settings.beta2**k)
        R[moving] = R[moving] @ ori.exp(
            -settings.learning_rate * m / (np.sqrt(v) + settings.epsilon)
        )
    R[moving] = ori.project(R[moving])
    return R


def gradient(
    R_parent_joint: Array, joints: tuple[int, ...], R_world_before: list[Array], R_measured: Array
) -> Array:
    """(m,3): of the loss with respect to a rotation vector on the right of each joint that turns, in the
    chains' order. R_world_before: global rotation of the joint before each chain."""
    found = []
    for joint, R_before, M in zip(joints, R_world_before, R_measured, strict=True):
        chain = CHAINS[joint]
        R_world = R_before
        for j in chain:
            R_world = R_world @ R_parent_joint[j]
        S = R_world.T @ M
        g = np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]])
        g *= -2 / (9 * len(joints))
        rows = [g]
        for j in reversed(chain[1:]):
            g = R_parent_joint[j] @ g
            rows.append(g)
        found += rows[::-1]
    return np.array(found)


@dataclass(frozen=True, eq=False)
class AdamState:
    """network: the wrapped estimator's state. samples: the latest ones, oldest first."""

    network: Any
    samples: tuple[Sample, ...] = ()


class AdamEstimator:
    """`Estimator` around IMUPoser's: its poses, refined with the samples of their time.

    joint (S,): the joint whose rotation each sensor follows. Raises SensorError for one without a chain, and
    for two sensors on one bone.
    """

    def __init__(
        self, network: Estimator, joint: tuple[int, ...], settings: AdamSettings | None = None
    ) -> None:
        self.network, self.settings = network, settings or AdamSettings()
        self.rate_hz, self.sensors = network.rate_hz, network.sensors
        self.look_ahead_frames = network.look_ahead_frames
        self.joint = tuple(int(j) for j in joint)
        odd = [n for n, j in zip(self.sensors, self.joint, strict=True) if j not in CHAINS]
        if odd:
            raise SensorError(f"sensor {', '.join(odd)}: no limb of IMUPoser's refinement")
        if len(set(self.joint)) < len(self.joint):
            worn = ", ".join(map(places.describe, self.sensors, self.joint))
            raise SensorError(f"IMUPoser's refinement takes one sensor a bone, not {worn}")

    def init(self) -> AdamState:
        """A fresh state."""
        return AdamState(self.network.init())

    def step(self, state: AdamState, sample: Sample) -> tuple[AdamState, Pose | None]:
        """Feed one sample; the refined pose of `look_ahead_frames` ago, or None before the first."""
        inner, pose = self.network.step(state.network, sample)
        samples = (*state.samples, sample)[-self.look_ahead_frames - 1 :]
        state = AdamState(inner, samples)
        if pose is None:
            return state, None
        used = [s for s in range(len(self.sensors)) if _usable(samples[0], s)]
        joints = tuple(self.joint[s] for s in used)
        R = refine(pose.R_parent_joint, joints, samples[0].R_world_bone[used], self.settings)
        return state, replace(pose, R_parent_joint=R)


def _usable(sample: Sample, s: int) -> bool:
    R = sample.R_world_bone[s]
    return bool(sample.valid[s]) and bool((np.abs(R) < 2).all()) and bool(ori.is_rotation(R))
