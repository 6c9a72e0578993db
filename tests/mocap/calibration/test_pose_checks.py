"""The pose itself: a seat is no stance, a sensor that jumps or turns in it is named, right poses pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import calibrate
from mocap.calibration.checks import poses as pose_checks
from mocap.calibration.static_pose import average, find_static
from mocap.formats import Options, qmt
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, raw_recording
from mocap.synthesis.motions import builtin, walk
from mocap.synthesis.staging import with_static_pose
from tests.mocap.calibration.people import clip, worn

SEAT = {0: -20.0, 1: -65.0, 2: -65.0, 4: 80.0, 5: 80.0}  # deg about left, in the parent's frame


def sitting(motion: Motion, seconds: float = 4.0) -> Motion:
    """`motion` after sitting for some seconds: pelvis tipped back, thighs level, shanks upright."""
    R = np.repeat(np.array(motion.R_parent_joint[:1]), round(seconds * motion.rate_hz), axis=0)
    for joint, angle in SEAT.items():
        R[:, joint] = R[:, joint] @ ori.rot_x(np.radians(angle))
    p = np.repeat(motion.p_world_root[:1], len(R), axis=0)
    return replace(
        motion,
        R_parent_joint=np.concatenate([R, motion.R_parent_joint]),
        p_world_root=np.concatenate([p, motion.p_world_root]),
    )


def jumping(raw: RawRecording, s: int, at: int, Q: np.ndarray, in_world: bool) -> RawRecording:
    """`raw` whose file orientation of sensor s is turned by Q from frame `at` on."""
    assert raw.R_world_sensor is not None
    R = raw.R_world_sensor.copy()
    R[at:, s] = Q @ R[at:, s] if in_world else R[at:, s] @ Q
    return replace(raw, R_world_sensor=R)


def codes(raw: RawRecording, **how) -> set[str]:
    return {f.code for f in calibrate(raw, strict=False, **how)[1].diagnostics}


@pytest.fixture(scope="module")
def real(shared: Path) -> RawRecording:
    path = shared / "data/qmt-fullbody/full_body_example_data.mat"
    raw = qmt.FORMAT.read(path, Options()).content
    assert isinstance(raw, RawRecording)
    return raw


@pytest.mark.parametrize(
    ("names", "orientation"), [(None, "file"), (places.SIX, "file"), (places.SIX, "vqf")]
)
def test_a_real_seat_is_no_pose(
    real: RawRecording, names: tuple[str, ...] | None, orientation: str
) -> None:
    """At 65 s the person sits; nobody's sides are exchanged, and the seat is no rival of the stance."""
    raw = real.select(names) if names else real
    _, cal = calibrate(raw, at=65.0, orientation=orientation, strict=False)
    (said,) = [f for f in cal.diagnostics if f.code == "pose-posture"]
    assert "probably sat" in said.sentence and "(--at 42.5)" in said.sentence
    assert said.severity == "warning"
    assert "swapped" not in {f.code for f in cal.diagnostics}
    found = find_static(raw)
    assert raw.start_s + found.stop / raw.rate_hz < 45 and found.rival is None


def test_a_real_stance_is_a_pose(real: RawRecording) -> None:
    six = real.select(places.SIX)
    for orientation in ("file", "vqf"):
        assert not {"pose-posture", "moved-in-pose"} & codes(six, at=44.0, orientation=orientation)


@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_thighs_tell_a_seat_without_any_stance(noise: str) -> None:
    """By the knees, which would bend forward when the wearer walks afterwards."""
    for seed in range(3):
        raw = worn(sitting(walk(15.0)), places.SUIT, noise, seed)
        _, cal = calibrate(raw, at=2.0, strict=False)
        (said,) = [f for f in cal.diagnostics if f.code == "pose-posture"]
        assert "knees would bend forward" in said.sentence and said.value > 45


@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_six_sensors_tell_a_seat_beside_a_stance(noise: str) -> None:
    """By the pelvis; without another stance nothing is said, and nobody's sides are doubted."""
    with_stance = with_static_pose(walk(12.0), "n", 3.0)
    for motion, told in ((sitting(with_stance), True), (sitting(walk(12.0), 3.0), False)):
        raw = worn(motion, places.SIX, noise, 3)
        said = codes(raw, at=1.5)
        assert ("pose-posture" in said) == told
        assert "swapped" not in said


@pytest.mark.parametrize("name", ["05_09", "05_10", "indian_07", "martial_10", "01_08", "14_30"])
def test_low_dances_and_lunges_after_a_stance_are_no_seat(name: str) -> None:
    """Their thighs are 50 to 60 deg, or their pelvis 30 deg, from the N-pose while the legs are in use."""
    for names in (places.SIX, places.SUIT, places.FIVE):
        raw = worn(clip(name), names, "realistic", 1)
        window = find_static(raw, 1.5)
        pose = average(raw, window)
        assert pose_checks.check_posture(raw, window, pose, np.zeros(len(names))) == []


@pytest.mark.parametrize("way", ["tilt", "heading"])
@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_an_orientation_that_jumps_in_the_pose(way: str, noise: str) -> None:
    """By 25 deg, anywhere in the window: early, in the middle or late."""
    raw = worn(with_static_pose(walk(6.0), "n", 4.0), places.SIX, noise, 0)
    turn = np.radians(25.0)
    Q = ori.rot_y(turn) if way == "heading" else ori.exp(np.array([turn, 0, 0]))
    first = find_static(raw, 2.0)
    for at in np.linspace(first.start + 2, first.stop - 3, 9).astype(int):
        seen = jumping(raw, 3, int(at), Q, way == "heading")
        window = find_static(seen, 2.0)
        found = pose_checks.check_pose(seen, window, average(seen, window))
        assert [(f.sensor, f.code) for f in found] == [(raw.sensors[3], "moved-in-pose")], at
        assert "jumps by 2" in found[0].sentence


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5, 0.65, 0.8])
def test_a_turn_that_the_gyroscope_saw(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 25 deg, not in the middle third only: the wobble around it does not excuse it."""
    monkeypatch.setattr(pose_checks, "_jump", lambda raw, window, s: None)
    for seed in range(3):
        raw = worn(with_static_pose(walk(6.0), "n", 4.0), places.SIX, "realistic", seed)
        window = find_static(raw, 2.0)
        at = window.start + int(share * (window.stop - window.start))
        Q = ori.exp(np.array([np.radians(25.0), 0, 0]))
        seen = jumping(raw, 3, at, Q, False)
        found = pose_checks.check_pose(seen, window, average(seen, window))
        assert {f.sensor for f in found} == {raw.sensors[3]}


@pytest.mark.parametrize("rate_hz", [5.0, 30.0, 60.0, 100.0])
def test_wobble_is_no_movement(rate_hz: float) -> None:
    motion = with_static_pose(builtin(rate_hz, 12.0), "n", 3.0)
    for seed in range(6):
        raw = worn(motion, places.SUIT, "realistic", seed)
        window = find_static(raw, 1.5)
        assert pose_checks.check_pose(raw, window, average(raw, window)) == []


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 3.0, 5.0, 8.0])
@pytest.mark.parametrize("names", [places.SIX, places.SUIT], ids=["six", "all"])
def test_low_rates_calibrate(rate_hz: float, names: tuple[str, ...]) -> None:
    """Rates that the options allow: no crash, and nothing false said of the pose or the clocks."""
    motion = with_static_pose(builtin(60.0, 22.6).resampled(rate_hz), "n", 10.0)
    for noise in NOISES:
        raw = replace(raw_recording(motion, names, NOISES[noise], 1), mag=None)
        quiet = {"moved-in-pose", "lag", "slipped", "pose-posture", "pose-not-still"}
        for orientation in ("file", "vqf"):
            assert not quiet & codes(raw, orientation=orientation)
