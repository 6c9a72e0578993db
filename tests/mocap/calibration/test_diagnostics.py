"""Each usual mistake is named, with the right sensor and code; a clean recording raises no alarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import calibrate
from mocap.calibration.checks.single import check_sensors
from mocap.calibration.diagnostics import diagnose, summary
from mocap.calibration.facing import wrap
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.formats import Options, qmt
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, motions, raw_recording
from mocap.synthesis.motions import builtin
from mocap.synthesis.staging import with_static_pose


@pytest.fixture(scope="module")
def motion() -> Motion:
    """The built-in programme twice: a second stance comes in the middle."""
    return builtin(60.0, 45.2)


def make(motion: Motion, noise: str, seed: int, sensors=places.SUIT) -> RawRecording:
    raw = raw_recording(motion.turned(0.7), sensors, NOISES[noise], seed)
    return replace(raw, mag=None)


@pytest.fixture(scope="module")
def clean(motion: Motion) -> RawRecording:
    return make(motion, "none", 1)


@pytest.fixture(scope="module")
def noisy(motion: Motion) -> RawRecording:
    return make(motion, "realistic", 1)


@pytest.fixture(scope="module", params=["none", "realistic"])
def short(request: pytest.FixtureRequest) -> RawRecording:
    """The programme once, the six sensors of DIP."""
    return make(builtin(60.0, 22.6), request.param, 0, places.SIX)


def edited(raw: RawRecording, sensor: str, gyr=None, acc=None) -> RawRecording:
    """`raw` with functions applied to one sensor's gyr and acc (T,3)."""
    s = raw.sensors.index(sensor)
    new_gyr, new_acc = raw.gyr.copy(), raw.acc.copy()
    if gyr is not None:
        new_gyr[:, s] = gyr(raw.gyr[:, s])
    if acc is not None:
        new_acc[:, s] = acc(raw.acc[:, s])
    return replace(raw, gyr=new_gyr, acc=new_acc)


def found(findings: list[Finding] | tuple[Finding, ...]) -> set[tuple[str | None, str]]:
    return {(f.sensor, f.code) for f in findings}


def flip(k: int):
    return lambda x: x * np.where(np.arange(3) == k, -1.0, 1.0)


@pytest.mark.parametrize("noise", ["none", "realistic"])
@pytest.mark.parametrize("seed", range(4))
def test_no_false_alarm(motion: Motion, noise: str, seed: int) -> None:
    raw = make(motion, noise, seed)
    assert calibrate(raw)[1].diagnostics == ()
    assert diagnose(replace(raw, R_world_sensor=None)) == []


@pytest.mark.parametrize("kind", ["thigh", "shank", "foot", "forearm", "hand"])
@pytest.mark.parametrize("noise", ["clean", "noisy"])
def test_swapped_pair(kind: str, noise: str, request: pytest.FixtureRequest) -> None:
    raw = request.getfixturevalue(noise)
    pair = {f"left_{kind}": f"right_{kind}", f"right_{kind}": f"left_{kind}"}
    findings = diagnose(raw.renamed(pair))
    assert found(findings) == {(f"left_{kind}", "swapped"), (f"right_{kind}", "swapped")}
    assert f"left_{kind} and right_{kind}" in findings[0].sentence


def test_swapped_upper_arms_rise_on_the_wrong_side(clean: RawRecording) -> None:
    arms = ("left_upper_arm", "right_upper_arm", "pelvis", "left_shank", "right_shank")
    pair = {arms[0]: arms[1], arms[1]: arms[0]}
    _, cal = calibrate(clean.select(arms).renamed(pair))
    assert {("left_upper_arm", "swapped"), ("right_upper_arm", "swapped")} <= found(cal.diagnostics)


@pytest.mark.parametrize("with_R", [True, False])
@pytest.mark.parametrize("sensor", ["left_forearm", "right_thigh", "left_upper_arm"])
def test_flipped_axes(clean: RawRecording, sensor: str, with_R: bool) -> None:
    raw = clean.select(("pelvis", "head", sensor))
    raw = raw if with_R else replace(raw, R_world_sensor=None)
    findings = diagnose(edited(raw, sensor, gyr=flip(1)))
    assert (sensor, "gyr-axes") in found(findings)
    assert {f.sensor for f in findings} == {sensor}
    assert "axis y of gyr is reversed" in findings[0].sentence
    findings = diagnose(edited(raw, sensor, acc=flip(0)))
    assert (sensor, "acc-axes") in found(findings)
    assert "axis x of acc is reversed" in findings[0].sentence


@pytest.mark.parametrize("sensor", ["left_forearm", "right_forearm", "left_shank", "head"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_flipped_axes_of_a_short_recording_of_six(
    short: RawRecording, sensor: str, axis: int
) -> None:
    """22 s of the programme: half-second means still hold as much of the body's acceleration as half of g."""
    assert not [f for f in diagnose(short) if f.code.endswith("axes")]
    findings = diagnose(edited(short, sensor, acc=flip(axis)))
    assert found(findings) & {(sensor, "acc-axes")}
    assert f"axis {'xyz'[axis]} of acc is reversed" in findings[0].sentence


# What the programme hides: a head that hardly tilts sideways, a clean pelvis that does not at all, never see
# gravity along that axis.
UNSEEN = {("none", "head", 0), ("none", "pelvis", 2), ("realistic", "head", 0)}


@pytest.mark.parametrize("sensor", places.SIX)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_flipped_axes_from_gyr_and_acc_alone(sensor: str, axis: int, noise: str) -> None:
    """22 s with walking, squats and raised limbs; nobody stands still between them on purpose."""
    six = make(builtin(60.0, 22.6), noise, 0, places.SIX)
    raw = replace(six.select((sensor,)), R_world_sensor=None)
    assert not [f for f in diagnose(raw) if f.code.endswith("axes")]
    findings = diagnose(edited(raw, sensor, acc=flip(axis)))
    if (noise, sensor, axis) in UNSEEN:
        return
    assert {(f.sensor, f.code[3:]) for f in findings} == {(sensor, "-axes")}
    if (noise, sensor) == ("none", "pelvis"):
        return  # its sideways axis is never seen, so one axis of gyr explains the same
    others = " and ".join(a for a in "xyz" if a != "xyz"[axis])
    assert f"axis {'xyz'[axis]} of acc is reversed (or {others} of gyr)" in findings[0].sentence


RESTLESS: dict[str, Callable[[], Motion]] = {
    "walk": lambda: motions.walk(20.0),
    "jumping jacks": lambda: motions.jumping_jack(15.0),
    "squats": lambda: motions.joined([motions.squat(3.0)] * 5),
    "programme": lambda: builtin(60.0, 22.6),
}


@pytest.mark.parametrize("what", RESTLESS)
@pytest.mark.parametrize("pose", ["n", "t"])
@pytest.mark.parametrize("names", [places.FIVE, places.SIX], ids=["five", "six"])
def test_right_axes_and_units_raise_no_alarm(what: str, pose: str, names: tuple[str, ...]) -> None:
    """A gait's accelerations are in step with its turning: swinging arms must not look like reversed axes."""
    motion = with_static_pose(RESTLESS[what](), pose, 3.0)
    for noise, seed in (("none", 0), ("realistic", 1), ("realistic", 2)):
        raw = make(motion, noise, seed, names)
        for seen in (raw, replace(raw, R_world_sensor=None)):
            wrong = [f for f in check_sensors(seen) if f.code != "acc-gravity"]
            assert wrong == [], (noise, seed, [f.sentence for f in wrong])


@pytest.mark.parametrize("seconds", [15.0, 25.0])
def test_no_piece_of_the_real_recording_has_wrong_axes_or_units(
    shared: Path, seconds: float
) -> None:
    """Jumps and running in its second half included; a sensor that never rests may read far from g."""
    whole = real(shared)
    n = int(seconds * whole.rate_hz)
    for a in range(0, len(whole) - n + 1, int(10 * whole.rate_hz)):
        piece = whole.slice(a, a + n)
        for seen in (piece, replace(piece, R_world_sensor=None, mag=None)):
            wrong = [f for f in check_sensors(seen) if f.code not in ("acc-gravity", "clipping")]
            assert wrong == [], (a, [f.sentence for f in wrong])


@pytest.mark.parametrize("rate", [30.0, 100.0, 200.0])
def test_flipped_axes_at_other_rates(rate: float) -> None:
    raw = make(builtin(rate, 22.6), "realistic", 0, ("left_shank",))
    raw = replace(raw, R_world_sensor=None)
    assert not [f for f in diagnose(raw) if f.code.endswith("axes")]
    findings = diagnose(edited(raw, "left_shank", acc=flip(1)))
    assert "axis y of acc is reversed" in findings[0].sentence


def swapped(raw: RawRecording) -> set[str | None]:
    return {f.sensor for f in calibrate(raw)[1].diagnostics if f.code == "swapped"}


@pytest.mark.parametrize("start", ["as it is", "N-pose"])
def test_exchanged_pair_that_is_alone_on_its_limbs(start: str) -> None:
    """Six sensors, one pair on each pair of limbs: pelvis and habits tell the sides, whatever the noise."""
    programme = builtin(60.0, 22.6)
    if start == "N-pose":
        programme = with_static_pose(programme, "n", 3.0)
    count = {"shank": 0, "forearm": 0, "both": 0}
    seeds = range(5)
    for seed in seeds:
        raw = make(programme, "realistic", seed, places.SIX)
        assert swapped(raw) == set()
        for which in count:
            kinds = ("shank", "forearm") if which == "both" else (which,)
            sides = (("left", "right"), ("right", "left"))
            pairs = {f"{a}_{k}": f"{b}_{k}" for k in kinds for a, b in sides}
            who = swapped(raw.renamed(pairs))
            assert who <= set(pairs)
            count[which] += who == set(pairs)
    # Over 10 seeds (benchmarks/diagnostics.py) it is 10 of forearms, 9 or 10 of shanks.
    assert count["forearm"] == len(seeds) and count["shank"] >= 4 and count["both"] >= 4


def test_exchanged_pair_of_a_real_person(shared: Path) -> None:
    six = real(shared).select(places.SIX)
    for raw in (six, replace(six, R_world_sensor=None, mag=None)):
        assert "swapped" not in {f.code for f in calibrate(raw)[1].diagnostics}
        for kind in ("shank", "forearm"):
            pair = {f"left_{kind}": f"right_{kind}", f"right_{kind}": f"left_{kind}"}
            _, cal = calibrate(raw.renamed(pair))
            assert {f.sensor for f in cal.diagnostics if f.code == "swapped"} == set(pair)


def test_exchanged_axes(clean: RawRecording) -> None:
    raw = clean.select(("pelvis", "left_forearm"))
    raw = edited(raw, "left_forearm", gyr=lambda x: x[:, [1, 0, 2]])
    (finding,) = (f for f in diagnose(raw) if f.severity == "error")
    assert finding.code == "gyr-axes" and "y, x, z" in finding.sentence


@pytest.mark.parametrize("noise", ["clean", "noisy"])
@pytest.mark.parametrize("with_R", [True, False])
def test_wrong_units(noise: str, with_R: bool, request: pytest.FixtureRequest) -> None:
    raw = request.getfixturevalue(noise).select(("pelvis", "head", "right_shank"))
    raw = raw if with_R else replace(raw, R_world_sensor=None)
    degrees = edited(raw, "right_shank", gyr=np.degrees)
    assert ("right_shank", "gyr-in-deg") in found(diagnose(degrees))
    for scale, code in ((1 / 9.80665, "acc-in-g"), (100.0, "acc-unit"), (3.3, "acc-unit")):
        bad = edited(raw, "head", acc=lambda x, k=scale: x * k)
        assert found(diagnose(bad)) == {("head", code)}
    free = replace(raw, acc=raw.acc * 0.01)
    assert {c for _, c in found(diagnose(free))} == {"acc-without-gravity"}


def test_wrong_units_stop_the_calibration_in_one_sentence(clean: RawRecording) -> None:
    with pytest.raises(CalibrationError, match=r"sensors pelvis, .*: .*acc is in g") as error:
        calibrate(replace(clean, acc=clean.acc / 9.80665))
    assert "\n" not in str(error.value)
    _, cal = calibrate(edited(clean, "head", acc=lambda x: x / 9.80665), strict=False)
    assert ("head", "acc-in-g") in found(cal.diagnostics)


def test_gravity_off_and_clipping_are_warnings(clean: RawRecording) -> None:
    assert ("head", "acc-gravity") in found(diagnose(edited(clean, "head", acc=lambda x: 1.1 * x)))
    clipped = edited(clean, "left_shank", acc=lambda x: np.clip(x, -11.0, 11.0))
    assert ("left_shank", "clipping") in found(diagnose(clipped))


@pytest.mark.parametrize("noise", ["clean", "noisy"])
@pytest.mark.parametrize("sensor", ["sternum", "left_thigh", "right_shank"])
def test_a_sensor_that_slipped(noise: str, sensor: str, request: pytest.FixtureRequest) -> None:
    """Turned on its bone by 25 deg about a horizontal axis after 20 s; the stance at 23 s shows it."""
    raw = request.getfixturevalue(noise)
    s = raw.sensors.index(sensor)
    axis = raw.R_world_sensor[30, s].T @ [0.6, 0, 0.8]
    Q = ori.exp(np.radians(25) * axis)
    gyr, acc, R = raw.gyr.copy(), raw.acc.copy(), raw.R_world_sensor.copy()
    gyr[1200:, s], acc[1200:, s], R[1200:, s] = (
        gyr[1200:, s] @ Q,
        acc[1200:, s] @ Q,
        R[1200:, s] @ Q,
    )
    _, cal = calibrate(replace(raw, gyr=gyr, acc=acc, R_world_sensor=R))
    (finding,) = cal.diagnostics
    assert (finding.sensor, finding.code) == (sensor, "slipped")
    assert finding.value == pytest.approx(25, abs=4)


@pytest.mark.parametrize("sensor", ["sternum", "left_forearm", "right_shank"])
def test_a_late_clock(clean: RawRecording, sensor: str) -> None:
    s, late = clean.sensors.index(sensor), 12
    gyr, acc, R = clean.gyr.copy(), clean.acc.copy(), clean.R_world_sensor.copy()
    for x in (gyr, acc, R):
        x[late:, s] = x[:-late, s].copy()
    (finding,) = diagnose(replace(clean, gyr=gyr, acc=acc, R_world_sensor=R))
    assert (finding.sensor, finding.code) == (sensor, "lag")
    assert finding.value == pytest.approx(0.2, abs=0.1)


def test_a_sensor_that_moved_in_the_pose(clean: RawRecording) -> None:
    s = clean.sensors.index("left_hand")
    angle = np.radians(10) * np.clip((np.arange(len(clean)) - 30) / 60, 0, 1)
    Q = ori.exp(angle[:, None] * [1.0, 0, 0])
    R = clean.R_world_sensor.copy()
    R[:, s] = R[:, s] @ Q
    _, cal = calibrate(replace(clean, R_world_sensor=R), at=1.0)
    assert ("left_hand", "moved-in-pose") in found(cal.diagnostics)


def test_leaning_in_the_pose(clean: RawRecording) -> None:
    """The trunk sensors read 30 deg more upright during the pose than afterwards."""
    raw = clean
    gyr, acc, R = raw.gyr.copy(), raw.acc.copy(), raw.R_world_sensor.copy()
    for name in ("pelvis", "sternum"):
        s = raw.sensors.index(name)
        Q = ori.exp(np.radians(30) * (R[30, s].T @ [1.0, 0, 0]))
        gyr[:125, s], acc[:125, s], R[:125, s] = gyr[:125, s] @ Q, acc[:125, s] @ Q, R[:125, s] @ Q
    _, cal = calibrate(replace(raw, gyr=gyr, acc=acc, R_world_sensor=R), at=1.0, facing=40.0)
    assert ("sternum", "pose-leaning") in found(cal.diagnostics)


def test_a_facing_that_the_motion_contradicts(clean: RawRecording) -> None:
    _, cal = calibrate(clean, facing=np.degrees(0.7) + 90)
    (finding,) = (f for f in cal.diagnostics if f.code == "facing-disagrees")
    assert finding.value == pytest.approx(-90, abs=5)


def test_diagnose_with_a_calibration(clean: RawRecording) -> None:
    clean = clean.select(places.SIX)
    _, cal = calibrate(clean, facing=np.degrees(0.7) + 90)
    assert (None, "facing-disagrees") in found(diagnose(clean, cal))
    lost = clean.valid.copy()
    lost[300:500, 5] = False
    assert (clean.sensors[5], "gaps") in found(diagnose(replace(clean, valid=lost), cal))
    assert summary([]) == "nothing doubtful"


def real(shared: Path) -> RawRecording:
    path = shared / "data/qmt-fullbody/full_body_example_data.mat"
    raw = qmt.FORMAT.read(path, Options()).content
    assert isinstance(raw, RawRecording)
    return raw


def test_real_recording(shared: Path) -> None:
    """qmt's full body: 16 sensors, N-pose at 44 s. Its segment frames say the wearer faces -107 to
    -109 deg then; the motion alone must say the same, and orientation by VQF alone must agree."""
    raw = real(shared)
    raw = replace(raw, facing_rad=None)
    rec, cal = calibrate(raw, at=44.0)
    assert {f.severity for f in cal.diagnostics} <= {"info"}
    assert abs(np.degrees(wrap(-cal.heading[0] + np.radians(108.0)))) < 8
    still = slice(2000, 2900)  # 60 to 69 s
    assert np.linalg.norm(np.nanmean(rec.acc_world[still], axis=0), axis=1).max() < 0.4
    for side in ("left", "right"):
        thigh, shank = (rec.sensors.index(f"{side}_{x}") for x in ("thigh", "shank"))
        knee = np.swapaxes(rec.R_world_bone[:, thigh], -1, -2) @ rec.R_world_bone[:, shank]
        bend = np.degrees(ori.log(knee[100:])[:, 0])
        low, high = np.nanpercentile(bend, [1, 99])
        assert low > -15 and high > 70  # knees bend backward, and hardly the other way
    alone, own = calibrate(raw, at=44.0, orientation="vqf")
    assert "own headings" in own.method
    both = slice(600, 1500)
    apart = ori.angle_between(rec.R_world_bone[both], alone.R_world_bone[both])
    legs_and_trunk = [s for s, n in enumerate(rec.sensors) if "arm" not in n and "hand" not in n]
    assert np.degrees(np.nanmean(apart[:, legs_and_trunk], axis=0)).max() < 15


def test_real_recording_with_swapped_shanks(shared: Path) -> None:
    raw = real(shared)
    pair = {"left_shank": "right_shank", "right_shank": "left_shank"}
    findings = diagnose(replace(raw.renamed(pair), R_world_sensor=None))
    assert found(findings) == {("left_shank", "swapped"), ("right_shank", "swapped")}
