"""Stances in realistic noise: found without a time, and nothing wrong said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.static_pose import find_static, still_runs
from mocap.synthesis import NOISES, prepare, raw_recording
from poser.motions import builtin, walk
from poser.staging import with_static_pose

FEW = [
    ("head",),
    ("head", "pelvis"),
    ("left_wrist", "right_pocket", "head"),
    ("pelvis", "left_shank", "right_shank"),
    places.SIX,
]


def raw_of(motion: Motion, sensors: tuple[str, ...], noise: str, seed: int) -> RawRecording:
    return replace(raw_recording(motion, sensors, NOISES[noise], seed), mag=None)


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 100.0])
@pytest.mark.parametrize("sensors", FEW, ids=len)
def test_a_stance_is_found_without_a_time(sensors: tuple[str, ...], rate_hz: float) -> None:
    """Of a programme that begins with it: the bones under the sensors stay as at the start.

    A head that looks ahead, and legs while the arms rise, are in the pose later, too.
    """
    motion = builtin(rate_hz, 22.6)
    for seed in range(3):
        raw = raw_of(motion, sensors, "realistic", seed)
        window = find_static(raw)
        assert window.still and window.found and window.stop - window.start >= rate_hz
        joint, _ = places.joints_and_seats(sensors)
        R = motion.R_world_joint[:, joint]
        off = ori.angle_between(R[window.start : window.stop], R[0])
        assert np.degrees(off.mean(axis=0)).max() < 2.0, seed


@pytest.mark.parametrize("noise", ["none", "realistic"])
@pytest.mark.parametrize("sensors", FEW[2:], ids=len)
def test_walking_is_no_stance(sensors: tuple[str, ...], noise: str) -> None:
    """Three sensors or more, limbs among them; the head of a walker turns no more than its skin wobbles."""
    motion = prepare(with_static_pose(walk(8.0), "n", 2.0), 60.0, 8.0)
    for seed in range(3):
        runs = still_runs(raw_of(motion, sensors, noise, seed))
        assert runs and max(stop for _, stop in runs) < 3.5 * 60
