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

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from mocap import checked
from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import checks, fusion, pose_facing
from mocap.calibration.blind import at_rest, blind, told
from mocap.calibration.evidence import Evidence, HeldPose, gather
from mocap.calibration.pose_facing import OtherPose, PoseName
from mocap.calibration.record import Calibration, OrientationSource, turned
from mocap.calibration.static_pose import StaticPose, StillWindow, average, find_static
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording
from mocap.stances import ARM_ANGLE_DEG, pose_bones
from mocap.words import summary

OrientationChoice = Literal["auto", "file", "vqf"]


def calibrate(
    raw: RawRecording,
    pose: PoseName = "n",
    at: float | None = None,
    arm_angle_deg: float = ARM_ANGLE_DEG,
    facing: float | None = None,
    axes: Mapping[str, str] | None = None,
    second: tuple[PoseName, float] | None = None,
    orientation: OrientationChoice = "auto",
    scale_acc: bool = True,
    strict: bool = True,
) -> tuple[Recording, Calibration]:
    """Calibrate `raw` from a static pose.

    pose: "n" (arms down) or "t". at: its time in s on the recording's clock, else it is found. facing:
    heading of the wearer's forward in the sensors' world in deg (0: our +z, 90: +x), where known. axes:
    known mountings, {"pelvis": "x forward"}. second: another static pose and its time, ("t", 12.5).
    Without these three: the file's own `facing_rad`, else the motion, else 0 is assumed and a warning
    says so. Sensors that have orientations and no acceleration are calibrated by these, with a warning.
    orientation: "file" (R_world_sensor of `raw`), "vqf" (from gyr, acc and mag), "auto" (the
    file's if it has one). scale_acc: scale each accelerometer to read g in the pose (by 5 % at most, and
    only in a pose that is still). strict: raise CalibrationError at a finding of severity "error"; with False
    the result comes anyway, and the findings are in its `diagnostics`. A wearer who moves at a time that was
    given is an error above `NEVER_STILL` rad/s, below it a warning.
    """
    _allowed(raw, orientation, at=at, facing=facing, arm_angle_deg=arm_angle_deg)
    joints, _ = places.joints_and_seats(raw.sensors)
    bones = pose_bones(joints, pose, arm_angle_deg)
    other = OtherPose(*second, pose_bones(joints, second[0], arm_angle_deg)) if second else None

    # Gather.
    source: OrientationSource = (
        "vqf" if raw.R_world_sensor is None or orientation == "vqf" else "file"
    )
    seen = raw if source == "file" else replace(raw, R_world_sensor=None)
    sensed = gather(at_rest(seen))
    findings = _refused_if(strict, checks.run(sensed, "sensors")) + told(seen)
    window = find_static(sensed.raw, at)
    fused = sensed.raw if source == "file" else fusion.with_orientation(sensed.raw)
    static = average(fused, window)

    # Decide.
    faced = pose_facing.find(fused, static, window, bones, pose == "n", facing, axes, other)
    held = HeldPose(window, static, pose, arm_angle_deg, faced.phi, faced.sigma)

    # Check.
    findings += _rival(raw, window) + faced.findings
    findings += checks.run(Evidence(fused, (), held, raw.sensors), "body", "pose")
    findings = checks.settled(_refused_if(strict, findings))

    # Apply.
    scale = scale_acc and window.still
    result = _calibration(raw, bones, held, faced.method, source, findings, scale)
    silent = np.broadcast_to(blind(seen)[:, None], fused.acc.shape)
    measured = replace(fused, acc=np.where(silent, np.nan, fused.acc))
    return turned(measured, result), result


def _allowed(raw: RawRecording, orientation: OrientationChoice, **numbers: float | None) -> None:
    checked.instance(raw, RawRecording, "calibrate: raw", CalibrationError)
    for name, value in numbers.items():
        if value is not None:
            checked.number(value, f"calibrate: {name}", error=CalibrationError)
    if orientation == "file" and raw.R_world_sensor is None:
        raise CalibrationError("the recording carries no orientation: use orientation='vqf'")


def _refused_if(strict: bool, findings: list[Finding]) -> list[Finding]:
    """The findings; raises CalibrationError where one is an error, and `strict`."""
    if strict and checks.failed(findings):
        raise CalibrationError(summary(checks.settled(findings)))
    return findings


def _calibration(
    raw: RawRecording,
    bones: Array,
    held: HeldPose,
    method: str,
    source: OrientationSource,
    findings: list[Finding],
    scale: bool,
) -> Calibration:
    """R_bone_sensor = R_world_bone(pose)^T R_y(-phi) R_world_sensor(pose)."""
    static = held.static
    return Calibration(
        raw.sensors,
        np.swapaxes(bones, -1, -2) @ ori.rot_y(-held.facing) @ static.R_world_sensor,
        -held.facing,
        held.sigma,
        held.name,
        held.arm_angle_deg,
        held.window.seconds(raw),
        method,
        source,
        tuple(findings),
        _scale(static) if scale else np.ones(len(raw.sensors)),
    )


def diagnose(raw: RawRecording, calibration: Calibration | None = None) -> list[Finding]:
    """Everything that can be said of `raw`, errors first.

    Without a calibration: units, axes, gaps, exchanged sides and lags, which need no pose. With one:
    also movement in the pose, slipped sensors, leaning, sides of the arms, certainty of the heading.
    """
    if calibration is not None:
        raw = raw.select(calibration.sensors)
    sensed = gather(at_rest(raw))
    found = checks.run(sensed, "sensors") + told(raw)
    if checks.failed(found):
        return checks.settled(found)
    if calibration is None:
        return checks.settled(found + checks.run(sensed, "body"))
    fused = sensed.raw
    if calibration.orientation == "vqf" or fused.R_world_sensor is None:
        fused = fusion.with_orientation(fused)
    start, stop = (round((t - raw.start_s) * raw.rate_hz) for t in calibration.time)
    window = StillWindow(start, stop, 0.0, True, False)
    held = HeldPose(
        window, average(fused, window), calibration.pose, calibration.arm_angle_deg,
        -calibration.heading, calibration.heading_sigma,
    )  # fmt: skip
    found += checks.run(Evidence(fused, (), held, raw.sensors), "body", "pose")
    return checks.settled(found)


def _rival(raw: RawRecording, window: StillWindow) -> list[Finding]:
    """A warning where another window would have been about as good."""
    if window.rival is None:
        return []
    start, end = window.seconds(raw)
    rival = [raw.start_s + k / raw.rate_hz for k in window.rival]
    details = {
        "start_s": start,
        "end_s": end,
        "rival_start_s": rival[0],
        "rival_end_s": rival[1],
    }
    return [Finding("warning", None, "pose-ambiguous", None, details)]


def _scale(static: StaticPose) -> Array:
    """g / |acc(pose)| (S,); one where it would change more than 5 %, which is another fault."""
    scale = ori.GRAVITY / np.maximum(np.linalg.norm(static.acc, axis=1), 1e-9)
    return np.where(np.abs(scale - 1) < 0.05, scale, 1.0)
