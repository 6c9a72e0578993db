"""Orientation from gyr and acc (and mag): the truth, any rate, gaps, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import CalibrationError
from mocap.fusion import fuse, with_orientation
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, raw_recording
from poser.motions import builtin


def tilt_deg(Ra: np.ndarray, Rb: np.ndarray) -> np.ndarray:
    """Angle between the up directions that two orientations see: independent of heading."""
    cos = np.einsum("...i,...i->...", Ra[..., 1, :], Rb[..., 1, :])
    return np.degrees(np.arccos(np.clip(cos, -1, 1)))


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    return raw_recording(builtin(60.0), places.SIX, NOISES["none"], 3)


@pytest.mark.parametrize("rate", [37.0, 60.0, 200.0])
def test_tilt_is_right_at_any_rate(rate: float) -> None:
    raw = raw_recording(builtin(rate, 8.0), ("pelvis", "left_shank"), NOISES["none"], 1)
    assert tilt_deg(fuse(replace(raw, mag=None)).R_world_sensor, raw.R_world_sensor).max() < 3.0


def test_a_still_sensor_reads_gravity_up() -> None:
    """The z-up world of the filter has become ours: R acc = +9.81 e_y."""
    acc = np.tile([0.3, -0.5, 9.8], (200, 1, 1))
    raw = RawRecording(50.0, ("pelvis",), np.zeros_like(acc), acc)
    up = fuse(raw).R_world_sensor[-1, 0] @ acc[-1, 0]
    assert up == pytest.approx([0, np.linalg.norm(acc[0, 0]), 0], abs=1e-3)


def test_own_headings_stay_constant(raw: RawRecording) -> None:
    """6-axis: the heading of each sensor is off by a constant of its own, within 2 deg over 20 s."""
    found = fuse(raw, use_mag=False)
    assert not found.common_heading
    off = ori.heading(found.R_world_sensor @ np.swapaxes(raw.R_world_sensor, -1, -2))
    drift = np.degrees(np.angle(np.exp(1j * (off - off[60]))))
    assert np.abs(drift).max() < 2.0


def test_magnetometers_make_the_heading_common(raw: RawRecording) -> None:
    found = fuse(raw)
    assert found.common_heading
    off = ori.heading(found.R_world_sensor @ np.swapaxes(raw.R_world_sensor, -1, -2))[60:]
    assert np.degrees(np.abs(np.angle(np.exp(1j * (off - off[0, 0]))))).max() < 3.0


def test_online_variant_agrees_with_offline(raw: RawRecording) -> None:
    online = fuse(raw, use_mag=False, method="online").R_world_sensor
    assert tilt_deg(online, raw.R_world_sensor)[300:].mean() < 1.0


def test_gaps_are_bridged_and_stay_invalid(raw: RawRecording) -> None:
    whole = fuse(raw, use_mag=False)
    gyr, acc = raw.gyr.copy(), raw.acc.copy()
    gyr[200:206, 1], acc[200:206, 1] = np.nan, np.nan
    gyr[900:960, 4] = np.nan
    holed = replace(raw, gyr=gyr, acc=acc)
    found = fuse(holed, use_mag=False)
    assert np.isnan(found.R_world_sensor[200:206, 1]).all()
    assert np.isfinite(found.R_world_sensor[holed.valid]).all()
    after = ori.angle_between(found.R_world_sensor[300, 1], whole.R_world_sensor[300, 1])
    assert np.degrees(after) < 3.0
    assert found.long_gaps == ((4, 900, 60),)


def test_with_orientation_marks_what_it_knows(raw: RawRecording) -> None:
    fused = with_orientation(replace(raw, facing_rad=0.3), use_mag=False)
    assert fused.common_heading is False
    assert fused.facing_rad is None  # it was said of another world


def test_errors_name_the_sensor(raw: RawRecording) -> None:
    dead = raw.valid.copy()
    dead[:, 2] = False
    with pytest.raises(CalibrationError, match="left_shank"):
        fuse(replace(raw, valid=dead))
    with pytest.raises(CalibrationError, match="magnetometer"):
        fuse(replace(raw, mag=None), use_mag=True)
