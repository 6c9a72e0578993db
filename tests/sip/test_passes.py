"""The window sent along a recording and back, as starts for a solve."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import Motion, Recording, Skeleton, sensors, synthesis
from mocap import orientation as ori
from mocap.evaluation import metrics
from sip import Settings, passes
from sip.passes import in_order
from tests.sip.conftest import wavy


def reversed_in_time(motion: Motion) -> Motion:
    return Motion(
        motion.rate_hz, motion.R_parent_joint[::-1], motion.p_world_root[::-1], motion.skeleton
    )


def test_the_recording_of_a_reversed_motion_is_the_reversed_recording() -> None:
    motion = wavy(40)
    backward = in_order(synthesis.recording(motion, sensors.SIX), -1)
    direct = synthesis.recording(reversed_in_time(motion), sensors.SIX)
    assert np.allclose(backward.R_world_bone, direct.R_world_bone)
    assert np.allclose(backward.acc_world, direct.acc_world, equal_nan=True)
    assert (backward.valid == direct.valid).all()


@pytest.mark.parametrize("rate_hz", [60.0, 150.0])
def test_both_ways_give_the_recording_s_frames_near_the_truth(rate_hz: float) -> None:
    frames = round(0.7 * rate_hz)
    recording: Recording = synthesis.recording(wavy(frames, rate_hz), sensors.SIX)
    truth = recording.reference
    assert truth is not None
    found = passes(recording, Skeleton.default(), Settings(self_calibration=True))
    assert list(found) == ["forward", "backward"]
    for motion in found.values():
        assert len(motion) == frames and motion.rate_hz == rate_hz
        assert ori.is_rotation(motion.R_parent_joint).all()
        score = metrics.evaluate(motion, truth)
        assert score.angular_deg is not None and score.angular_deg < 25
