"""Fewer frames of fast recordings: what they keep, and answers at the recording's own rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import thinning
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton

RATE = 0.8  # rad/s about the vertical


def turning(rate_hz: float, T: int) -> Recording:
    """One sensor that turns evenly; its acceleration grows evenly."""
    t = 5.0 + np.arange(T) / rate_hz
    acc = np.stack([t, -2 * t, 0 * t], axis=1)[:, None]
    return Recording(rate_hz, ("pelvis",), ori.rot_y(RATE * t)[:, None], acc, start_s=5.0)


@pytest.mark.parametrize(("rate_hz", "n"), [(60, 1), (120, 1), (200, 2), (960, 8), (1000, 9)])
def test_the_fewest_samples_a_frame(rate_hz: float, n: int) -> None:
    made = thinning.thinned(turning(rate_hz, 300))
    assert thinning.factor(rate_hz) == n
    assert made.rate_hz == pytest.approx(rate_hz / n)
    assert len(made) == -(-300 // n)
    assert made.start_s == 5.0


@pytest.mark.parametrize("rate_hz", [960.0, 1000.0])
def test_what_changes_evenly_is_what_it_was_at_that_time(rate_hz: float) -> None:
    made = thinning.thinned(turning(rate_hz, 901))
    want = turning(made.rate_hz, len(made))
    inner = slice(1, -1)
    apart = ori.angle_between(made.R_world_bone[inner], want.R_world_bone[inner])
    assert apart.max() < 1e-6
    np.testing.assert_allclose(made.acc_world[inner], want.acc_world[inner], atol=1e-9)


def test_noise_and_vibration_fall(rng: np.random.Generator) -> None:
    fast = turning(1000.0, 9000)
    t = np.arange(9000) / 1000
    hum = 3 * np.sin(2 * np.pi * 1000 / 9 * t)[:, None, None]
    added = rng.normal(0, 1, fast.acc_world.shape) + hum
    made = thinning.thinned(replace(fast, acc_world=fast.acc_world + added))
    left = made.acc_world - thinning.thinned(fast).acc_world
    assert left[2:-2].std() == pytest.approx(1 / 3, rel=0.1)


def test_a_frame_counts_where_half_of_its_samples_do() -> None:
    fast = turning(1000.0, 90)
    valid = np.ones((90, 1), bool)
    valid[14:23] = False  # all of frame 2, around 18
    valid[26:30] = False  # four of the nine of frame 3, around 27
    made = thinning.thinned(replace(fast, valid=valid))
    assert made.valid[:, 0].tolist() == [True, True, False, *[True] * 7]


def test_poses_come_back_at_every_frame_and_time() -> None:
    fast = turning(1000.0, 500)
    slow = thinning.thinned(fast)
    R = np.tile(np.eye(3), (len(slow), 24, 1, 1))
    R[:, 0] = slow.R_world_bone[:, 0]
    motion = Motion(slow.rate_hz, R, np.zeros((len(slow), 3)), Skeleton.default(), start_s=5.0)
    back = thinning.given_back(motion, fast)
    assert (len(back), back.rate_hz, back.start_s) == (500, 1000.0, 5.0)
    apart = ori.angle_between(back.R_world_joint[9:490, 0], fast.R_world_bone[9:490, 0])
    assert apart.max() < 1e-6
    std = np.linspace(1, 2, len(slow))[:, None, None] * np.ones((1, 24, 3))
    wide = thinning.deviations_given_back(std, motion, fast)
    assert wide.shape == (500, 24, 3)
    assert wide[9 * 10, 0, 0] == pytest.approx(std[10, 0, 0])
