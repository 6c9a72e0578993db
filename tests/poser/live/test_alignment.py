"""Rows to samples: against the calibration of whole recordings, and from a pose at the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import calibration, sensors, synthesis
from mocap import orientation as ori
from mocap.errors import CalibrationError
from mocap.recording import RawRecording
from mocap.synthesis import motions
from poser.live import alignment
from poser.live.alignment import BONES, Constants, PoseWatch, to_sample
from poser.live.assembler import Row

FACING = 35.0


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    """Standing for 2 s, then walking; sensors at any rotation, the wearer turned by FACING."""
    motion = motions.joined([motions.stand(2.0), motions.walk(3.0)]).turned(np.deg2rad(FACING))
    return synthesis.raw_recording(motion, sensors.SIX, synthesis.Noise(loss=0.0), rng=3)


def rows(raw: RawRecording) -> list[Row]:
    """What the assembler would give: orientation, and acceleration in the world without gravity."""
    assert raw.R_world_sensor is not None
    acc = np.einsum("tsij,tsj->tsi", raw.R_world_sensor, raw.acc) - alignment.UP_G
    return [
        Row(t / raw.rate_hz, raw.R_world_sensor[t], acc[t], raw.valid[t]) for t in range(len(raw))
    ]


def feed(watch: PoseWatch, some: list[Row]) -> None:
    for row in some:
        assert watch.push(row) is None


def test_one_row_at_a_time_equals_the_whole_recording(raw: RawRecording) -> None:
    whole, found = calibration.calibrate(raw, at=1.0, facing=FACING)
    table = alignment.constants(found)
    where = {n: n for n in raw.sensors}
    for t, row in enumerate(rows(raw)):
        sample = to_sample(row, raw.sensors, where, raw.sensors, table)
        np.testing.assert_allclose(sample.R_world_bone, whole.R_world_bone[t], atol=1e-9)
        np.testing.assert_allclose(sample.acc_world, whole.acc_world[t], atol=1e-9)
        assert (sample.valid == whole.valid[t]).all()


def test_the_pose_at_the_start_calibrates(raw: RawRecording) -> None:
    watch = PoseWatch(raw.sensors, raw.rate_hz, "n", facing_deg=FACING, begin_s=0.2)
    for row in rows(raw):
        found = watch.push(row)
        if found is not None:
            break
    assert found is not None
    # As soon as POSE_S of standing has been seen.
    assert row.time_s == pytest.approx(0.2 + alignment.POSE_S, abs=0.05)
    assert raw.truth is not None
    off = ori.angle_between(found.R_bone_sensor, np.array(raw.truth["R_bone_sensor"]))
    # Heading (3 deg) and soft tissue (2 deg a axis) are in what is measured.
    assert np.rad2deg(off).max() < 12


@pytest.mark.parametrize("silent", ["all", "head"])
def test_the_pose_calibrates_from_orientations_alone(raw: RawRecording, silent: str) -> None:
    """Without `a` the sensors are turned the same; the wearer sways too little to matter."""
    mute = np.array([silent in ("all", n) for n in raw.sensors])
    full, less = (
        PoseWatch(raw.sensors, raw.rate_hz, "n", facing_deg=FACING, begin_s=0.2) for _ in "ab"
    )
    for row in rows(raw):
        acc = np.where(mute[:, None], np.nan, row.acc_world)
        expected, found = full.push(row), less.push(replace(row, acc_world=acc))
        assert (expected is None) == (found is None)
        if found is not None:
            break
    assert expected is not None and found is not None
    off = ori.angle_between(found.R_bone_sensor, expected.R_bone_sensor)
    assert np.rad2deg(off).max() < 0.01
    assert found.acc_scale[mute] == pytest.approx(1.0, abs=2e-3)
    assert found.acc_scale[~mute] == pytest.approx(expected.acc_scale[~mute])
    sample = to_sample(
        replace(row, acc_world=acc), raw.sensors, {n: n for n in raw.sensors}, raw.sensors,
        alignment.constants(found),
    )  # fmt: skip
    assert sample.valid.all() and np.isfinite(sample.R_world_bone).all()
    assert np.isnan(sample.acc_world[mute]).all()


def test_nobody_stands_still(raw: RawRecording) -> None:
    watch = PoseWatch(raw.sensors, raw.rate_hz, "n", begin_s=2.6, give_up_s=1.8)
    with pytest.raises(CalibrationError, match="nobody stood still"):
        feed(watch, rows(raw))


def test_a_silent_sensor_is_named(raw: RawRecording) -> None:
    watch = PoseWatch(raw.sensors, raw.rate_hz, "n", begin_s=0.0, give_up_s=1.6)
    speaks = np.array(raw.sensors) != "head"
    with pytest.raises(CalibrationError, match="sensor head is silent"):
        feed(watch, [replace(row, valid=row.valid & speaks) for row in rows(raw)])


def test_places_decide_what_is_valid() -> None:
    R = ori.rot_x(np.array([0.1, 0.2, 0.3]))
    row = Row(0.5, R, np.arange(9.0).reshape(3, 3), np.array([True, True, False]))
    devices, five = ("watch", "phone", "earbuds"), sensors.FIVE
    where = {"watch": "left_wrist", "phone": "left_wrist", "earbuds": "head"}
    sample = to_sample(row, devices, where, five, None)
    # Two devices on one arm: the watch counts. The earbuds are silent.
    assert sample.valid.tolist() == [True, False, False, False, False]
    np.testing.assert_array_equal(sample.R_world_bone[0], R[0])
    sample = to_sample(row, devices, {"phone": "right_pocket"}, five, None)
    assert sample.valid.tolist() == [False, False, False, True, False]
    assert np.isnan(sample.acc_world[0]).all()


def test_constants_of_a_device_in_its_place() -> None:
    row = Row(0.0, ori.rot_x(np.array([0.4])), np.zeros((1, 3)), np.array([True]))
    turned = Constants(np.eye(3), ori.rot_x(0.4), 1.0)
    table = {"phone@left_pocket": turned, "head": BONES}
    sample = to_sample(row, ("phone",), {"phone": "left_pocket"}, sensors.FIVE, table)
    np.testing.assert_allclose(sample.R_world_bone[2], np.eye(3), atol=1e-12)
    # Moved to a place that nothing is known of: not used, rather than wrong.
    assert not to_sample(row, ("phone",), {"phone": "left_wrist"}, sensors.FIVE, table).valid.any()
