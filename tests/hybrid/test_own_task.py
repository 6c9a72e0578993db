"""Tasks of a user's own: they move the pose as they say, and one that fails costs no frame."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from hybrid import Tracker, TrackerState, rotations, tasks
from hybrid.tasks import Frame, Residual, Task, TaskResult
from mocap import Motion, Recording, synthesis
from mocap import sensors as places
from mocap.estimator import samples
from mocap.synthesis import motions
from tests.hybrid.fake import FakeNetwork, motion_of, run, single


@pytest.fixture(scope="module")
def truth() -> Motion:
    return motions.walk(3.0, 30.0)


@pytest.fixture(scope="module")
def recording(truth: Motion) -> Recording:
    return synthesis.recording(truth, places.FIVE, synthesis.Noise(), 0)


def nodding(truth: Motion) -> FakeNetwork:
    """A network that sees the head 20 degrees lower than it is."""
    error = np.zeros((len(truth), 24, 3))
    error[:, 15, 0] = np.deg2rad(20.0)
    return FakeNetwork(truth, error, places.FIVE, 0, 20.0)


class HeadLevel(Task):
    """The head's up axis points up, within `sigma` rad."""

    def __init__(self, sigma: float = 0.01) -> None:
        self.sigma = sigma

    def term(self, frame: Frame) -> Residual:
        head = frame.at.on(15)
        up = head.R_world_bone[:, 1]
        J = -rotations.hat(up) @ head.J_rotation
        return Residual(up[[0, 2]] / self.sigma, J[[0, 2]] / self.sigma)


def tilt_deg(motion: Motion) -> float:
    up = motion.R_world_joint[20:, 15, :, 1]
    return float(np.rad2deg(np.arccos(np.clip(up[:, 1], -1, 1))).mean())


def test_a_task_of_ones_own_is_added_to_the_standard_ones(
    truth: Motion, recording: Recording
) -> None:
    """Without the head's sensor in the cost nothing else knows that the head is level."""
    settings = single(step_sigma_deg=200.0)
    bare = [t for t in tasks.standard(settings) if not isinstance(t, tasks.Orientation)]
    without, with_it = (
        motion_of(run(Tracker(nodding(truth), settings, tasks=found), recording)[0], truth)
        for found in (bare, [*bare, HeadLevel()])
    )
    assert tilt_deg(without) > 15.0
    assert tilt_deg(with_it) < 2.0


def test_the_standard_tasks_are_those_of_no_list(truth: Motion, recording: Recording) -> None:
    settings = single(positions=True)
    plain, listed = (
        run(Tracker(nodding(truth), settings, tasks=found), recording)[0]
        for found in (None, tasks.standard(settings))
    )
    for a, b in zip(plain, listed, strict=True):
        assert np.array_equal(a.R_parent_joint, b.R_parent_joint)


class Counting(Task):
    """Remembers how many frames it has seen and how many of them were solved."""

    def start(self, worn: Any) -> tuple[int, int]:
        return 0, 0

    def evidence(self, frame: Frame, state: tuple[int, int]) -> TaskResult:
        return TaskResult(None, (state[0] + 1, state[1]), {"counted": 1})

    def follow(self, frame: Frame, state: tuple[int, int], dv: Any) -> tuple[Any, dict[str, int]]:
        assert dv.shape == (len(frame.worn.free), 3)
        return (state[0], state[1] + 1), {}


def test_a_tasks_state_is_handed_on_and_can_be_resumed(truth: Motion, recording: Recording) -> None:
    tracker = Tracker(nodding(truth), single(), tasks=[*tasks.standard(), Counting()])
    state = tracker.init()
    for k, sample in enumerate(samples(recording)):
        if k == 7:
            state = pickle.loads(pickle.dumps(state))
        state, _ = tracker.step(state, sample)
    T = len(recording)
    assert state.memory.tasks[-1] == (T, T) and state.counts["counted"] == T


@pytest.mark.parametrize("how", ["raises", "another width", "not finite", "raises afterwards"])
def test_a_task_that_fails_gives_the_networks_pose_and_its_name(
    truth: Motion, recording: Recording, how: str
) -> None:
    class Broken(Task):
        def term(self, frame: Frame) -> Residual | None:
            n = frame.whitener.shape[1]
            if how == "raises":
                raise KeyError("head")
            if how == "raises afterwards":
                return None
            width = n + 1 if how == "another width" else n
            return Residual(np.zeros(2), np.full((2, width), np.nan))

        def follow(self, frame: Frame, state: Any, dv: Any) -> tuple[Any, dict[str, int]]:
            if how == "raises afterwards":
                raise ZeroDivisionError
            return state, {}

    network = FakeNetwork(truth, None, places.FIVE, 0)
    settings = single(network_memory_s=0)
    poses, state = run(Tracker(network, settings, tasks=[*tasks.standard(), Broken()]), recording)
    alone = run(network, recording)[0]
    for a, b in zip(poses, alone, strict=True):
        assert np.allclose(a.R_parent_joint, b.R_parent_joint, atol=1e-12)
        assert how == "not finite" or "Broken" in a.note
    assert isinstance(state, TrackerState) and state.fallbacks == len(truth)


def test_without_any_task_the_pose_is_the_networks(truth: Motion, recording: Recording) -> None:
    network = FakeNetwork(truth, None, places.FIVE, 0)
    poses, _ = run(Tracker(network, single(network_memory_s=0), tasks=[]), recording)
    alone = run(network, recording)[0]
    for a, b in zip(poses, alone, strict=True):
        assert np.allclose(a.R_parent_joint, b.R_parent_joint, atol=1e-9)
