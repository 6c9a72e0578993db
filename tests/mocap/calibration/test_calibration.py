"""From raw sensors back to the bones: exact without noise, within the sigmas with it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import Calibration, PoseName, calibrate
from mocap.calibration.facing import wrap
from mocap.calibration.static_pose import find_static
from mocap.errors import CalibrationError, SensorError
from mocap.findings import Finding
from mocap.formats import Options, xsens_mtw
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.skeleton import Skeleton
from mocap.stances import pose_bones
from mocap.synthesis import NOISES, prepare, raw_recording, recording
from mocap.synthesis.motions import builtin, walk
from mocap.synthesis.staging import with_static_pose

ARMS = ("left_upper_arm", "right_upper_arm", "left_forearm", "right_forearm", "pelvis")


def n_to_t(rate_hz: float = 60.0) -> Motion:
    """2 s N-pose, arms up within 1 s, 2 s T-pose, down again within 1 s, 1 s N-pose."""
    t = np.arange(0, 7, 1 / rate_hz)
    s = np.clip(np.minimum(t - 2, 6 - t), 0, 1)
    down = np.radians(80) * (1 - s * s * (3 - 2 * s))
    R = np.tile(np.eye(3), (len(t), 24, 1, 1))
    R[:, 16], R[:, 17] = ori.rot_z(-down), ori.rot_z(down)
    return Motion(rate_hz, R, np.zeros((len(t), 3)), Skeleton.default())


def raw_of(motion: Motion, sensors=places.SUIT, noise="none", seed=0) -> RawRecording:
    return replace(raw_recording(motion, sensors, NOISES[noise], seed), mag=None)


def error_deg(rec: Recording, truth: Motion) -> np.ndarray:
    """Angle (T,S) in deg to the true bones; `truth` faces +z in the pose."""
    return np.degrees(ori.angle_between(truth.R_world_joint[:, rec.joint], rec.R_world_bone))


@pytest.fixture(scope="module")
def motion() -> Motion:
    return builtin(60.0)


@pytest.fixture(scope="module")
def raw(motion: Motion) -> RawRecording:
    """The wearer faces 40 deg to the left of +z in the sensors' world, and nobody says so."""
    return raw_of(motion.turned(np.radians(40)))


@pytest.mark.parametrize("sensors", [places.SUIT, places.SIX])
def test_no_noise_gives_the_truth(motion: Motion, sensors: tuple[str, ...]) -> None:
    raw = raw_of(motion.turned(np.radians(40)), sensors)
    rec, cal = calibrate(raw)
    assert error_deg(rec, motion).max() < 0.1
    clean = recording(motion, sensors).acc_world[1:-1]
    assert np.abs(rec.acc_world[1:-1] - clean).max() < 0.05
    assert np.degrees(cal.heading) == pytest.approx(-40, abs=0.1)
    assert cal.diagnostics == ()
    assert rec.reference is not None
    assert np.abs(rec.reference.R_parent_joint - motion.R_parent_joint).max() < 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_realistic_noise_stays_within_its_sigmas(motion: Motion, seed: int) -> None:
    """Soft tissue of 2 deg per axis has an rms angle of 3.5 deg; the pose's mean of it, about 1.3
    per axis, heading drift and the facing add to that."""
    rec, cal = calibrate(raw_of(motion.turned(0.7), places.SUIT, "realistic", seed), at=1.0)
    assert np.nanmean(error_deg(rec, motion)) < 4.6
    assert np.nanmean(error_deg(rec, motion), axis=0).max() < 8.0
    assert abs(np.degrees(wrap(cal.heading[0] + 0.7))) < 4.0


def test_gyr_and_acc_alone_give_the_bones(motion: Motion) -> None:
    """VQF without magnetometer: 17 headings of their own, found from motion. Seen: mean 2.3 deg."""
    raw = raw_of(motion.turned(0.7), places.SUIT)
    rec, cal = calibrate(raw, orientation="vqf")
    assert cal.orientation == "vqf" and "shared acceleration" in cal.method
    error = error_deg(rec, motion)
    assert error.mean() < 4.0
    legs = [s for s, n in enumerate(raw.sensors) if n.endswith(("thigh", "shank", "foot"))]
    assert error[:, legs].mean() < 2.0


def test_six_sensors_with_headings_of_their_own(motion: Motion) -> None:
    """The shanks from their hinge, the forearms from the gait, the rest by shared acceleration."""
    rec, cal = calibrate(raw_of(motion.turned(0.7), places.SIX), orientation="vqf")
    assert "arm swing" in cal.method
    assert error_deg(rec, motion).mean(axis=0).max() < 5.0


def test_magnetometers_give_one_heading(motion: Motion) -> None:
    raw = raw_recording(motion.turned(0.7), places.SIX, NOISES["none"], 0)
    rec, cal = calibrate(raw, orientation="vqf")
    assert np.ptp(cal.heading) == 0
    assert error_deg(rec, motion).mean() < 2.0


def test_hanging_arms_tell_the_facing_after_a_t_pose() -> None:
    motion = n_to_t()
    raw = raw_of(motion.turned(-1.0), ARMS)
    rec, cal = calibrate(raw, pose="t", at=4.0)
    assert cal.method == "hanging arms"
    assert error_deg(rec, motion).max() < 0.1


def test_accelerometers_are_scaled_to_gravity(motion: Motion, raw: RawRecording) -> None:
    clean = calibrate(raw)[0].acc_world
    rec, cal = calibrate(replace(raw, acc=1.02 * raw.acc))
    assert cal.acc_scale == pytest.approx(np.full(17, 1 / 1.02))
    assert np.nanmax(np.abs(rec.acc_world - clean)) < 1e-5
    rec, cal = calibrate(replace(raw, acc=1.02 * raw.acc), scale_acc=False)
    assert (cal.acc_scale == 1).all()
    assert np.nanmedian(rec.acc_world[:100, :, 1]) == pytest.approx(0.196, abs=1e-3)


def test_turning_the_world_about_gravity_changes_nothing(raw: RawRecording) -> None:
    rec, _ = calibrate(raw)
    turned, cal = calibrate(replace(raw, R_world_sensor=ori.rot_y(2.1) @ raw.R_world_sensor))
    assert np.abs(turned.R_world_bone - rec.R_world_bone).max() < 1e-6
    assert np.abs(turned.acc_world - rec.acc_world).max() < 1e-5
    assert np.degrees(wrap(cal.heading[0])) == pytest.approx(-40 - np.degrees(2.1), abs=0.2)


def test_mounting_drops_out(raw: RawRecording, rng: np.random.Generator) -> None:
    Q = ori.from_quat(rng.normal(size=(len(raw.sensors), 4)))
    other = replace(
        raw,
        gyr=np.einsum("sji,tsj->tsi", Q, raw.gyr),
        acc=np.einsum("sji,tsj->tsi", Q, raw.acc),
        R_world_sensor=raw.R_world_sensor @ Q,
    )
    a, b = calibrate(raw)[0], calibrate(other)[0]
    assert np.abs(a.R_world_bone - b.R_world_bone).max() < 1e-6
    assert np.abs(a.acc_world - b.acc_world).max() < 1e-5


def test_a_wrong_facing_conjugates_every_rotation(motion: Motion, raw: RawRecording) -> None:
    """It is no gauge: R_world_bone = R_y(e) R_true B^T R_y(-e) B, the docstring's formula."""
    rec, _ = calibrate(raw, facing=40.0 - 30.0)
    E, B = ori.rot_y(np.radians(30)), pose_bones(rec.joint)
    true = motion.R_world_joint[:, rec.joint]
    expected = E @ true @ np.swapaxes(B, -1, -2) @ E.T @ B
    assert np.degrees(ori.angle_between(expected, rec.R_world_bone)).max() < 0.1
    assert error_deg(rec, motion).max() > 20


def test_facing_may_be_given_declared_or_in_the_file(motion: Motion, raw: RawRecording) -> None:
    given, cal = calibrate(raw, facing=40.0)
    assert error_deg(given, motion).max() < 0.1 and "given" in cal.method
    filed, cal = calibrate(replace(raw, facing_rad=np.radians(40.0)))
    assert error_deg(filed, motion).max() < 0.1 and "file" in cal.method
    # Mount the pelvis sensor with its -z axis to the wearer's left.
    s = raw.sensors.index("pelvis")
    R = raw.R_world_sensor.copy()
    left = ori.rot_y(np.radians(40)) @ [1, 0, 0]
    up = np.array([0, 1.0, 0])
    start = np.stack([np.cross(up, -left), up, -left], axis=1)
    Q = R[0, s].T @ start
    R[:, s] = R[:, s] @ Q
    gyr, acc = raw.gyr.copy(), raw.acc.copy()
    gyr[:, s], acc[:, s] = gyr[:, s] @ Q, acc[:, s] @ Q
    known = replace(raw, gyr=gyr, acc=acc, R_world_sensor=R)
    declared, cal = calibrate(known, axes={"pelvis": "-z left"})
    assert error_deg(declared, motion).max() < 0.1 and "-z left" in cal.method


def test_nothing_tells_the_facing_is_said_loudly(motion: Motion) -> None:
    still = motion.slice(0, 110)
    rec, cal = calibrate(raw_of(still))
    assert cal.method == "assumed" and cal.heading_sigma.min() == np.pi
    (said,) = cal.diagnostics
    assert said.code == "facing-assumed" and "ASSUMED" in said.sentence
    assert error_deg(rec, still).max() < 0.1  # it does face +z here


@pytest.mark.parametrize("own", [False, True])
def test_second_pose_tells_the_facing(own: bool) -> None:
    """N then T: each arm turns about the forward axis, so even own headings come out.

    With own headings the accelerations that the arms share with the trunk have a say, too.
    """
    bound = 6.0 if own else 0.1
    motion = n_to_t()
    raw = raw_of(motion.turned(-1.0), ARMS)
    if own:
        yaw = ori.rot_y(np.array([0.5, -2.0, 3.0, 1.0, 0.0]))
        raw = replace(raw, R_world_sensor=yaw @ raw.R_world_sensor, common_heading=False)
    rec, cal = calibrate(raw, at=1.0, second=("t", 4.0))
    assert "second pose" in cal.method
    assert error_deg(rec, motion)[:, :4].max() < bound
    t_first, _ = calibrate(raw, pose="t", at=4.0, second=("n", 1.0))
    assert error_deg(t_first, motion)[:, :4].max() < bound


@pytest.mark.parametrize(
    ("sensors", "second", "code", "said"),
    [
        (ARMS, ("t", 1.5), "second-pose", r"is not used: \w+ tilts by 0 deg .*, 80 expected"),
        (ARMS, ("n", 4.0), "second-pose", "is not used: no bone with a sensor tilts by more than 30"),
        (("pelvis", "head"), ("t", 4.0), "second-pose", r"\(T, 3.00 to 5.\d+ s\) is not used: no bone"),
        (ARMS, ("t", 2.45), "second-pose", "does not fit: left_forearm tilts by 35 deg"),
        (ARMS, ("t", 2.45), "second-pose-not-still", r"the wearer moves then \(\d+ deg/s\)"),
        (ARMS, ("t", 4.0), None, ""),
    ],
)  # fmt: skip
def test_a_second_pose_that_fails_is_told(
    sensors: tuple[str, ...], second: tuple[PoseName, float], code: str | None, said: str
) -> None:
    _, cal = calibrate(raw_of(n_to_t(), sensors), at=1.0, second=second)
    found = {f.code: f for f in cal.diagnostics if f.code.startswith("second-pose")}
    if code is None:
        assert not found and "second pose" in cal.method
    else:
        assert found[code].severity == "warning" and re.search(said, found[code].sentence)


def test_a_second_pose_that_the_facing_contradicts_is_told() -> None:
    raw = raw_of(n_to_t(), ("left_upper_arm", "pelvis"))
    _, cal = calibrate(raw, at=1.0, second=("t", 4.0), facing=100.0)
    (said,) = [f for f in cal.diagnostics if f.code == "second-pose-disagrees"]
    assert "facing as given says otherwise" in said.sentence


def test_pose_bones_are_the_design_s() -> None:
    joints, _ = places.joints_and_seats(places.SUIT)
    assert (pose_bones(joints, "t") == np.eye(3)).all()
    n = pose_bones(joints, "n", 80.0)
    left, right = places.SUIT.index("left_hand"), places.SUIT.index("right_forearm")
    # The left arm (rest: +x) hangs down and a little outward.
    assert n[left] @ [1, 0, 0] == pytest.approx([np.cos(1.3962634), -np.sin(1.3962634), 0])
    assert n[right] @ [-1, 0, 0] == pytest.approx([-np.cos(1.3962634), -np.sin(1.3962634), 0])
    assert (n[places.SUIT.index("left_shank")] == np.eye(3)).all()
    with pytest.raises(CalibrationError, match="pose 'x' unknown"):
        pose_bones(joints, "x")
    with pytest.raises(CalibrationError, match="arm angle"):
        pose_bones(joints, "n", 170.0)


def test_json_round_trip_and_apply(raw: RawRecording) -> None:
    rec, cal = calibrate(raw, at=1.0)
    again = Calibration.from_json(cal.to_json())
    assert again.sensors == cal.sensors and again.diagnostics == cal.diagnostics
    assert np.array_equal(again.R_bone_sensor, cal.R_bone_sensor)
    assert np.abs(again.apply(raw).R_world_bone - rec.R_world_bone).max() < 1e-9
    assert rec.calibration is not None and rec.calibration["time_s"] == list(cal.time)
    with pytest.raises(CalibrationError, match="left_shank"):
        again.apply(raw.select(("pelvis", "head")))
    for text in ("", "[]", "{}", '{"schema": "other"}'):
        with pytest.raises(CalibrationError, match="calibration"):
            Calibration.from_json(text)


def test_vqf_calibration_applies_to_the_raw_file(motion: Motion) -> None:
    raw = raw_of(motion, places.SIX)
    rec, cal = calibrate(raw, orientation="vqf", facing=0.0)
    again = Calibration.from_json(cal.to_json()).apply(raw)
    assert np.abs(again.R_world_bone - rec.R_world_bone).max() < 1e-9


def test_static_pose_is_found_on_the_file_s_clock(motion: Motion) -> None:
    raw = replace(raw_of(motion, places.SIX), start_s=40.0)
    window = find_static(raw)
    start, stop = window.seconds(raw)
    assert 40.0 <= start < stop <= 42.6 and window.still and window.found
    with pytest.raises(CalibrationError, match="outside the recording, 40 to"):
        find_static(raw, 3.0)
    moving = find_static(raw, 46.0)
    assert not moving.still


def findings(raw: RawRecording, code: str, **given) -> list[Finding]:
    _, cal = calibrate(raw, facing=0.0, strict=False, **given)
    return [f for f in cal.diagnostics if f.code == code]


def test_a_wearer_who_walks_in_the_pose_is_refused(raw: RawRecording) -> None:
    with pytest.raises(
        CalibrationError, match=r"the wearer moves at the time of the pose, 5\.7.*deg/s"
    ):
        calibrate(raw, at=6.0)
    (walking,) = findings(raw, "pose-not-still", at=6.0)
    assert walking.severity == "error" and np.degrees(walking.value) > 40
    # About to walk off: not still, but no more than a person who shifts his weight.
    (leaving,) = findings(raw, "pose-not-still", at=2.25)
    assert leaving.severity == "warning" and 7 < np.degrees(leaving.value) < 34
    calibrate(raw, at=2.25)


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 200.0])
@pytest.mark.parametrize("sensors", [places.SIX, ("left_wrist", "right_pocket", "head")])
def test_noise_in_the_pose_is_not_movement(sensors: tuple[str, ...], rate_hz: float) -> None:
    """The wobble of the realistic noise turns still sensors by 10 deg/s, after smoothing."""
    motion = prepare(with_static_pose(walk(4.0), "n", 3.0), rate_hz, 8.0)
    for seed in range(3):
        raw = raw_of(motion, sensors, "realistic", seed)
        for at in (0.3, 1.6):
            _, cal = calibrate(raw, at=at, facing=0.0, strict=False)
            assert not {"pose-not-still", "moved-in-pose"} & {f.code for f in cal.diagnostics}
            assert 0.5 < cal.time[1] - cal.time[0] < 2.1 and cal.time[1] < 4.0
        (walking,) = findings(raw, "pose-not-still", at=6.0)
        assert walking.severity == "error"


def test_sitting_still_is_not_taken_for_the_pose(motion: Motion) -> None:
    """A longer, calmer seat before the N-pose: thighs and trunk are not as in the rest of the file."""
    R = np.array(motion.R_parent_joint[:1])
    R[0, [1, 2]] = ori.rot_x(np.radians(-85))
    R[0, [4, 5]] = ori.rot_x(np.radians(85))
    R[0, 0] = ori.rot_x(np.radians(-15))
    seat = Motion(60.0, np.repeat(R, 300, axis=0), np.zeros((300, 3)), motion.skeleton)
    s = np.linspace(0, 1, 60)
    stand = ori.interpolate([0, 1], np.stack([R[0], motion.R_parent_joint[0]]), s * s * (3 - 2 * s))
    whole = Motion(
        60.0,
        np.concatenate([seat.R_parent_joint, stand, motion.R_parent_joint]),
        np.concatenate([np.zeros((360, 3)), motion.p_world_root]),
        motion.skeleton,
    )
    assert find_static(raw_of(whole)).start >= 350


def test_a_recording_that_never_rests_is_refused(motion: Motion) -> None:
    raw = raw_of(motion.slice(480, 780))
    with pytest.raises(CalibrationError, match="static pose"):
        find_static(replace(raw, gyr=raw.gyr + 2.0))  # rad/s


def test_bad_declarations_are_refused(raw: RawRecording) -> None:
    with pytest.raises(CalibrationError, match="x forward"):
        calibrate(raw, axes={"pelvis": "forward"})
    with pytest.raises(SensorError, match="belly"):
        calibrate(raw, axes={"belly": "x forward"})
    up = replace(raw, R_world_sensor=None)
    with pytest.raises(CalibrationError, match="no orientation"):
        calibrate(up, orientation="file")


def test_a_sensor_lost_in_the_pose_is_named(raw: RawRecording) -> None:
    valid = raw.valid.copy()
    valid[:150, 3] = False
    with pytest.raises(CalibrationError, match=raw.sensors[3]):
        calibrate(replace(raw, valid=valid), at=1.0)


def test_real_walk_faces_where_its_pelvis_sensor_says(shared: Path) -> None:
    """OpenSense: the pelvis sensor's z axis points forward; the gait alone must say so as well."""
    folder = shared / "data/opensense"
    options = Options(mapping=folder / "myIMUMappings.xml")
    raw = xsens_mtw.FORMAT.read(folder, options).content
    assert isinstance(raw, RawRecording)
    walked, cal = calibrate(raw)
    assert "hinge of the shank" in cal.method and cal.diagnostics == ()
    _, known = calibrate(raw, axes={"pelvis": "z forward"})
    assert abs(np.degrees(wrap(cal.heading[0] - known.heading[0]))) < 12
    thigh, shank = (walked.sensors.index(f"right_{x}") for x in ("thigh", "shank"))
    knee = np.swapaxes(walked.R_world_bone[:, thigh], -1, -2) @ walked.R_world_bone[:, shank]
    low, high = np.nanpercentile(np.degrees(ori.log(knee)[:, 0]), [1, 99])
    assert low > -12 and 45 < high < 85
