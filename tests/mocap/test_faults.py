"""Flips are found, turned back where that is certain, and marked elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import dataset, faults
from mocap import orientation as ori
from mocap.motion import Motion
from mocap.synthesis import motions

RATE = 120.0
LEG, ARM = (2, 5, 8), (17, 18 + 1, 21)


def walking(seconds: float = 3.0, rate_hz: float = RATE) -> Motion:
    return motions.walk(seconds, rate_hz)


def other_side(motion: Motion, limb: tuple[int, int, int], frames: slice) -> Motion:
    """A limb whose middle joint is on the other side of the line from its first joint to its last."""
    first, middle, last = limb
    G, p = motion.R_world_joint, motion.p_world_joint
    line = p[:, last] - p[:, first]
    P = ori.exp(np.pi * line / np.linalg.norm(line, axis=-1, keepdims=True))
    above = G[:, motion.skeleton.parents[first]]
    R = np.array(motion.R_parent_joint)
    R[frames, first] = (np.swapaxes(above, 1, 2) @ P @ G[:, first])[frames]
    R[frames, last] = (np.swapaxes(P @ G[:, middle], 1, 2) @ G[:, last])[frames]
    return replace(motion, R_parent_joint=R)


def error_deg(found: faults.Mended, truth: Motion) -> np.ndarray:
    """(T,) deg: the farthest joint's global rotation from the truth's."""
    angle = ori.angle_between(found.motion.R_world_joint, truth.R_world_joint)
    return np.asarray(np.rad2deg(angle).max(axis=1))


def test_a_motion_without_faults_is_left_as_it_is() -> None:
    for rate in (30.0, 60.0, 120.0):
        motion = walking(rate_hz=rate)
        found = faults.mend(motion)
        np.testing.assert_array_equal(found.motion.R_parent_joint, motion.R_parent_joint)
        assert found.trusted.all() and not found.mended.any()


@pytest.mark.parametrize("limb", [LEG, ARM])
@pytest.mark.parametrize("frames", [slice(100, 112), slice(100, 101), slice(40, 250)])
def test_a_limb_on_the_other_side_comes_back(limb: tuple[int, int, int], frames: slice) -> None:
    truth = walking()
    broken = other_side(truth, limb, frames)
    assert np.rad2deg(ori.angle_between(broken.R_world_joint, truth.R_world_joint)).max() > 150
    found = faults.mend(broken)
    assert error_deg(found, truth).max() < 1e-4
    assert found.trusted.all()
    np.testing.assert_array_equal(np.flatnonzero(found.mended), np.arange(360)[frames])


def test_several_flips_are_told_apart() -> None:
    truth = broken = walking()
    for frames in (slice(60, 70), slice(73, 75), slice(76, 120)):
        broken = other_side(broken, LEG, frames)
    found = faults.mend(broken)
    assert error_deg(found, truth).max() < 1e-4 and found.trusted.all()


def test_of_a_single_flip_the_side_that_no_leg_can_is_the_wrong_one() -> None:
    truth = walking()
    for frames in (slice(200, None), slice(0, 200), slice(50, None)):
        found = faults.mend(other_side(truth, LEG, frames))
        assert error_deg(found, truth).max() < 1e-4 and found.trusted.all()


@pytest.mark.parametrize(("joint", "axis"), [(7, 2), (20, 0), (18, 0)])
def test_a_bone_rolled_about_its_length_comes_back(joint: int, axis: int) -> None:
    """For however long: a foot upside down stays one. What follows may have kept its own orientation."""
    truth = walking()
    child = truth.skeleton.parents.index(joint)
    along = truth.skeleton.offsets[child] / np.linalg.norm(truth.skeleton.offsets[child])
    assert np.argmax(np.abs(along)) == axis
    Q = ori.exp(np.pi * along)
    R = np.array(truth.R_parent_joint)
    R[90:300, joint] = R[90:300, joint] @ Q
    R[90:300, child] = Q.T @ R[90:300, child]
    if child > 21 or child in (10, 11):
        R[90:300, child] = R[90:300, child] @ Q  # ends roll with what they end
    found = faults.mend(replace(truth, R_parent_joint=R))
    assert error_deg(found, truth).max() < 1e-4 and found.trusted.all()


def test_a_hand_that_is_gone_for_a_moment_is_taken_across() -> None:
    truth = walking()
    R = np.array(truth.R_parent_joint)
    R[100:112, 21] = R[100:112, 21] @ ori.exp([0.4, 2.0, 1.5])
    found = faults.mend(replace(truth, R_parent_joint=R))
    assert error_deg(found, truth).max() < 5 and found.trusted.all()
    assert np.flatnonzero(found.mended).tolist() == list(range(100, 112))


def test_what_cannot_be_turned_back_is_marked_and_smooth() -> None:
    """A thigh that is somewhere else: neither solution is smooth."""
    truth = walking()
    R = np.array(truth.R_parent_joint)
    R[100:160, 1] = R[100:160, 1] @ ori.exp([0.2, 0.3, 1.4])
    found = faults.mend(replace(truth, R_parent_joint=R))
    wrong = np.flatnonzero(~found.trusted)
    around = round(faults.AROUND_S * RATE)
    assert wrong.tolist() == list(range(100 - around, 160 + around))
    step = ori.angle_between(found.motion.R_parent_joint[1:], found.motion.R_parent_joint[:-1])
    assert np.rad2deg(step).max() < 30
    np.testing.assert_array_equal(
        found.motion.R_parent_joint[found.trusted], truth.R_parent_joint[found.trusted]
    )


def test_a_clip_that_begins_with_another_pose_loses_its_beginning() -> None:
    R = np.array(walking().R_parent_joint)
    R[:40, 16] = ori.exp([0.0, 0.0, 0.5])
    R[:40, 17] = ori.exp([0.0, 0.0, -0.5])
    found = faults.mend(replace(walking(), R_parent_joint=R))
    assert not found.trusted[:40].any() and found.trusted[60:].all()


def test_a_head_turned_to_the_back_is_marked() -> None:
    R = np.array(walking().R_parent_joint)
    turn = np.linspace(0, np.pi, 180)
    R[:180, 15] = ori.exp(np.stack([0 * turn, turn, 0 * turn], axis=-1))
    R[180:, 15] = R[179, 15]
    found = faults.mend(replace(walking(), R_parent_joint=R))
    first = int(np.flatnonzero(~found.trusted)[0])
    assert np.rad2deg(turn[first]) == pytest.approx(faults.BEYOND_DEG["head"], abs=1.1)
    assert not found.trusted[first:].any()


def test_the_limit_follows_the_rate() -> None:
    assert faults.jump_limit_deg(120.0) == 60.0
    assert faults.jump_limit_deg(60.0) == 120.0
    assert faults.jump_limit_deg(30.0) == 150.0  # half a turn is a jump at any rate
    assert faults.jump_limit_deg(1000.0) == 60.0


def test_half_a_turn_is_seen_in_slow_captures_too() -> None:
    truth = walking(rate_hz=30.0)
    found = faults.mend(other_side(truth, LEG, slice(30, 50)))
    assert error_deg(found, truth).max() < 1e-4 and found.trusted.all()


@pytest.mark.parametrize(
    ("name", "most_s", "mended"),
    [("05_05", 2.5, True), ("05_10", 1.0, True), ("05_19", 2.0, True), ("02_01", 0.0, False)],
)
def test_trials_of_modern_dance(name: str, most_s: float, mended: bool) -> None:
    """The thigh of the test split's dancer flips while the leg is raised; after it no joint but toes does."""
    if "cmu-amc" in dataset.absent(("cmu",)):
        pytest.skip("CMU's AMC files are not unpacked")
    (clip,) = (c for c in dataset.select("test", ("cmu",)) if c.name == name)
    found = clip.read()
    assert (~found.trusted).sum() / found.motion.rate_hz <= most_s
    assert found.mended.any() == mended
    R = found.motion.R_parent_joint
    step = np.rad2deg(ori.angle_between(R[1:, :10], R[:-1, :10]))
    assert step.max() < 60


def test_a_side_entered_without_a_jump_is_left_where_the_leg_is_twisted() -> None:
    """It is entered within 12 frames, none of them a jump, and left by one."""
    truth = walking()
    other = other_side(truth, LEG, slice(None))
    R = np.array(other_side(truth, LEG, slice(112, 250)).R_parent_joint)
    for j in LEG[::2]:
        ends = np.stack([truth.R_parent_joint[100, j], other.R_parent_joint[112, j]])
        R[100:112, j] = ori.interpolate(np.array([100.0, 112.0]), ends, np.arange(100.0, 112.0))
    found = faults.mend(replace(truth, R_parent_joint=R))
    far = error_deg(found, truth)
    assert far[found.trusted].max() < 90 and far[120:].max() < 1e-4 and far[:95].max() < 1e-4
    assert not found.trusted[105:107].any() and (~found.trusted).sum() < 20
