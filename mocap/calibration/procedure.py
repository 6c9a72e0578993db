"""From raw sensors to a recording: static pose, heading, sensor-to-bone rotation, gravity.

    R_world_bone(t) = R_y(heading_s) R_world_sensor(t) R_bone_sensor^T
    R_bone_sensor   = R_world_bone(pose)^T R_y(heading_s) R_world_sensor(pose)
    acc_world       = k_s R_y(heading_s) R_world_sensor acc - g e_y,    k_s = g / |acc(pose)|

In the T-pose every bone is the identity; in the N-pose the left arm's joints 16, 18, 20, 22 are at
R_z(-a), the right arm's 17, 19, 21, 23 at R_z(+a). The wearer faces +z in the pose, so heading_s is
minus the heading of the wearer's forward in the world of sensor s. It is not a free choice of the
world's yaw: see `mocap.calibration.facing` for what a wrong one does and what tells the right one.

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

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import diagnostics as checks
from mocap.calibration import fusion, pose_facing
from mocap.calibration.checks.channels import without_spikes
from mocap.calibration.pose_facing import OtherPose, PoseName
from mocap.calibration.static_pose import Pose, Window, average, find_static
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording
from mocap.stances import ARM_ANGLE_DEG, pose_bones

SCHEMA = "poser-calibration/1"
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
        raw, _ = without_spikes(raw.select(self.sensors))
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
    raw, findings = without_spikes(raw)
    findings += checks.check_before(raw if source == "file" else replace(raw, R_world_sensor=None))
    if strict and any(f.severity == "error" for f in findings):
        raise CalibrationError(checks.summary(findings))
    window = find_static(raw, at)
    if window.rival:
        findings.append(_rival(raw, window))
    fused = raw if source == "file" else fusion.with_orientation(raw)
    static = average(fused, window)
    other = None
    if second:
        other = OtherPose(*second, pose_bones(joints, second[0], arm_angle_deg))
    faced = pose_facing.find(fused, static, window, bones, pose == "n", facing, axes, other)
    findings += faced.findings
    findings += checks.check_result(
        fused, window, static, faced.phi, faced.sigma, pose, arm_angle_deg
    )
    if strict and any(f.severity == "error" for f in findings):
        raise CalibrationError(checks.summary(findings))
    R_bone_sensor = np.swapaxes(bones, -1, -2) @ ori.rot_y(-faced.phi) @ static.R_world_sensor
    result = Calibration(
        raw.sensors,
        R_bone_sensor,
        -faced.phi,
        faced.sigma,
        pose,
        arm_angle_deg,
        window.seconds(raw),
        faced.method,
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
