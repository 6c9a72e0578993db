"""Rates that are not the network's, broken clocks, broken samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from learned.online import resampling
from learned.online.estimator import NetworkEstimate, Online, standing
from mocap import Motion, Recording, Skeleton, synthesis
from mocap import orientation as ori
from mocap.estimator import Sample, replay, samples
from mocap.orientation import Array
from mocap.skeleton import TABLE_STATURE
from mocap.synthesis import motions


class Echo:
    """A network whose pose is what it was shown `future` frames ago, and that notes what it was shown."""

    def __init__(self, rate_hz: float, future: int) -> None:
        self.rate_hz, self.future, self.sensors = rate_hz, future, ("pelvis", "head")
        self.seen: list[tuple[Array, Array]] = []

    def tick(
        self,
        state: tuple[Array, ...] | None,
        R: Array,
        acc: Array,
        present: NDArray[np.bool_],
        jumped: bool,
    ) -> tuple[tuple[Array, ...], NetworkEstimate | None]:
        self.seen.append((R, acc))
        assert np.isfinite(R).all() and np.isfinite(acc).all()
        state = (*(state or ()), R)[-self.future - 1 :]
        if len(state) <= self.future:
            return state, None
        local = np.tile(np.eye(3), (24, 1, 1))
        local[:2] = state[0]
        return state, NetworkEstimate(local, np.zeros((24, 3)))


def made(rate_hz: float, s: float = 1.0) -> Recording:
    motion = motions.walk(4.0, 300.0).slice(300, 300 + round(s * 300) + 1).resampled(rate_hz)
    rec = synthesis.recording(motion, ("pelvis", "head"), synthesis.NOISES["none"], 0)
    return rec.slice(1, len(rec) - 1)


@pytest.mark.parametrize("network_hz", [25.0, 60.0])
@pytest.mark.parametrize("future", [0, 5])
@pytest.mark.parametrize("rate_hz", [20.0, 25.0, 30.0, 60.0, 100.0, 120.0, 240.0])
def test_the_pose_of_each_sample_comes_when_promised(
    rate_hz: float, network_hz: float, future: int
) -> None:
    """The echo's pose, resampled twice, is the measured orientation again, as near as interpolation is."""
    rec = made(rate_hz)
    estimator = Online(Echo(network_hz, future), rate_hz)
    state, poses = estimator.init(), []
    for k, sample in enumerate(samples(rec)):
        state, pose = estimator.step(state, sample)
        assert (pose is None) == (k < estimator.look_ahead_frames)
        poses += [pose] if pose else []
    R = np.stack([p.R_parent_joint[:2] for p in poses])
    want = rec.R_world_bone[: len(poses)]
    exact = rate_hz == network_hz
    assert ori.angle_between(want, R).max() < (1e-12 if exact else np.deg2rad(2.5))
    np.testing.assert_allclose([p.time_s for p in poses], rec.start_s + np.arange(len(R)) / rate_hz)
    if exact:
        assert estimator.look_ahead_frames == future


@pytest.mark.parametrize("rate_hz", [50.0, 75.0, 100.0])
def test_a_whole_multiple_gives_the_second_difference_at_the_networks_rate(rate_hz: float) -> None:
    fast = made(rate_hz)
    network = Echo(25.0, 0)
    estimator = Online(network, rate_hz)
    state = estimator.init()
    for sample in samples(fast):
        state, _ = estimator.step(state, sample)
    n = round(rate_hz / 25)
    assert fast.reference is not None
    seat = fast.placement
    R, p = fast.reference.R_world_joint[:, fast.joint], fast.reference.p_world_joint[:, fast.joint]
    p = p + (R @ seat[:, :, None])[..., 0]
    want = (p[: -2 * n] - 2 * p[n:-n] + p[2 * n :])[::n] * 25.0**2
    acc = np.stack([a for _, a in network.seen])
    count = min(len(acc) - 1, len(want))
    assert count > 15 and np.abs(want).max() > 1
    np.testing.assert_allclose(acc[1 : count + 1], want[:count], atol=1e-6)


def test_60_to_25_hz_is_close_to_the_second_difference_at_25_hz() -> None:
    """2.4 samples a tick: the weights are no longer exact; the error stays far below sensor noise."""
    network = Echo(25.0, 0)
    estimator = Online(network, 60.0)
    state = estimator.init()
    rec = made(60.0, 2.0)
    for sample in samples(rec):
        state, _ = estimator.step(state, sample)
    motion = motions.walk(4.0, 300.0).slice(305, 906)  # from the recording's first frame on
    slow = synthesis.recording(
        motion.resampled(25.0), ("pelvis", "head"), synthesis.NOISES["none"], 0
    )
    count = min(len(network.seen), len(slow)) - 2
    acc = np.stack([a for _, a in network.seen])[1:count]
    off = acc - slow.acc_world[1:count]
    assert np.sqrt(np.mean(off**2)) < 0.2 < np.sqrt(np.mean(acc**2))


@given(
    seed=st.integers(0, 2**32 - 1),
    rate_hz=st.sampled_from([20.0, 25.0, 60.0, 100.0, 144.0]),
    future=st.integers(0, 6),
)
@settings(max_examples=60, deadline=None)
def test_whatever_comes_every_sample_gets_a_pose(seed: int, rate_hz: float, future: int) -> None:
    rng = np.random.default_rng(seed)
    estimator = Online(Echo(60.0, future), rate_hz)
    state, count, now = estimator.init(), 0, 0.0
    for _ in range(40):
        R = ori.exp(rng.normal(size=(2, 3)))
        acc = rng.normal(size=(2, 3))
        bad = rng.choice([np.nan, np.inf, -np.inf, 1e300, 0.0])
        R[rng.uniform(size=2) < 0.1] = bad
        acc[rng.uniform(size=2) < 0.1] = bad
        dt = rng.choice(
            [1 / rate_hz, 0.3 / rate_hz, 0.2, 0.0, -3.0, 7.0], p=[0.6, 0.1, 0.1, 0.1, 0.05, 0.05]
        )
        now += dt
        stamp = np.nan if rng.uniform() < 0.05 else now
        state, pose = estimator.step(state, Sample(stamp, R, acc, rng.uniform(size=2) < 0.9))
        if pose is not None:
            count += 1
            assert ori.is_rotation(pose.R_parent_joint).all()
            assert np.isfinite(pose.time_s)
    assert count == 40 - estimator.look_ahead_frames
    assert len(state.recent) < 200 and len(state.answers) < 200


@pytest.mark.parametrize("late", [1, 2, 3, 7])
@pytest.mark.parametrize("rate_hz", [20.0, 30.0, 60.0, 70.0, 100.0])
def test_what_stands_for_nothing_is_never_shown(rate_hz: float, late: int) -> None:
    """Sensors that never move: once they are there, no identity and no zero is mixed into their values."""
    R0, acc0 = (
        ori.exp(np.array([[0.4, 2.0, 0.1], [1.5, 0.3, 0.0]])),
        np.array([[3.0, 1, 2], [4, 5, 6]]),
    )
    shown = []

    class Noting(Echo):
        def tick(self, *given: Any) -> Any:
            shown.append(given[3])
            return super().tick(*given)

    network = Noting(25.0, 0)
    estimator = Online(network, rate_hz)
    state = estimator.init()
    for k in range(round(rate_hz)):
        valid = np.array([k > 0, k >= late])
        R, acc = np.where(valid[:, None, None], R0, np.nan), np.where(valid[:, None], acc0, np.nan)
        state, _ = estimator.step(state, Sample(k / rate_hz, R, acc, valid))
    assert not shown[0].all() and shown[-1].all()
    for (R, acc), there in zip(network.seen, shown, strict=True):
        np.testing.assert_allclose(R[there], R0[there], atol=1e-9)
        np.testing.assert_allclose(acc[there], acc0[there], atol=1e-9)


class Shy(Echo):
    """Knows nothing of its first three frames."""

    def tick(self, *frame: Any) -> tuple[tuple[Array, ...], NetworkEstimate | None]:
        state, answer = super().tick(*frame)
        return state, answer if len(self.seen) > self.future + 3 else None


@pytest.mark.parametrize("future", [0, 2, 5])
@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 100.0])
def test_frames_without_an_answer_get_the_next_one_that_there_is(
    rate_hz: float, future: int
) -> None:
    """And no later frame is answered for by another's."""
    rec = made(rate_hz, 2.0)
    plain, shy = (Online(n(60.0, future), rate_hz) for n in (Echo, Shy))
    state, other, a, b = plain.init(), shy.init(), [], []
    for sample in samples(rec):
        state, p = plain.step(state, sample)
        other, q = shy.step(other, sample)
        assert (p is None) == (q is None)
        a, b = a + ([p] if p else []), b + ([q] if q else [])
    known = [k for k, q in enumerate(b) if not q.note]
    late = int(np.ceil(3 / 60.0 * rate_hz))  # from here on the network knows both ends
    assert known == list(range(known[0], len(b))) and known[0] <= late
    for p, q in list(zip(a, b, strict=True))[late:]:
        assert np.array_equal(p.R_parent_joint, q.R_parent_joint) and p.time_s == q.time_s
    first = b[known[0]].R_parent_joint
    early = [k for k in known if k / rate_hz <= 3 / 60.0]
    assert all(np.abs(b[k].R_parent_joint - first).max() < 1e-9 for k in early)


def test_losses_are_held() -> None:
    rec = made(60.0)
    valid = np.ones((len(rec), 2), bool)
    valid[10:15, 1] = False
    network = Echo(60.0, 0)
    estimator = Online(network, 60.0)
    state = estimator.init()
    for sample in samples(replace(rec, valid=valid)):
        state, _ = estimator.step(state, sample)
    R = np.stack([R for R, _ in network.seen])
    want = rec.R_world_bone.copy()
    want[10:15, 1] = want[9, 1]
    np.testing.assert_allclose(R, want, atol=1e-12)


def test_replay_is_aligned_and_keeps_the_pelvis_at_its_height() -> None:
    rec = made(100.0)
    body = Skeleton.default(1.9)
    done = replay(Online(Echo(60.0, 5), 100.0, body), rec, skeleton=body)
    assert isinstance(done.motion, Motion) and len(done.motion) == len(rec) == len(done.frame_s)
    # The last frames hold the last sample, the others agree.
    off = ori.angle_between(rec.R_world_bone, done.motion.R_parent_joint[:, :2])
    assert off.max() < np.deg2rad(2.5)
    assert done.fallbacks == 0 and not done.notes and done.std_rad is not None
    toes = body.rest_positions[[10, 11], 1].min() - body.rest_positions[0, 1]
    np.testing.assert_allclose(done.motion.p_world_root, np.tile(standing(body), (len(rec), 1)))
    assert standing(body)[1] + toes == pytest.approx(0.02 * 1.9 / TABLE_STATURE)


def test_look_ahead_in_words() -> None:
    assert resampling.look_ahead(60.0, 60.0, 5) == 5
    assert (
        resampling.look_ahead(120.0, 60.0, 5) == 14
    )  # 6 ticks and the average's half-width: 7 / 60 s
    assert resampling.look_ahead(60.0, 25.0, 0) == 5  # 2 / 25 s = 4.8 samples
