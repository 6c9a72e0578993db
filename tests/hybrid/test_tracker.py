"""The tracker: what must not move does not, what should get better does, and every frame has a pose."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid import Tracker, TrackerSettings, tracker
from hybrid.motion_filter import FilterNoise
from hybrid.refinement import NO_MEASUREMENT, NOT_CONVERGED
from mocap import Motion, PoserError, Recording, synthesis
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import SensorError
from mocap.estimator import Pose, Sample, samples
from mocap.evaluation import metrics
from mocap.synthesis import motions
from tests.hybrid.fake import FakeNetwork, run, single, smooth_errors, tracked

RATE_HZ = 30.0


@pytest.fixture(scope="module")
def truth() -> Motion:
    """A walk, then arms raised."""
    return motions.joined([motions.walk(3.0, RATE_HZ), motions.arm_raises(1.5, RATE_HZ)])


@pytest.fixture(scope="module")
def noisy(truth: Motion) -> Recording:
    return synthesis.recording(truth, places.SIX, synthesis.Noise(), 0)


def erring(truth: Motion, names: tuple[str, ...] = places.SIX, seed: int = 1) -> FakeNetwork:
    error = smooth_errors(len(truth), truth.rate_hz, 8.0, seed)
    return FakeNetwork(truth, error, names, 5, 8.0)


@pytest.mark.parametrize("names", [places.SIX, places.FIVE, ("right_pocket",)], ids=len)
def test_nothing_moves_where_measurement_and_network_agree(
    truth: Motion, names: tuple[str, ...]
) -> None:
    recording = synthesis.recording(truth, names)
    plain = single(network_memory_s=0)
    alone, refined = tracked(FakeNetwork(truth, names=names), recording, settings=plain)
    moved = np.rad2deg(ori.angle_between(alone.R_parent_joint, refined.R_parent_joint))
    assert moved.max() < 0.5
    assert np.median(moved) < 0.01


@pytest.mark.parametrize(
    "names", [places.SIX, places.FIVE, places.FIVE[:2], ("head",), ("left_pocket",)], ids=len
)
def test_the_refined_pose_is_closer_to_the_truth(truth: Motion, names: tuple[str, ...]) -> None:
    recording = synthesis.recording(truth, names, synthesis.Noise(), 0)
    alone, refined = tracked(erring(truth, names), recording)
    before, after = (
        metrics.evaluate(m, truth, recording=recording, seen=names) for m in (alone, refined)
    )
    assert after.instrumented_deg < 0.5 * before.instrumented_deg
    assert after.jitter <= before.jitter
    for name in ("global_deg", "sip_deg", "position_cm"):
        better = {6: 0.8, 5: 0.9, 2: 0.97, 1: 1.01}[len(names)]
        assert getattr(after, name) < better * getattr(before, name), name


def test_with_a_pelvis_sensor_the_root_is_what_it_measures(truth: Motion, noisy: Recording) -> None:
    poses, _ = run(Tracker(erring(truth), single()), noisy)
    pelvis = noisy.sensors.index("pelvis")
    seen = noisy.valid[:, pelvis]
    R = np.stack([p.R_parent_joint[0] for p in poses])
    assert np.allclose(R[seen], noisy.R_world_bone[seen, pelvis], atol=1e-9)


def test_accelerations_reach_the_pose(truth: Motion) -> None:
    """Sensors without noise on arms that swing, a network that leaves half of the swing out: the wrists
    of the pose with positions are nearer to the true ones, relative to the pelvis, than without.
    """
    motion = motions.arm_raises(4.0, RATE_HZ)
    recording = synthesis.recording(motion, places.SIX)
    error = np.zeros((len(motion), 24, 3))
    t = np.arange(len(motion)) / RATE_HZ
    # Collar and shoulder err against each other: the forearm's orientation does not see it.
    error[:, 13, 2] = 0.3 * np.sin(2 * np.pi * 1.0 * t)
    network = FakeNetwork(motion, error, places.SIX, 0, 10.0)
    calm = FilterNoise(white=0.02, bias=0.005)

    def wrist_cm(settings: TrackerSettings) -> float:
        p = tracked(network, recording, settings=settings)[1]
        off = (p.p_world_joint - p.p_world_root[:, None]) - (
            motion.p_world_joint - motion.p_world_root[:, None]
        )
        return float(100 * np.linalg.norm(off[30:, 20], axis=-1).mean())

    without = wrist_cm(single(positions=False))
    assert wrist_cm(single(positions=True, filter_noise=calm)) < 0.9 * without


def test_time_frames_and_uncertainty_of_the_poses(truth: Motion, noisy: Recording) -> None:
    network = erring(truth)
    poses, state = run(Tracker(network, single()), noisy)
    assert len(poses) == len(noisy)
    assert np.allclose([p.time_s for p in poses], [s.time_s for s in samples(noisy)])
    deviation = np.stack([p.std_rad for p in poses if not p.note and p.std_rad is not None])
    assert np.all(deviation > 0) and np.all(deviation <= np.deg2rad(8.0) + 1e-9)
    # Below a sensor nothing was learnt. Hip and knee, 8 deg each, share one measurement of 8 deg: each
    # is left with s^2 - s^4 / (3 s^2) = 2/3 s^2.
    assert np.allclose(deviation[:, 7], np.deg2rad(8.0))
    knee = np.median(deviation[:, 4], axis=0)  # in a few frames the shank's sample is lost
    assert np.allclose(knee, np.deg2rad(8.0) * np.sqrt(2 / 3), rtol=1e-3)
    assert isinstance(state, tracker.TrackerState)
    assert state.counts["frames"] == len(noisy)


def test_resumed_from_pickled_states_equals_uninterrupted(truth: Motion, noisy: Recording) -> None:
    network = erring(truth)
    whole, _ = run(Tracker(network, single()), noisy)
    state, poses = Tracker(network, single()).init(), []
    for k, sample in enumerate(samples(noisy)):
        if k % 40 == 7:
            state = pickle.loads(pickle.dumps(state))
            estimator = Tracker(network, single())
        elif k == 0:
            estimator = Tracker(network, single())
        before = pickle.dumps(state) if k < 10 else None
        after, pose = estimator.step(state, sample)
        # A step leaves the state it was given alone.
        assert before is None or pickle.dumps(state) == before
        state = after
        if pose is not None:
            poses.append(pose)
    # `run` feeds the look-ahead once more at the end; here the last poses stay in the state.
    for a, b in zip(whole[: -network.look_ahead_frames], poses, strict=True):
        assert np.array_equal(a.R_parent_joint, b.R_parent_joint)
        assert np.array_equal(a.p_world_root, b.p_world_root) and a.note == b.note


def test_one_tracker_may_serve_two_people(truth: Motion, noisy: Recording) -> None:
    other = synthesis.recording(truth, places.SIX, synthesis.Noise(), 9)
    estimator = Tracker(erring(truth), single())
    alone = [run(estimator, r)[0] for r in (noisy, other)]
    states = [estimator.init(), estimator.init()]
    for k, pair in enumerate(zip(samples(noisy), samples(other), strict=True)):
        if k > 40:
            break
        for i in range(2):
            states[i], pose = estimator.step(states[i], pair[i])
            if pose is not None:
                expected = alone[i][k - estimator.look_ahead_frames]
                assert np.array_equal(pose.R_parent_joint, expected.R_parent_joint)


@pytest.mark.parametrize("names", [places.SIX, places.FIVE], ids=len)
def test_turned_about_gravity_turns_the_answer(truth: Motion, names: tuple[str, ...]) -> None:
    recording = synthesis.recording(truth, names, synthesis.Noise(), 0)
    plain = tracked(erring(truth, names), recording)[1]
    yaw = 2.3
    turned = tracked(erring(truth.turned(yaw), names), recording.turned(yaw))[1]
    expected = plain.turned(yaw)
    assert (
        np.rad2deg(ori.angle_between(turned.R_parent_joint, expected.R_parent_joint)).max() < 0.05
    )
    assert np.allclose(turned.p_world_root, expected.p_world_root, atol=2e-3)


def spoil(sample: Sample, how: str, rng: np.random.Generator) -> Any:
    """A sample as a broken device, cable or driver would send it."""
    R, acc = np.array(sample.R_world_bone), np.array(sample.acc_world)
    some = rng.uniform(size=len(R)) < 0.5
    if how == "nan":
        R[some], acc[some] = np.nan, np.inf
        return replace(sample, R_world_bone=R, acc_world=acc)
    if how == "unplugged":
        return replace(sample, valid=sample.valid & ~some)
    if how == "all unplugged":
        return replace(sample, valid=np.zeros(len(R), bool))
    if how == "swapped":
        order = rng.permutation(len(R))
        return replace(sample, R_world_bone=R[order], acc_world=acc[order])
    if how == "zero":
        R[some], acc[some] = 0, 0
        return replace(sample, R_world_bone=R, acc_world=acc)
    if how == "mirrored":
        return replace(sample, R_world_bone=R * np.array([-1.0, 1, 1]))
    if how == "huge":
        return replace(sample, R_world_bone=R * 1e150, acc_world=acc * 1e150)
    if how == "random":
        R = ori.exp(rng.normal(size=(len(R), 3)) * 2)
        return replace(sample, R_world_bone=R, acc_world=rng.normal(size=acc.shape) * 100)
    if how == "shape":
        # All of one wrong length, so that further trouble may follow in the same frame.
        return replace(sample, R_world_bone=R[:-1], acc_world=acc[:-1, :2], valid=sample.valid[:-1])
    if how == "nothing":
        return None
    if how == "clock":
        return replace(
            sample, time_s=float(rng.choice([np.nan, np.inf, -1e9, sample.time_s + 1e6]))
        )
    return replace(sample, time_s=sample.time_s - 0.4)


HOW = (
    "nan", "unplugged", "all unplugged", "swapped", "zero", "mirrored", "huge", "random", "shape",
    "nothing", "clock", "back",
)  # fmt: skip


class Unreliable(FakeNetwork):
    """A network that raises, falls silent or emits nonsense in some frames."""

    def step(self, state: Any, sample: Sample) -> tuple[Any, Pose | None]:
        state, pose = super().step(state, sample)
        what = (int(state[0]) * 7919) % 23
        if pose is None or what > 5:
            return state, pose
        if what == 0:
            raise RuntimeError("no memory left")
        if what == 1:
            return state, None
        R = np.array(pose.R_parent_joint)
        if what == 2:
            R[3] = np.nan
        elif what == 3:
            R = R * 0
        elif what == 4:
            return state, replace(pose, time_s=pose.time_s + 77)
        elif what == 5:
            return state, replace(
                pose, p_world_root=np.full(3, np.nan), std_rad=np.full((24, 3), -1.0)
            )
        return state, replace(pose, R_parent_joint=R)


def check(pose: Pose | None) -> Pose:
    """Finite, orthonormal, of the right shape."""
    assert pose is not None
    assert (
        pose.R_parent_joint.shape == (24, 3, 3) and ori.is_rotation(pose.R_parent_joint, 1e-9).all()
    )
    assert np.isfinite(pose.p_world_root).all() and np.isfinite(pose.time_s)
    return pose


@given(
    hows=st.lists(
        st.tuples(st.sampled_from(HOW), st.integers(0, 60), st.integers(1, 12)), max_size=6
    ),
    names=st.sampled_from([places.SIX, places.FIVE, ("head",), ("pelvis",)]),
    reliable=st.booleans(),
    seed=st.integers(0, 1000),
)
@settings(max_examples=8, deadline=None)
def test_hostile_input_always_gives_a_pose(
    truth: Motion,
    hows: list[tuple[str, int, int]],
    names: tuple[str, ...],
    reliable: bool,
    seed: int,
) -> None:
    motion = truth.slice(0, 75)
    recording = synthesis.recording(motion, names, synthesis.Noise(), seed)
    kind = FakeNetwork if reliable else Unreliable
    estimator = Tracker(
        kind(motion, smooth_errors(75, RATE_HZ, 10.0, seed), names, 3, 10.0), single()
    )
    rng = np.random.default_rng(seed)
    state, given_poses, noted = estimator.init(), 0, 0
    for k, sample in enumerate(samples(recording)):
        for how, start, length in hows:
            if start <= k < start + length and sample is not None:
                sample = spoil(sample, how, rng)
        state, pose = estimator.step(state, sample)
        if k < estimator.look_ahead_frames:
            continue
        given_poses += 1
        noted += bool(check(pose).note)
    assert state.counts["frames"] == given_poses == 75 - estimator.look_ahead_frames
    assert state.fallbacks == noted


def feed(estimator: Tracker, rows: list[Any]) -> tuple[list[Pose | None], tracker.TrackerState]:
    state, poses = estimator.init(), []
    for sample in rows:
        state, pose = estimator.step(state, sample)
        poses.append(pose)
    return poses, state


def test_each_kind_of_trouble_is_named_and_counted(truth: Motion) -> None:
    recording = synthesis.recording(truth, places.SIX)
    rows: list[Any] = list(samples(recording))[1:-1]
    no_delay = FakeNetwork(truth.slice(1, len(truth)), None, places.SIX, 0)
    nan = np.full((6, 3, 3), np.nan)
    rows[20] = replace(rows[20], valid=np.zeros(6, bool))
    rows[30] = replace(rows[30], R_world_bone=nan, acc_world=nan[..., 0])
    rows[40:] = [replace(s, time_s=s.time_s + 9) for s in rows[40:]]
    rows[60:] = [replace(s, time_s=s.time_s - 20) for s in rows[60:]]
    rows[80] = replace(rows[80], R_world_bone=np.zeros((6, 3, 3)))
    poses, state = feed(Tracker(no_delay, single()), rows)
    notes = {k: p.note for k, p in enumerate(poses) if p is not None and p.note}
    assert notes == {
        20: NO_MEASUREMENT,
        30: NO_MEASUREMENT,
        40: tracker.TIME_GAP,
        60: tracker.TIME_BACK,
        80: NO_MEASUREMENT,
    }
    assert state.counts[NO_MEASUREMENT] == 3 and state.counts["not a rotation"] == 6
    assert state.counts["sensor lost"] == 12 and state.fallbacks == 5


def test_a_network_that_fails_is_started_again_and_the_last_pose_is_kept(truth: Motion) -> None:
    class Fails(FakeNetwork):
        def step(self, state: Any, sample: Sample) -> tuple[Any, Pose | None]:
            if 10 <= round(sample.time_s * RATE_HZ) < 14:
                raise ValueError("weights gone")
            return super().step(state, sample)

    recording = synthesis.recording(truth, places.SIX)
    poses, state = feed(
        Tracker(Fails(truth, None, places.SIX, 2), single()), list(samples(recording))
    )
    held = [check(p) for p in poses[10:16]]
    assert [p.note for p in held[:4]] == [tracker.NETWORK_FAILED] * 4
    assert [p.note for p in held[4:]] == [
        tracker.NETWORK_SILENT
    ] * 2  # it fills its look-ahead anew
    last = check(poses[9])
    assert all(np.array_equal(p.R_parent_joint, last.R_parent_joint) for p in held)
    assert np.allclose([p.time_s for p in held], (np.arange(10, 16) - 2) / RATE_HZ)
    assert not check(poses[16]).note
    assert state.counts[tracker.NETWORK_FAILED] == 4 and state.counts[tracker.NETWORK_SILENT] == 2


def test_a_qp_that_does_not_converge_gives_the_networks_pose(
    truth: Motion, noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = erring(truth)
    alone, _ = run(network, noisy)
    monkeypatch.setattr("hybrid.limb_qp.ACCEPTED_KKT", -1.0)
    poses, state = run(Tracker(network, single()), noisy)
    limbs = slice(1, 24)
    for a, b in zip(alone, poses, strict=True):
        assert b.note == NOT_CONVERGED
        assert np.array_equal(a.R_parent_joint[limbs], b.R_parent_joint[limbs])
    assert isinstance(state, tracker.TrackerState) and state.counts[NOT_CONVERGED] == len(noisy)


def test_a_rate_limit_holds_and_gives_way_to_nothing_but_limits(truth: Motion) -> None:
    """A network that jumps by 60 degrees in one frame: the elbow follows at the rate allowed."""
    still = motions.stand(2.0, RATE_HZ)
    R = np.array(still.R_parent_joint)
    R[30:, 18] = R[30:, 18] @ ori.rot_y(np.deg2rad(-60.0))
    network = FakeNetwork(replace(still, R_parent_joint=R), None, ("head",), 0)
    recording = synthesis.recording(still, ("head", "left_forearm")).select(("head",))
    network_two = FakeNetwork(replace(still, R_parent_joint=R), None, ("head", "left_forearm"), 0)
    rows = [
        Sample(
            s.time_s,
            np.stack([s.R_world_bone[0], np.eye(3)]),
            np.full((2, 3), np.nan),
            np.array([True, False]),
        )
        for s in samples(recording)
    ][1:-1]
    slow = single(rate_limit_deg_s=300.0, network_memory_s=0)
    poses, _ = feed(Tracker(network_two, slow), rows)
    elbow = np.stack([check(p).R_parent_joint[18] for p in poses])
    step = np.rad2deg(ori.angle_between(elbow[:-1], elbow[1:]))
    assert step.max() < 10.5 and step.max() > 9  # 300 deg/s at 30 Hz
    # Held back by the rate and its momentum at first, then drawn to the network frame by frame.
    off = ori.angle_between(elbow[30:], R[31:59, 18])
    assert np.all(np.diff(off[3:]) < 0)
    free, _ = feed(
        Tracker(network, slow),
        [
            replace(
                s, R_world_bone=s.R_world_bone[:1], acc_world=s.acc_world[:1], valid=s.valid[:1]
            )
            for s in rows
        ],
    )
    # No sensor on the arm: the joint is not ours, and the network's jump passes.
    assert np.array_equal(check(free[-1]).R_parent_joint[18], R[-1, 18])


def test_settings_and_places_are_checked(truth: Motion) -> None:
    with pytest.raises(PoserError, match="orientation_sigma_deg must be a finite number above 0"):
        single(orientation_sigma_deg=0)
    with pytest.raises(PoserError, match="24 values"):
        single(network_scale=(1.0, 2.0))
    with pytest.raises(SensorError, match="unknown"):
        Tracker(FakeNetwork(truth, names=("nose",)))
    with pytest.raises(SensorError, match="given for 1 sensors"):
        Tracker(FakeNetwork(truth, names=("nose",)), joint=np.zeros(2, int), seat=np.zeros((1, 3)))
    Tracker(
        FakeNetwork(truth, names=("nose",)), single(), joint=np.array([15]), seat=np.zeros((1, 3))
    )


def test_the_root_stays_where_it_is_in_a_frame_that_falls_back(truth: Motion) -> None:
    recording = synthesis.recording(truth, places.SIX)
    rows = list(samples(recording))
    later = [replace(s, time_s=s.time_s + 2.0) for s in rows[60:]]
    network = FakeNetwork(truth, names=places.SIX, look_ahead=0)
    poses, _ = feed(Tracker(network, single()), rows[:60] + later)
    assert any(tracker.TIME_GAP in p.note for p in poses)
    p = np.stack([q.p_world_root for q in poses])
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() < 0.15
