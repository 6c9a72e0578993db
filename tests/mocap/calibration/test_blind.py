"""Recordings of orientations alone are calibrated as those with accelerations are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.calibration import calibrate, diagnose
from mocap.errors import CalibrationError
from mocap.recording import RawRecording
from mocap.synthesis import raw_recording
from tests.mocap.formats import recording_files as files

SENSORS = files.LEGS


@pytest.fixture(scope="module")
def slow() -> RawRecording:
    """A second of standing in the T-pose, then three of swings, as slow as three times that."""
    fast = files.motion(T=600, rate=60.0)
    return replace(
        raw_recording(replace(fast, rate_hz=20.0).resampled(60.0), SENSORS, rng=3), mag=None
    )


def without(raw: RawRecording, *names: str) -> RawRecording:
    acc = raw.acc.copy()
    acc[:, [raw.sensors.index(n) for n in names]] = np.nan
    return replace(raw, acc=acc, valid=np.ones(raw.valid.shape, bool))


def test_orientations_alone_give_the_same_bones(slow: RawRecording) -> None:
    want, _ = calibrate(slow, "t", facing=0.0, strict=False)
    got, made = calibrate(without(slow, *SENSORS), "t", facing=0.0)
    both = want.ori_valid & got.ori_valid
    apart = ori.angle_between(got.R_world_bone[both], want.R_world_bone[both])
    assert np.degrees(apart).max() < 1
    assert both.mean() > 0.99
    assert not got.acc_valid.any()
    told = [f for f in made.diagnostics if f.code == "no-acc"]
    assert {f.sensor for f in told} == set(SENSORS)
    assert {f.severity for f in told} == {"warning"}
    assert all(f.details["all"] for f in told)


def test_one_sensor_without_acceleration_keeps_that_of_the_others(slow: RawRecording) -> None:
    got, made = calibrate(without(slow, "pelvis"), "t", facing=0.0, strict=False)
    assert got.acc_valid.any(axis=0).tolist() == [False, True, True, True, True]
    assert [f.sensor for f in made.diagnostics if f.code == "no-acc"] == ["pelvis"]


def test_it_is_said_before_a_pose_is_taken(slow: RawRecording) -> None:
    assert "no-acc" in {f.code for f in diagnose(without(slow, *SENSORS))}


def test_without_an_orientation_an_acceleration_is_needed(slow: RawRecording) -> None:
    bare = replace(without(slow, *SENSORS), R_world_sensor=None)
    with pytest.raises(CalibrationError, match="no sample of acc"):
        calibrate(bare)
