"""Stances in realistic noise: found without a time, and nothing wrong said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import PoseName, calibrate
from mocap.calibration.static_pose import find_static
from mocap.calibration.stillness import still_runs
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, motions, prepare, raw_recording
from mocap.synthesis.motions import builtin, walk
from mocap.synthesis.staging import with_static_pose

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


MOTIONS = {
    "squat": lambda: motions.squat(8.0),
    "arm raises": lambda: motions.arm_raises(8.0),
    "jumping jack": lambda: motions.jumping_jack(8.0),
    "leg raise": lambda: motions.leg_raise(8.0),
    "walk": lambda: walk(10.0),
    "programme": lambda: builtin(60.0, 22.6),
}
QUIET = {"slipped", "lag", "moved-in-pose"}


@pytest.mark.parametrize("what", MOTIONS)
@pytest.mark.parametrize("pose", ["n", "t"])
def test_a_recording_after_a_pose_raises_no_alarm(what: str, pose: PoseName) -> None:
    """Arms that hang after a T-pose, or stay up after an N-pose, have not slipped; gaits have no lags.

    Reversed axes and exchanged sides have tests of their own.
    """
    motion = prepare(with_static_pose(MOTIONS[what](), pose, 2.0), 60.0, 8.0)
    for k, sensors in enumerate((places.SIX, places.FIVE, places.SUIT)):
        for noise, seed in (("none", 4), ("realistic", 4 + k)):
            raw = raw_of(motion, sensors, noise, seed)
            _, cal = calibrate(raw, pose=pose, at=1.0, strict=False)
            said = [f for f in cal.diagnostics if not f.code.endswith("axes")]
            wrong = [f.sentence for f in said if f.severity == "error" or f.code in QUIET]
            assert wrong == [], (len(sensors), noise)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_what_gaps_hide_is_no_movement_of_the_sensor(seed: int) -> None:
    """Own orientation filter: behind a burst of lost samples the wobble is elsewhere by some degrees."""
    raw = raw_of(builtin(60.0, 12.0), places.SIX, "realistic", seed)
    _, cal = calibrate(raw, orientation="vqf", facing=0.0, strict=False)
    assert "moved-in-pose" not in {f.code for f in cal.diagnostics}


@pytest.mark.parametrize("sensor", ["left_forearm", "pelvis"])
def test_a_sensor_that_slipped_after_a_t_pose(sensor: str) -> None:
    """By 30 deg, seen in another T-pose at the end."""
    motion = with_static_pose(motions.squat(4.0), "t", 2.0)
    R, p = motion.R_parent_joint, motion.p_world_root
    motion = replace(
        motion,
        R_parent_joint=np.concatenate([R, R[::-1]]),
        p_world_root=np.concatenate([p, p[::-1]]),
    )
    raw = raw_of(prepare(motion, 60.0, 8.0), places.SIX, "realistic", 2)
    assert raw.R_world_sensor is not None and raw.truth is not None
    s, k = raw.sensors.index(sensor), round(5.0 * 60)
    Q = ori.exp(np.radians(30) * (np.array(raw.truth["R_bone_sensor"])[s].T @ [0.6, 0, 0.8]))
    gyr, acc, R_world_sensor = raw.gyr.copy(), raw.acc.copy(), raw.R_world_sensor.copy()
    for x in (gyr, acc, R_world_sensor):
        x[k:, s] = x[k:, s] @ Q
    slipped = replace(raw, gyr=gyr, acc=acc, R_world_sensor=R_world_sensor)
    _, cal = calibrate(slipped, pose="t", at=1.0, facing=0.0, strict=False)
    assert {f.sensor for f in cal.diagnostics if f.code == "slipped"} == {sensor}
