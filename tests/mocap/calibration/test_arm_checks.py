"""A T-pose called N, and an N-pose called T, show in how the arms hang otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import sensors as places
from mocap.calibration import PoseName, calibrate
from mocap.calibration.checks.arms import check_pose_name
from mocap.calibration.diagnostics import diagnose
from mocap.calibration.static_pose import average, find_static
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import motions
from mocap.synthesis.motions import builtin
from mocap.synthesis.staging import with_static_pose
from tests.mocap.calibration.people import clip, worn

CODE = "other-pose"
OTHER: dict[str, PoseName] = {"n": "t", "t": "n"}


def after(pose: str, motion: Motion | None = None) -> Motion:
    """3 s of the pose before the programme, which begins standing with the arms down."""
    return with_static_pose((motion or builtin(60.0, 22.6)).turned(0.5), pose, 3.0)


def said(raw: RawRecording, pose: str, sigma: float = 0.1, facing: float = 0.5) -> list[Finding]:
    window = find_static(raw, 1.5)
    S = len(raw.sensors)
    return check_pose_name(
        raw, window, average(raw, window), np.full(S, facing), np.full(S, sigma), pose
    )


@pytest.mark.parametrize("sensors", [places.SIX, places.SUIT], ids=len)
@pytest.mark.parametrize("noise", ["none", "realistic"])
@pytest.mark.parametrize("pose", ["n", "t"])
def test_the_other_pose_is_told(pose: str, noise: str, sensors: tuple[str, ...]) -> None:
    raw = worn(after(pose), sensors, noise)
    assert said(raw, pose) == []
    (finding,) = said(raw, OTHER[pose])
    assert finding.code == CODE and f"(--pose {pose})" in finding.sentence
    if pose == "t":
        assert finding.value == pytest.approx(80, abs=12)


def test_a_t_pose_called_n_is_refused_where_it_is_certain() -> None:
    """A suit, and a stance with hanging arms: nothing else is said of it, such as exchanged arms."""
    raw = worn(after("t"), places.SUIT)
    with pytest.raises(
        CalibrationError, match=r"8\d deg from the N-pose whenever the body stands still"
    ):
        calibrate(raw, "n", at=1.5)
    _, cal = calibrate(raw, "n", at=1.5, strict=False)
    assert {f.code for f in cal.diagnostics if f.severity == "error"} == {CODE}
    assert "swapped" not in {f.code for f in cal.diagnostics}
    again = {f.code for f in diagnose(raw, cal)}
    assert CODE in again and "swapped" not in again
    assert CODE not in {f.code for f in calibrate(raw, "t", at=1.5)[1].diagnostics}


def test_without_a_facing_arms_that_part_tell_it() -> None:
    raw = worn(after("t"), ("left_forearm", "right_forearm", "pelvis", "head"))
    assert [f.code for f in said(raw, "n", np.pi, 2.0)] == [CODE]
    assert said(raw, "t", np.pi, 2.0) == []
    own = replace(raw, common_heading=False)
    assert said(own, "n", np.pi, 2.0) == []  # nothing says which way is left


def test_no_arms_no_word() -> None:
    raw = worn(after("t"), ("pelvis", "head", "left_shank", "right_shank", "left_forearm"))
    assert said(raw, "n") == []


@pytest.mark.parametrize("what", ["squat", "arm_raises", "jumping_jack", "leg_raise", "walk"])
@pytest.mark.parametrize("pose", ["n", "t"])
def test_the_right_pose_before_other_motion(pose: str, what: str) -> None:
    motion = after(pose, getattr(motions, what)(8.0))
    for sensors in (places.SIX, places.SUIT):
        assert said(worn(motion, sensors, "realistic"), pose) == []


@pytest.mark.parametrize("name", ["14_31", "14_07", "indian_14", "salsa_16"])
@pytest.mark.parametrize("pose", ["n", "t"])
def test_other_people_in_the_right_pose(pose: str, name: str) -> None:
    """Dancers hold their arms out for most of the time, and some raise them turned outward."""
    raw = worn(clip(name, pose), places.SUIT, "realistic")
    window = find_static(raw, 1.5)
    facing = float(-calibrate(raw, pose, at=1.5, strict=False)[1].heading[0])  # type: ignore[arg-type]
    for sensors in (places.SIX, places.SUIT):
        few = raw.select(sensors)
        S = len(sensors)
        assert (
            check_pose_name(
                few, window, average(few, window), np.full(S, facing), np.full(S, 0.1), pose
            )
            == []
        )
