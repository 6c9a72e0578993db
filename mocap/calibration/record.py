"""What a calibration is: how each sensor sits on its bone, how its world lies, how sure both are.

R_world_bone(t) = R_y(heading_s) R_world_sensor(t) R_bone_sensor^T
acc_world       = k_s R_y(heading_s) R_world_sensor acc - g e_y
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mocap import orientation as ori
from mocap.calibration import fusion
from mocap.calibration.spikes import without_spikes
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording
from mocap.words import sentence

SCHEMA = "poser-calibration/1"
OrientationSource = Literal["file", "vqf"]


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
            "diagnostics": [f.to_dict() | {"sentence": sentence(f)} for f in self.diagnostics],
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
                tuple(map(_finding, data["diagnostics"])),
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
        return turned(raw, self)


def turned(raw: RawRecording, calibration: Calibration) -> Recording:
    """The recording of `raw`, whose sensors are the calibration's and have the orientation it goes by."""
    assert raw.R_world_sensor is not None
    R_turned = ori.rot_y(calibration.heading) @ raw.R_world_sensor
    acc = np.einsum("tsij,tsj->tsi", R_turned, raw.acc * calibration.acc_scale[:, None])
    acc[..., 1] -= ori.GRAVITY
    return Recording(
        raw.rate_hz,
        calibration.sensors,
        R_turned @ np.swapaxes(calibration.R_bone_sensor, -1, -2),
        acc,
        valid=raw.valid & np.isfinite(raw.R_world_sensor).all((-1, -2)),
        reference=_turned_reference(raw, calibration.time),
        calibration=calibration.to_dict(),
        start_s=raw.start_s,
    )


def _turned_reference(raw: RawRecording, pose_s: tuple[float, float]) -> Motion | None:
    """The reference facing +z in the pose; None where the pose lies outside the recording."""
    start, stop = (round((t - raw.start_s) * raw.rate_hz) for t in pose_s)
    if raw.reference is None or start < 0 or stop > len(raw):
        return None
    pelvis = raw.reference.R_world_joint[start:stop, 0]
    return raw.reference.turned(-float(ori.heading(ori.mean(pelvis))))


def _finding(data: dict[str, Any]) -> Finding:
    """Inverse of `Finding.to_dict`. Files of before there were details hold the sentence alone."""
    details = data.get("details") or {"said": str(data["sentence"])}
    value = data["value"]
    return Finding(data["severity"], data["sensor"], str(data["code"]), value, details)
