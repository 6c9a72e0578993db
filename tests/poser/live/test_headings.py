"""Devices with a heading of their own: found by standing and walking, and found again by standing alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.calibration import Calibration
from mocap.errors import CalibrationError
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import motions
from poser.live import device_headings
from poser.live.alignment import Watch
from poser.live.device_headings import HeadingWatch, WalkWatch
from tests.poser.live.test_alignment import rows

STANDS_S = 3.0
PHONES = ("left_wrist", "right_pocket", "head")


def strapped(motion: Motion, names: tuple[str, ...], seed: int) -> RawRecording:
    """Sensors at any rotation, each with a heading of its own."""
    raw = synthesis.raw_recording(
        motion, names, synthesis.Noise(loss=0.0, heading_deg=0.0), rng=seed
    )
    assert raw.R_world_sensor is not None
    own = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(names))
    return replace(raw, R_world_sensor=ori.rot_y(own) @ raw.R_world_sensor)


@pytest.fixture(scope="module")
def walked() -> Motion:
    """Standing, then walking and more."""
    parts = [motions.stand(STANDS_S), motions.walk(8.0), motions.builtin()]
    return synthesis.prepare(motions.joined(parts), 60.0, 8.0)


def led(watch: Watch, raw: RawRecording) -> tuple[Calibration, float, list[str]]:
    """The calibration, when it came, and what the wearer was told on the way."""
    prompts: list[str] = []
    for row in rows(raw):
        words = "".join(c for c in watch.prompt(row.time_s) if not c.isdigit())
        if not prompts or prompts[-1] != words:
            prompts.append(words)
        found = watch.push(row)
        if found is not None:
            return found, row.time_s, prompts
    raise AssertionError("no calibration")


def off_deg(found: Calibration, raw: RawRecording, motion: Motion, at_s: float) -> np.ndarray:
    """(S,) angle of the bones to the truth at a time."""
    k = round(at_s * 60)
    assert raw.R_world_sensor is not None
    joints, _ = sensors.joints_and_seats(raw.sensors)
    turned = ori.rot_y(found.heading) @ raw.R_world_sensor[k]
    R = turned @ np.swapaxes(found.R_bone_sensor, -1, -2)
    return np.rad2deg(ori.angle_between(R, motion.R_world_joint[k, joints]))


@pytest.mark.parametrize("names", [sensors.SIX, PHONES])
def test_standing_then_walking(walked: Motion, names: tuple[str, ...]) -> None:
    raw = strapped(walked, names, 1)
    found, at, prompts = led(WalkWatch(names, 60.0, "n", begin_s=0.5), raw)
    assert device_headings.WALK_S < at < device_headings.WALK_S + 4 * device_headings.AGAIN_S
    assert off_deg(found, raw, walked, at + 2.0).max() < 15
    assert [p.split()[0] for p in prompts] == ["get", "stand", "now"]


def test_who_does_not_walk_is_told_so() -> None:
    still = motions.stand(device_headings.GIVE_UP_S + 15.0)
    raw = strapped(still, sensors.SIX, 2)
    with pytest.raises(CalibrationError):
        led(WalkWatch(sensors.SIX, 60.0, "n", begin_s=0.5), raw)


def test_headings_are_found_again_by_standing(walked: Motion) -> None:
    """The mountings of yesterday, trackers switched on anew: 1.5 s of standing are enough."""
    yesterday = strapped(walked, sensors.SIX, 3)
    known, _, _ = led(WalkWatch(sensors.SIX, 60.0, "n", begin_s=0.5), yesterday)
    today = replace(
        yesterday,
        R_world_sensor=ori.rot_y(np.linspace(-3, 3, 6)) @ yesterday.R_world_sensor,
    )
    found, at, prompts = led(HeadingWatch(known, sensors.SIX, 60.0, "n", begin_s=0.5), today)
    assert at < 2.5 and [p.split()[0] for p in prompts] == ["get", "stand"]
    before = off_deg(known, yesterday, walked, 8.0)
    after = off_deg(found, today, walked, 8.0)
    assert after.max() < before.max() + 5


def test_a_sensor_that_has_moved_is_named(walked: Motion) -> None:
    raw = strapped(walked, sensors.SIX, 4)
    known, _, _ = led(WalkWatch(sensors.SIX, 60.0, "n", begin_s=0.5), raw)
    assert raw.R_world_sensor is not None
    turned = np.array(raw.R_world_sensor)
    turned[:, 4] = turned[:, 4] @ ori.exp([0.8, 0.8, 0.0])
    with pytest.raises(CalibrationError, match=r"sensor head is .* it has moved"):
        led(HeadingWatch(known, sensors.SIX, 60.0, "n", 0.5), replace(raw, R_world_sensor=turned))


def test_some_of_the_known_sensors(walked: Motion) -> None:
    raw = strapped(walked, sensors.SIX, 5)
    known, _, _ = led(WalkWatch(sensors.SIX, 60.0, "n", begin_s=0.5), raw)
    names = ("pelvis", "head")
    found, _, _ = led(HeadingWatch(known, names, 60.0, "n", 0.5), raw.select(names))
    assert found.sensors == names
    assert off_deg(found, raw.select(names), walked, 8.0).max() < 20
