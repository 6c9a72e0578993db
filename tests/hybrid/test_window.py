"""The moving horizon around a network: better than a frame alone, and never a frame without a pose."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hybrid import Tracker, TrackerSettings, tracker, window
from mocap import Motion, PoserError, Recording, synthesis
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import SolveError
from mocap.estimator import Pose, facts, samples, told_late
from mocap.evaluation import metrics
from mocap.synthesis import motions
from sip import Horizon, Settings
from tests.hybrid.fake import FakeNetwork, run, single, smooth_errors, tracked
from tests.hybrid.test_tracker import HOW, check, spoil

RATE_HZ = 20.0
LATE = 3
PLAIN = Settings()  # without the sensors' constants: quicker
SHORT: dict[str, Any] = {"horizon_s": 0.4, "steps": 1, "cost": PLAIN}


@pytest.fixture(scope="module")
def truth() -> Motion:
    """Some steps."""
    return motions.walk(3.0, RATE_HZ)


@pytest.fixture(scope="module")
def noisy(truth: Motion) -> Recording:
    return synthesis.recording(truth, places.SIX, synthesis.Noise(), 0)


@pytest.fixture(scope="module")
def network(truth: Motion) -> FakeNetwork:
    error = smooth_errors(len(truth), RATE_HZ, 12.0, 1)
    return FakeNetwork(truth, error, places.SIX, LATE, 12.0)


@pytest.fixture(scope="module")
def around(network: FakeNetwork) -> Tracker:
    return Tracker(network, TrackerSettings(**SHORT))


@pytest.fixture(scope="module")
def whole(around: Tracker, noisy: Recording) -> tuple[list[Pose], Any]:
    return run(around, noisy)


def test_the_pose_is_closer_to_the_truth_than_the_frame_alone_finds(
    truth: Motion, noisy: Recording, network: FakeNetwork, whole: tuple[list[Pose], Any]
) -> None:
    alone, frame = tracked(network, noisy)
    R = np.stack([p.R_parent_joint for p in whole[0]])
    p = np.stack([p.p_world_root for p in whole[0]])
    found = [
        metrics.evaluate(m, truth).position_cm
        for m in (Motion(RATE_HZ, R, p, truth.skeleton), frame, alone)
    ]
    assert None not in found and found == sorted(found)  # type: ignore[type-var]


def test_every_frame_has_a_pose_of_its_time_and_a_deviation(
    noisy: Recording, whole: tuple[list[Pose], Any]
) -> None:
    poses, state = whole
    assert np.allclose([p.time_s for p in poses], [s.time_s for s in samples(noisy)])
    assert all(check(p).std_rad is not None and (p.std_rad > 0).all() for p in poses)  # type: ignore[operator]
    assert state.counts["frames"] == len(noisy)


def test_the_root_goes_where_the_feet_walk(truth: Motion, whole: tuple[list[Pose], Any]) -> None:
    p = np.stack([p.p_world_root for p in whole[0]])
    gone, true = p[-1] - p[RATE := int(RATE_HZ)], truth.p_world_root[-1] - truth.p_world_root[RATE]
    assert np.linalg.norm(gone - true) < 0.5 * np.linalg.norm(true)


@pytest.mark.parametrize("lag", [0, 6])
def test_the_lag_is_a_choice(network: FakeNetwork, noisy: Recording, lag: int) -> None:
    estimator = Tracker(network, TrackerSettings(lag=lag, **SHORT))
    assert estimator.look_ahead_frames == lag
    state = estimator.init()
    for k, sample in enumerate(samples(noisy.slice(0, 20))):
        state, pose = estimator.step(state, sample)
        assert (pose is None) == (k < lag)
        assert pose is None or pose.time_s == pytest.approx(sample.time_s - lag / RATE_HZ)
    assert state.fallbacks <= 1 and facts(estimator, state)["lag_frames"] == lag


def test_resumed_from_a_pickled_state_equals_uninterrupted(
    around: Tracker, noisy: Recording, whole: tuple[list[Pose], Any]
) -> None:
    state, poses = around.init(), []
    for k, sample in enumerate(samples(noisy)):
        if k == 20:
            before = pickle.dumps(state)
            state = pickle.loads(before)
        state, pose = around.step(state, sample)
        poses += [] if pose is None else [pose]
    for a, b in zip(whole[0], poses, strict=False):
        assert np.abs(a.R_parent_joint - b.R_parent_joint).max() < 1e-5
        assert np.abs(a.p_world_root - b.p_world_root).max() < 1e-3 and a.note == b.note


def test_a_window_that_fails_is_replaced_by_the_frame_alone_and_begun_anew(
    around: Tracker, noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, failing = list(samples(noisy)), [20, 21]
    state, poses = around.init(), []
    step = Horizon.step

    def fails(self: Horizon, *args: Any, **kwargs: Any) -> Any:
        if state.received in failing:
            raise SolveError("the window's cost is not finite")
        return step(self, *args, **kwargs)

    monkeypatch.setattr(Horizon, "step", fails)
    for sample in rows:
        state, pose = around.step(state, sample)
        poses.append(pose)
    notes = [p.note for p in poses if p is not None]
    # From the first failure until the new window, begun at 22, holds the frame that is due.
    gone = [k for k, p in enumerate(poses) if p is not None and window.FAILED in p.note]
    assert gone == list(range(20, 22 + LATE)) and len(notes) == len(rows) - LATE
    assert state.counts[window.FAILED] == len(gone)
    p = np.stack([check(q).p_world_root for q in poses if q is not None])
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() < 0.3


def test_a_gap_in_time_begins_a_new_window_where_the_path_had_led(
    around: Tracker, noisy: Recording
) -> None:
    rows = list(samples(noisy))
    rows[25:] = [replace(s, time_s=s.time_s + 9) for s in rows[25:]]
    state, poses = around.init(), []
    for sample in rows:
        state, pose = around.step(state, sample)
        poses.append(pose)
    noted = [k for k, p in enumerate(poses) if p is not None and tracker.TIME_GAP in p.note]
    assert noted == list(range(25, 25 + LATE))
    p = np.stack([check(q).p_world_root for q in poses if q is not None])
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() < 0.3


def test_a_machine_too_slow_has_a_shorter_window_and_then_none_and_still_every_pose(
    network: FakeNetwork, noisy: Recording
) -> None:
    estimator = Tracker(network, TrackerSettings(budget_s=1e-9, **SHORT))
    state, poses = estimator.init(), []
    for sample in samples(noisy):
        state, pose = estimator.step(state, sample)
        poses += [] if pose is None else [check(pose)]
    assert len(poses) == len(noisy) - LATE
    told = facts(estimator, state)
    assert told["window_frames"] < told["window_frames_most"]
    assert told["window_events"][window.SHORTENED] > 0
    assert told["steps_per_frame"] == 1
    assert any(window.NO_TIME in p.note for p in poses)


def test_a_frame_that_is_late_has_a_shorter_window_whatever_took_the_time(
    network: FakeNetwork, noisy: Recording
) -> None:
    """The estimator itself has all the time of the world; 0.1 s late: the shortest window; 0.2 s: none."""
    estimator = Tracker(network, TrackerSettings(budget_s=1e3, **SHORT))
    state, sizes = estimator.init(), []
    for k, sample in enumerate(samples(noisy)):
        state = told_late(estimator, state, 0.0 if k < 20 else 0.1 if k < 40 else 0.2)
        state, pose = estimator.step(state, sample)
        sizes.append(facts(estimator, state)["window_frames"])
    assert estimator.window is not None and estimator.window.least < sizes[0]
    assert set(sizes[:20]) == {estimator.window.most} and sizes[39] == estimator.window.least
    assert pose is not None and window.NO_TIME in pose.note


def test_many_missing_frames_begin_a_new_window_where_time_is_short(
    network: FakeNetwork, noisy: Recording
) -> None:
    """Blank frames take as long as those that are there."""
    rows = [s for k, s in enumerate(samples(noisy)) if not 25 <= k < 29]
    for budget_s, fills in ((None, True), (1e3, False)):
        how = TrackerSettings(budget_s=budget_s, gap_s=0.5, **SHORT)
        estimator = Tracker(network, how)
        state = estimator.init()
        for sample in rows[:26]:
            state, _ = estimator.step(state, sample)
        assert state.window is not None and (len(state.window.times) > 1) is fills


@pytest.mark.parametrize("names", [places.SIX, ("left_wrist", "right_pocket")], ids=len)
def test_broken_samples_give_poses_all_the_same(truth: Motion, names: tuple[str, ...]) -> None:
    recording = synthesis.recording(truth, names, synthesis.Noise(), 1)
    stand_in = FakeNetwork(truth, smooth_errors(len(truth), RATE_HZ, 10.0, 2), names, 2, 10.0)
    estimator = Tracker(stand_in, TrackerSettings(**SHORT))
    rng = np.random.default_rng(0)
    state, given = estimator.init(), 0
    for k, sample in enumerate(samples(recording)):
        how = HOW[(k // 2) % len(HOW)] if k % 2 else ""
        state, pose = estimator.step(state, spoil(sample, how, rng) if how else sample)
        given += pose is not None and bool(check(pose).note is not None)
    assert given == len(recording) - 2


def test_the_world_turned_turns_the_answer(
    truth: Motion, noisy: Recording, whole: tuple[list[Pose], Any]
) -> None:
    yaw = 2.3
    error = smooth_errors(len(truth), RATE_HZ, 12.0, 1)
    turned_network = FakeNetwork(truth.turned(yaw), error, places.SIX, LATE, 12.0)
    turned, _ = run(Tracker(turned_network, TrackerSettings(**SHORT)), noisy.turned(yaw))
    for a, b in zip(whole[0], turned, strict=True):
        expected = np.array(a.R_parent_joint)
        expected[0] = ori.rot_y(yaw) @ expected[0]
        assert np.rad2deg(ori.angle_between(expected, b.R_parent_joint)).max() < 0.5


def test_a_heading_that_is_off_is_found_and_told(truth: Motion) -> None:
    clean = synthesis.recording(truth, places.SIX)
    R = np.array(clean.R_world_bone)
    wrist = clean.sensors.index("left_forearm")
    R[:, wrist] = ori.rot_y(np.deg2rad(12.0)) @ R[:, wrist]
    recording = replace(clean, R_world_bone=R)
    stand_in = FakeNetwork(truth, None, places.SIX, LATE, 5.0)
    estimator = Tracker(stand_in, TrackerSettings(horizon_s=0.4, steps=1))
    _, state = run(estimator, recording)
    told = facts(estimator, state)["heading_deg"]
    assert max(told, key=lambda n: abs(told[n])) == "left_forearm"


def test_settings_are_checked(network: FakeNetwork) -> None:
    for odd in ({"horizon_s": -1.0}, {"budget_s": 0.0}, {"steps": 0}, {"lag": -1}):
        with pytest.raises(PoserError, match=next(iter(odd))):
            TrackerSettings(**odd)  # type: ignore[arg-type]
    with pytest.raises(PoserError, match="needs a window"):
        single(lag=3)
    assert facts(Tracker(network, single()), Tracker(network, single()).init()) == {
        "window_frames": 0
    }
