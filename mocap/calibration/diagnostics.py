"""What a calibration found doubtful, in records a person can act on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import facing as face
from mocap.calibration import fusion, limb_levels
from mocap.calibration.checks import arms as arm_checks
from mocap.calibration.checks import body as body_checks
from mocap.calibration.checks import poses as pose_checks
from mocap.calibration.checks import sides as side_checks
from mocap.calibration.checks import single as sensor_checks
from mocap.calibration.checks.channels import without_spikes
from mocap.calibration.static_pose import Pose, Window, average
from mocap.findings import Finding, Severity
from mocap.recording import RawRecording, gaps

if TYPE_CHECKING:
    from mocap.calibration.procedure import Calibration

__all__ = ["Finding", "Severity", "check_before", "check_result", "diagnose", "ordered", "summary"]

UNCERTAIN_DEG = 15.0
SIDES_DEG = 25.0  # with a facing less certain than that, left is not known well enough
POSTURE = {"pose-posture", "pose-leaning"}  # codes of a pose in which nobody stood upright
ORDER = {"error": 0, "warning": 1, "info": 2}


def diagnose(raw: RawRecording, calibration: Calibration | None = None) -> list[Finding]:
    """Everything that can be said of `raw`, errors first.

    Without a calibration: units, axes, gaps, exchanged sides and lags, which need no pose. With one:
    also movement in the pose, slipped sensors, leaning, sides of the arms, certainty of the heading.
    """
    if calibration is not None:
        raw = raw.select(calibration.sensors)
    raw, found = without_spikes(raw)
    found += check_before(raw)
    if calibration is None:
        if not any(f.severity == "error" for f in found):
            joints, _ = places.joints_and_seats(raw.sensors)
            R = raw.R_world_sensor if raw.common_heading else None
            found += limb_levels.check_swapped(raw, joints, R)
        return ordered(found)
    if not any(f.severity == "error" for f in found):
        fused = raw
        if calibration.orientation == "vqf" or raw.R_world_sensor is None:
            fused = fusion.with_orientation(raw)
        start, stop = (round((t - raw.start_s) * raw.rate_hz) for t in calibration.time)
        window = Window(start, stop, 0.0, True, False)
        found += check_result(
            fused, window, average(fused, window), -calibration.heading, calibration.heading_sigma,
            calibration.pose, calibration.arm_angle_deg,
        )  # fmt: skip
    return ordered(found)


def check_before(raw: RawRecording) -> list[Finding]:
    """The checks that need neither orientation nor pose."""
    joints, _ = places.joints_and_seats(raw.sensors)
    found = sensor_checks.check_sensors(raw) + _gaps(raw)
    if not any(f.severity == "error" for f in found):
        found += body_checks.check_lags(raw, joints)
    return found


def check_result(
    raw: RawRecording,
    window: Window,
    pose: Pose,
    facing: np.ndarray,
    sigma: np.ndarray,
    name: str,
    arm_angle_deg: float,
) -> list[Finding]:
    """The checks that need the orientation, the pose and the facing (S,) of each sensor's world.

    name, arm_angle_deg: of the pose.
    """
    assert raw.R_world_sensor is not None
    joints, _ = places.joints_and_seats(raw.sensors)
    found = pose_checks.check_pose(raw, window, pose)
    found += limb_levels.check_swapped(raw, joints, ori.rot_y(-facing) @ raw.R_world_sensor)
    found += body_checks.check_slipped(raw, window, pose, name)
    found += body_checks.check_leaning(raw, window, pose)
    found += pose_checks.check_posture(raw, window, pose, facing)
    # Arms that lie on the thighs in the pose seem to go to the wrong side when they hang.
    stood = not POSTURE & {f.code for f in found} and not pose_checks.doubtful(raw, window, pose)
    if stood and (sigma < np.radians(SIDES_DEG)).all():
        found += side_checks.check_sides(raw, pose, facing, name)
    known = {f.sensor for f in found if f.code == "swapped" and f.sensor}
    if stood:
        found += side_checks.check_pairs(raw, pose, facing, sigma, name, known)
    other = arm_checks.check_pose_name(raw, window, pose, facing, sigma, name, arm_angle_deg)
    if other:
        # Arms that start from another pose than said seem to go to the wrong side.
        found = [f for f in found if f.code != "swapped"]
    return found + other + _facing(raw, window, pose, facing, sigma, name)


def _facing(
    raw: RawRecording,
    window: Window,
    pose: Pose,
    facing: np.ndarray,
    sigma: np.ndarray,
    name: str,
) -> list[Finding]:
    """Is the facing certain, and does the motion agree with it?"""
    found = []
    if raw.common_heading:
        if UNCERTAIN_DEG < np.degrees(sigma[0]) < 180:
            text = f"where the wearer faces is known to {np.degrees(sigma[0]):.0f} deg only"
            found.append(
                Finding("warning", None, "facing-uncertain", text, float(np.degrees(sigma[0])))
            )
        cues = face.from_motion(raw, pose, window, name == "n")
        if cues and sigma[0] < np.pi:
            seen, spread, kept = face.combine(cues)
            off = float(np.degrees(face.wrap(seen - facing[0])))
            if abs(off) > 30 + 2 * np.degrees(spread) and len(kept) > 0.6 * len(cues):
                text = (
                    f"the motion of legs and trunk says the wearer faced {off:+.0f} deg from where the "
                    f"calibration has it"
                )
                found.append(Finding("warning", None, "facing-disagrees", text, off))
        return found
    for s, sensor in enumerate(raw.sensors):
        degrees = float(np.degrees(sigma[s]))
        if UNCERTAIN_DEG < degrees < 180:
            text = f"sensor {sensor}: its heading is known to {degrees:.0f} deg only"
            found.append(Finding("warning", sensor, "facing-uncertain", text, degrees))
    return found


def _gaps(raw: RawRecording) -> list[Finding]:
    """Much lost, or lost for long."""
    found = []
    longest: dict[int, int] = {}
    for gap in gaps(raw.valid):
        longest[gap["sensor"]] = max(longest.get(gap["sensor"], 0), gap["frames"])
    for s, frames in longest.items():
        share, seconds = float(1 - raw.valid[:, s].mean()), frames / raw.rate_hz
        if share > 0.1 or seconds > 1.0:
            text = (
                f"sensor {raw.sensors[s]}: {share:.0%} of its samples are missing, the longest gap is "
                f"{seconds:.1f} s: its heading may differ behind a gap"
            )
            found.append(Finding("warning", raw.sensors[s], "gaps", text, share))
    return found


def summary(findings: list[Finding]) -> str:
    """One line: the findings of the worst severity, sensors with the same code named together."""
    if not findings:
        return "nothing doubtful"
    worst = min(findings, key=lambda f: ORDER[f.severity]).severity
    codes: dict[str, list[Finding]] = {}
    for f in findings:
        if f.severity == worst:
            codes.setdefault(f.code, []).append(f)
    parts = []
    for group in codes.values():
        text = group[0].sentence
        if len(group) > 1 and text.startswith("sensor "):
            names = ", ".join(f.sensor or "" for f in group)
            text = f"sensors {names}: {text.split(': ', 1)[1]}"
        parts.append(text)
    return "; ".join(dict.fromkeys(parts))


def ordered(findings: list[Finding]) -> list[Finding]:
    """Errors first, and of several findings with one sensor and code the first only.

    A sensor on the wrong side is out of step with its supposed neighbours, but its clock is not; the heading
    cue of a sensor that slipped is wrong since then.
    """
    swapped, slipped = (
        {f.sensor for f in findings if f.code == code} for code in ("swapped", "slipped")
    )
    findings = [f for f in findings if not (f.code == "lag" and f.sensor in swapped)]
    findings = [f for f in findings if not (f.code == "heading-off" and f.sensor in slipped)]
    once: dict[tuple[str | None, str], Finding] = {}
    for f in findings:
        once.setdefault((f.sensor, f.code), f)
    return sorted(once.values(), key=lambda f: ORDER[f.severity])
