"""From raw sensors to a recording: static pose, heading, sensor-to-bone rotation, gravity.

    R_world_bone(t) = R_y(heading_s) R_world_sensor(t) R_bone_sensor^T
    R_bone_sensor   = R_world_bone(pose)^T R_y(heading_s) R_world_sensor(pose)
    acc_world       = k_s R_y(heading_s) R_world_sensor acc - g e_y,    k_s = g / |acc(pose)|

In the T-pose every bone is the identity; in the N-pose the left arm's joints 16, 18, 20, 22 are at
R_z(-a), the right arm's 17, 19, 21, 23 at R_z(+a). The wearer faces +z in the pose, so heading_s is
minus the heading of the wearer's forward in the world of sensor s. It is not a free choice of the
world's yaw: see `mocap.facing` for what a wrong one does and what tells the right one.

k_s takes out what an accelerometer reads too much or too little of gravity, as a factor: on a real
recording of 16 sensors it brought the mean still residual from 0.19 to 0.06 m/s^2 in a later, seated
pose, where a bias along gravity would have left 0.10.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from mocap import arm_checks, fusion
from mocap import diagnostics as checks
from mocap import facing as face
from mocap import headings as heads
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording
from mocap.static_pose import NEVER_STILL, Pose, Window, average, find_static

SCHEMA = "poser-calibration/1"
LEFT_ARM, RIGHT_ARM = (16, 18, 20, 22), (17, 19, 21, 23)
ARM_ANGLE_DEG = 80.0
PoseName = Literal["n", "t"]
Orientation = Literal["auto", "file", "vqf"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """How S sensors sit on their bones, and how sure that is.

    sensors: their places. R_bone_sensor (S,3,3). heading (S,) rad: turns each sensor's world about y
    into the one in which the wearer faced +z in the pose. heading_sigma (S,) rad: 1-sigma of it, pi
    where it was merely assumed or could be the opposite. pose: "n" or "t". arm_angle_deg: of the N-pose.
    time: start and end of the pose in s on the recording's clock. method: what the heading rests on, in
    words. orientation: "file" or "vqf" (with "vqf" and no magnetometer the headings hold for this recording
    alone, R_bone_sensor for as long as the sensors stay where they are). diagnostics: the findings.
    acc_scale (S,): factor on acc, ones unless given.
    """

    sensors: tuple[str, ...]
    R_bone_sensor: Array
    heading: Array
    heading_sigma: Array
    pose: str
    arm_angle_deg: float
    time: tuple[float, float]
    method: str
    orientation: str
    diagnostics: tuple[Finding, ...] = ()
    acc_scale: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        S = len(self.sensors)
        if self.acc_scale is None:
            object.__setattr__(self, "acc_scale", np.ones(S))
        for name, shape in (
            ("R_bone_sensor", (S, 3, 3)),
            ("heading", (S,)),
            ("heading_sigma", (S,)),
            ("acc_scale", (S,)),
        ):
            value = np.array(getattr(self, name), float)
            if value.shape != shape or not np.isfinite(value).all():
                raise CalibrationError(
                    f"Calibration: {name} must be finite and {shape}, got {value.shape}"
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not ori.is_rotation(self.R_bone_sensor).all():
            s = int(np.argmin(ori.is_rotation(self.R_bone_sensor)))
            raise CalibrationError(
                f"Calibration: R_bone_sensor of {self.sensors[s]} is not a rotation"
            )

    def to_json(self) -> str:
        """All of it as JSON text."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain JSON-like data: what a Recording carries as `calibration`."""
        return {
            "schema": SCHEMA,
            "sensors": list(self.sensors),
            "R_bone_sensor": self.R_bone_sensor.tolist(),
            "heading_rad": self.heading.tolist(),
            "heading_sigma_rad": self.heading_sigma.tolist(),
            "acc_scale": self.acc_scale.tolist(),
            "pose": self.pose,
            "arm_angle_deg": self.arm_angle_deg,
            "time_s": list(self.time),
            "method": self.method,
            "orientation": self.orientation,
            "diagnostics": [f.to_dict() for f in self.diagnostics],
        }

    @classmethod
    def from_json(cls, text: str) -> Calibration:
        """Inverse of `to_json`. Raises CalibrationError where the text is something else."""
        try:
            data = json.loads(text)
            if data["schema"] != SCHEMA:
                raise CalibrationError(
                    f"calibration: schema is {data['schema']!r}, expected {SCHEMA!r}"
                )
            return cls(
                tuple(map(str, data["sensors"])),
                np.array(data["R_bone_sensor"], float),
                np.array(data["heading_rad"], float),
                np.array(data["heading_sigma_rad"], float),
                str(data["pose"]),
                float(data["arm_angle_deg"]),
                (float(data["time_s"][0]), float(data["time_s"][1])),
                str(data["method"]),
                str(data["orientation"]),
                tuple(Finding(**f) for f in data["diagnostics"]),
                np.array(data["acc_scale"], float),
            )
        except (ValueError, KeyError, TypeError, IndexError) as e:
            raise CalibrationError(f"not a calibration: {type(e).__name__} {e}") from e

    def apply(self, raw: RawRecording) -> Recording:
        """The calibrated recording of `raw`, which must have these sensors (others are left out).

        Uses R_world_sensor of `raw`; where it has none, or the calibration was made with VQF, it is
        fused again. A reference motion is turned so that its pelvis faces +z during the pose, as the
        result does. Raises CalibrationError where a sensor is missing.
        """
        missing = [n for n in self.sensors if n not in raw.sensors]
        if missing:
            raise CalibrationError(
                f"calibration is for sensor {', '.join(missing)}, which the recording lacks; it has: "
                f"{', '.join(raw.sensors)}"
            )
        raw = raw.select(self.sensors)
        if self.orientation == "vqf" or raw.R_world_sensor is None:
            raw = fusion.with_orientation(raw)
        return self._apply(raw)

    def _apply(self, raw: RawRecording) -> Recording:
        assert raw.R_world_sensor is not None
        R_turned = ori.rot_y(self.heading) @ raw.R_world_sensor
        acc = np.einsum("tsij,tsj->tsi", R_turned, raw.acc * self.acc_scale[:, None])
        acc[..., 1] -= ori.GRAVITY
        return Recording(
            raw.rate_hz,
            self.sensors,
            R_turned @ np.swapaxes(self.R_bone_sensor, -1, -2),
            acc,
            valid=raw.valid & np.isfinite(raw.R_world_sensor).all((-1, -2)),
            reference=self._turned_reference(raw),
            calibration=self.to_dict(),
            start_s=raw.start_s,
        )

    def _turned_reference(self, raw: RawRecording) -> Motion | None:
        """The reference facing +z in the pose; None where the pose lies outside the recording."""
        start, stop = (round((t - raw.start_s) * raw.rate_hz) for t in self.time)
        if raw.reference is None or start < 0 or stop > len(raw):
            return None
        pelvis = raw.reference.R_world_joint[start:stop, 0]
        return raw.reference.turned(-float(ori.heading(ori.mean(pelvis))))


def pose_bones(joints: np.ndarray, pose: str = "n", arm_angle_deg: float = ARM_ANGLE_DEG) -> Array:
    """R_world_bone (S,3,3) of bones `joints` (S,) in the T- or N-pose of a wearer who faces +z."""
    if pose not in ("n", "t"):
        raise CalibrationError(f"pose {pose!r} unknown: n (arms down) or t (arms to the sides)")
    if not 0 <= arm_angle_deg <= 100:
        raise CalibrationError(f"arm angle {arm_angle_deg:g} deg is outside 0 to 100")
    a = np.radians(arm_angle_deg) if pose == "n" else 0.0
    angles = np.where(np.isin(joints, LEFT_ARM), -a, np.where(np.isin(joints, RIGHT_ARM), a, 0.0))
    return ori.rot_z(angles)


def calibrate(
    raw: RawRecording,
    pose: PoseName = "n",
    at: float | None = None,
    arm_angle_deg: float = ARM_ANGLE_DEG,
    facing: float | None = None,
    axes: Mapping[str, str] | None = None,
    second: tuple[PoseName, float] | None = None,
    orientation: Orientation = "auto",
    scale_acc: bool = True,
    strict: bool = True,
) -> tuple[Recording, Calibration]:
    """Calibrate `raw` from a static pose.

    pose: "n" (arms down) or "t". at: its time in s on the recording's clock, else it is found. facing:
    heading of the wearer's forward in the sensors' world in deg (0: our +z, 90: +x), where known. axes:
    known mountings, {"pelvis": "x forward"}. second: another static pose and its time, ("t", 12.5).
    Without these three: the file's own `facing_rad`, else the motion, else 0 is assumed and a warning
    says so. orientation: "file" (R_world_sensor of `raw`), "vqf" (from gyr, acc and mag), "auto" (the
    file's if it has one). scale_acc: scale each accelerometer to read g in the pose (by 5 % at most, and
    only in a pose that is still). strict: raise CalibrationError at a finding of severity "error"; with False
    the result comes anyway, and the findings are in its `diagnostics`. A wearer who moves at a time that was
    given is an error above `NEVER_STILL` rad/s, below it a warning.
    """
    joints, _ = places.joints_and_seats(raw.sensors)
    bones = pose_bones(joints, pose, arm_angle_deg)
    if orientation == "file" and raw.R_world_sensor is None:
        raise CalibrationError("the recording carries no orientation: use orientation='vqf'")
    source = "file" if raw.R_world_sensor is not None and orientation != "vqf" else "vqf"
    findings = checks.check_before(raw if source == "file" else replace(raw, R_world_sensor=None))
    if strict and any(f.severity == "error" for f in findings):
        raise CalibrationError(checks.summary(findings))
    window = find_static(raw, at)
    if window.rival:
        findings.append(_rival(raw, window))
    fused = raw if source == "file" else fusion.with_orientation(raw)
    static = average(fused, window)
    told: list[face.Cue] = []
    if second:
        told, doubts = _second_pose(
            fused, static, bones, pose_bones(joints, second[0], arm_angle_deg), second
        )
        findings += doubts
    cues = _cues(fused, static, window, facing, axes, told, pose == "n")
    heading, sigma, method, said = _headings(fused, static, window, joints, cues)
    findings += said
    if told and "second pose" not in method:
        text = f"the second pose is not used: {method} says otherwise of where the wearer faced"
        findings.append(Finding("warning", None, "second-pose-disagrees", text))
    findings += checks.check_result(fused, window, static, heading, sigma, pose)
    # The heading cue of a sensor that slipped is wrong since then: that is no other fault.
    slipped = {f.sensor for f in findings if f.code == "slipped"}
    findings = [f for f in findings if f.code != "heading-off" or f.sensor not in slipped]
    other = arm_checks.check_pose_name(fused, window, static, heading, sigma, pose, arm_angle_deg)
    if other:
        # Arms that start from another pose than said seem to go to the wrong side.
        findings = [f for f in findings if f.code != "swapped"] + other
    # Standing people turn by less than 5 deg/s, 17 with the realistic noise; in walking it is 50 and more.
    if not window.still and window.rate > NEVER_STILL:
        findings = [
            replace(f, severity="error") if f.code == "pose-not-still" else f for f in findings
        ]
    if strict and any(f.severity == "error" for f in findings):
        raise CalibrationError(checks.summary(findings))
    R_bone_sensor = np.swapaxes(bones, -1, -2) @ ori.rot_y(-heading) @ static.R_world_sensor
    result = Calibration(
        raw.sensors,
        R_bone_sensor,
        -heading,
        sigma,
        pose,
        arm_angle_deg,
        window.seconds(raw),
        method,
        source,
        tuple(checks.ordered(findings)),
        _scale(static) if scale_acc and window.still else np.ones(len(raw.sensors)),
    )
    return result._apply(fused), result


def _rival(raw: RawRecording, window: Window) -> Finding:
    assert window.rival is not None
    a, b = window.seconds(raw)
    c, d = (raw.start_s + k / raw.rate_hz for k in window.rival)
    text = (
        f"the pose is taken at {a:.2f} to {b:.2f} s, but at {c:.2f} to {d:.2f} s the body is about as still "
        f"in another posture: if that is the pose, name its time (--at {(c + d) / 2:.1f})"
    )
    return Finding("warning", None, "pose-ambiguous", text)


def _scale(static: Pose) -> Array:
    """g / |acc(pose)| (S,); one where it would change more than 5 %, which is another fault."""
    scale = ori.GRAVITY / np.maximum(np.linalg.norm(static.acc, axis=1), 1e-9)
    return np.where(np.abs(scale - 1) < 0.05, scale, 1.0)


def _headings(
    raw: RawRecording,
    static: Pose,
    window: Window,
    joints: np.ndarray,
    cues: list[face.Cue],
) -> tuple[Array, Array, str, list[Finding]]:
    """Facing phi (S,) rad in each sensor's world, its sigma (S,), the method in words, findings."""
    S = len(raw.sensors)
    if not cues:
        return np.zeros(S), np.full(S, np.pi), "assumed", [_assumed(None)]
    if raw.common_heading:
        phi, sigma, kept = face.combine(cues)
        method = ", ".join(dict.fromkeys(c.method for c in kept))
        said = [_heading_off(c, off) for c, off in face.heading_off(cues, phi, kept)]
        if face.ambiguous(cues, phi, kept):
            sigma = np.pi
            said.append(_ambiguous(phi, method))
        return np.full(S, phi), np.full(S, sigma), method, said
    relatives = heads.shared_acceleration(raw, joints)
    all_phi, all_sigma = heads.solve(raw.sensors, cues, relatives)
    lost = ~np.isfinite(all_phi)
    said = [_assumed(n) for n, bad in zip(raw.sensors, lost, strict=True) if bad]
    # What no cue reaches takes the facing of the pelvis: right at least if the worlds are one.
    all_phi[lost] = all_phi[~lost][0]
    used = dict.fromkeys(c.method for c in cues)
    if relatives:
        used["shared acceleration of neighbours"] = None
    return all_phi, all_sigma, "own headings: " + ", ".join(used), said


def _ambiguous(phi: float, method: str) -> Finding:
    text = (
        f"the wearer faces {np.degrees(phi):.0f} deg in the sensors' world by the {method}, but it could be "
        f"the opposite way, {np.degrees(face.wrap(phi + np.pi)):.0f} deg: give the facing (--facing)"
    )
    return Finding("warning", None, "facing-ambiguous", text, 180.0)


def _heading_off(cue: face.Cue, off: float) -> Finding:
    text = (
        f"sensor {cue.sensor}: its heading is {np.degrees(off):+.0f} deg from that of the others, by the "
        f"{cue.method}: its world is not theirs"
    )
    return Finding("warning", cue.sensor, "heading-off", text, float(np.degrees(off)))


def _assumed(sensor: str | None) -> Finding:
    if sensor is None:
        text = (
            "where the wearer faces in the pose cannot be told from the data: 0 deg in the sensors' "
            "world is ASSUMED; give the facing, a known axis, a second pose, or record walking"
        )
    else:
        text = (
            f"sensor {sensor}: nothing ties its heading to the others', so its facing is ASSUMED; "
            f"give a known axis of it, a second pose, or record walking and bending"
        )
    return Finding("warning", sensor, "facing-assumed", text, 180.0)


def _cues(
    raw: RawRecording,
    static: Pose,
    window: Window,
    facing: float | None,
    axes: Mapping[str, str] | None,
    second: list[face.Cue],
    arms_hang: bool,
) -> list[face.Cue]:
    """What tells the facing, the declared (`second`: by a second pose) before the measured.

    With a common heading one declared fact is enough and the motion is left out; sensors with headings
    of their own need every cue there is.
    """
    cues: list[face.Cue] = []
    first = face.pelvis_first(raw.sensors)
    if facing is not None:
        cues.append(face.Cue(first, float(np.radians(facing)), np.radians(3.0), "facing as given"))
    if axes:
        cues += face.known_axes(axes, raw, static)
    cues += second
    if not cues and raw.facing_rad is not None:
        cues.append(face.Cue(first, raw.facing_rad, np.radians(5.0), "facing as the file has it"))
    if not cues or not raw.common_heading:
        cues += face.from_motion(raw, static, window, arms_hang)
    return cues


def _second_pose(
    raw: RawRecording,
    static: Pose,
    bones: Array,
    other_bones: Array,
    second: tuple[PoseName, float],
) -> tuple[list[face.Cue], list[Finding]]:
    """Cues from another static pose, and a warning where the wearer was not in it.

    other_bones (S,3,3): of that pose. Raises CalibrationError where its time lies outside the recording.
    """
    name, at = second
    window = find_static(raw, at)
    other = average(raw, window)
    cues = face.second_pose(raw, static, other, bones, other_bones)
    a, b = window.seconds(raw)
    what = f"the second pose ({name.upper()}, {a:.2f} to {b:.2f} s)"
    doubts = []
    if not window.still:
        text = f"{what}: the wearer moves then ({np.degrees(window.rate):.0f} deg/s)"
        doubts.append(Finding("warning", None, "second-pose-not-still", text, window.rate))
    expected = _tilt_deg(bones, other_bones)
    seen = _tilt_deg(static.R_world_sensor, other.R_world_sensor)
    off = np.where(expected > 30, np.abs(seen - expected), 0.0)
    worst = int(off.argmax())
    if not (expected > 30).any():
        text = (
            f"{what} is not used: no bone with a sensor tilts by more than 30 deg between the poses"
        )
        doubts.append(Finding("warning", None, "second-pose", text))
    elif off[worst] > 30 or not cues:
        text = (
            f"{what} {'does not fit' if cues else 'is not used'}: {raw.sensors[worst]} tilts by "
            f"{seen[worst]:.0f} deg between the poses, {expected[worst]:.0f} expected"
        )
        doubts.append(Finding("warning", None, "second-pose", text, float(off[worst])))
    return cues, doubts


def _tilt_deg(R_first: Array, R_second: Array) -> Array:
    """Angle (S,) in deg by which up differs between two rotations (S,3,3) to the world."""
    cos = np.einsum("si,si->s", R_first[:, 1], R_second[:, 1])
    return np.asarray(np.degrees(np.arccos(np.clip(cos, -1, 1))))
