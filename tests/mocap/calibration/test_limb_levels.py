"""A sensor of an arm that is exchanged with one of a leg turns with the wrong limb."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mocap import sensors as places
from mocap.calibration import calibrate, limb_levels
from mocap.recording import RawRecording
from mocap.synthesis.motions import builtin
from tests.mocap.calibration.people import clip, worn

TWO_EACH = tuple(
    ["pelvis"]
    + [f"{a}_{k}" for k in ("upper_arm", "forearm", "thigh", "shank") for a in ("left", "right")]
)


def named(raw: RawRecording) -> list[set[str | None]]:
    """Sensors of each finding of the levels."""
    joints, _ = places.joints_and_seats(raw.sensors)
    found = limb_levels.check_swapped(raw, joints, raw.R_world_sensor)
    return [{f.sensor for f in found if f.sentence == text} for text in {f.sentence for f in found}]


def exchanged(raw: RawRecording, a: str, b: str) -> RawRecording:
    return raw.renamed({a: b, b: a})


@pytest.mark.parametrize(
    "pair",
    [
        ("left_hand", "left_foot"),
        ("right_forearm", "right_shank"),
        ("left_upper_arm", "left_thigh"),
        ("left_hand", "right_shank"),
    ],
)
@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_an_arm_sensor_exchanged_with_one_of_a_leg(pair: tuple[str, str], noise: str) -> None:
    raw = worn(builtin(60.0, 22.6), places.SUIT, noise)
    assert named(raw) == []
    assert named(exchanged(raw, *pair)) == [set(pair)]
    _, cal = calibrate(exchanged(raw, *pair), strict=False)
    assert {f.sensor for f in cal.diagnostics if f.code == "swapped"} == set(pair)


def test_with_two_sensors_on_each_limb_the_other_two_are_named_as_well() -> None:
    raw = worn(builtin(60.0, 22.6), TWO_EACH)
    assert named(raw) == []
    pairs = {f"left_{k}" for k in ("upper_arm", "forearm", "thigh", "shank")}
    assert named(exchanged(raw, "left_forearm", "left_shank")) == [pairs]


def test_nothing_is_said_where_a_limb_has_one_sensor_or_each_sensor_its_own_world() -> None:
    six = worn(builtin(60.0, 22.6), places.SIX)
    assert named(exchanged(six, "left_forearm", "left_shank")) == []
    suit = exchanged(worn(builtin(60.0, 22.6), places.SUIT), "left_hand", "left_foot")
    assert {"left_hand", "left_foot"} not in named(replace(suit, common_heading=False))


@pytest.mark.parametrize("name", ["14_07", "salsa_22", "02_05"])
def test_other_people_are_not_accused(name: str) -> None:
    """In 14_07 an exchange shows; in the other two arms move too much like legs (gain 0.3 to 0.5)."""
    raw = worn(clip(name), places.SUIT, "realistic")
    assert named(raw) == []
    who = [{"left_hand", "left_foot"}] if name == "14_07" else []
    assert named(exchanged(raw, "left_hand", "left_foot")) == who
