"""Where the wearer faces in the static pose: what is declared, and what motion tells.

The heading phi_s of the wearer's forward in the world of sensor s, from the cues of `facing` (known
mountings, a second pose, legs and trunk in motion), all sensors together where they share a world, else each
one, tied by `mocap.calibration.headings`. Everything doubtful about it becomes a finding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mocap import sensors as places
from mocap.calibration import facing as face
from mocap.calibration import headings as heads
from mocap.calibration.static_pose import StaticPose, StillWindow, average, find_static
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording

PoseName = Literal["n", "t"]
TELLING_DEG = 30.0  # a bone that tilts by less between two poses tells no facing, nor a misfit
FACING_SIGMA, FILE_SIGMA = np.radians(3.0), np.radians(5.0)  # as given; as the file has it


@dataclass(frozen=True, eq=False)
class OtherPose:
    """A second static pose: its name, its time in s, R_world_bone (S,3,3) of the bones in it."""

    name: PoseName
    at: float
    bones: Array


@dataclass(frozen=True, eq=False)
class PoseFacing:
    """phi (S,) rad: the wearer's forward in each sensor's world, sigma (S,) its 1-sigma, pi where assumed;
    method in words; what is doubtful.
    """

    phi: Array
    sigma: Array
    method: str
    findings: list[Finding]


def find(
    raw: RawRecording,
    static: StaticPose,
    window: StillWindow,
    bones: Array,
    arms_hang: bool,
    facing: float | None = None,
    axes: Mapping[str, str] | None = None,
    second: OtherPose | None = None,
) -> PoseFacing:
    """The facing in the pose `static`, `window`, in which bones have R_world_bone `bones` (S,3,3).

    arms_hang: whether the arms hang in it. facing (deg), axes, second: see `mocap.calibration.procedure`.
    Raises CalibrationError where the second pose lies outside the recording or an axis is unknown.
    """
    told, doubts = _second_pose(raw, static, bones, second) if second else ([], [])
    cues = _cues(raw, static, window, facing, axes, told, arms_hang)
    phi, sigma, method, said = _headings(raw, cues)
    if told and "second pose" not in method:
        details = {"method": method}
        said.append(Finding("warning", None, "second-pose-disagrees", None, details))
    return PoseFacing(phi, sigma, method, doubts + said)


def _cues(
    raw: RawRecording,
    static: StaticPose,
    window: StillWindow,
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
        cues.append(face.Cue(first, float(np.radians(facing)), FACING_SIGMA, "facing as given"))
    if axes:
        cues += face.known_axes(axes, raw, static)
    cues += second
    if not cues and raw.facing_rad is not None:
        cues.append(face.Cue(first, raw.facing_rad, FILE_SIGMA, "facing as the file has it"))
    if not cues or not raw.common_heading:
        cues += face.from_motion(raw, static, window, arms_hang)
    return cues


def _second_pose(
    raw: RawRecording, static: StaticPose, bones: Array, second: OtherPose
) -> tuple[list[face.Cue], list[Finding]]:
    """Cues from another static pose, and a warning where the wearer was not in it."""
    window = find_static(raw, second.at)
    other = average(raw, window)
    cues = face.second_pose(raw, static, other, bones, second.bones)
    a, b = window.seconds(raw)
    pose: dict[str, Any] = {"pose": second.name, "start_s": a, "end_s": b}
    doubts = []
    if not window.still:
        details = {**pose, "rate_deg_s": float(np.degrees(window.rate))}
        doubts.append(Finding("warning", None, "second-pose-not-still", window.rate, details))
    expected = _tilt_deg(bones, second.bones)
    seen = _tilt_deg(static.R_world_sensor, other.R_world_sensor)
    off = np.where(expected > TELLING_DEG, np.abs(seen - expected), 0.0)
    worst = int(off.argmax())
    if not (expected > TELLING_DEG).any():
        details = {**pose, "least_deg": TELLING_DEG}
        doubts.append(Finding("warning", None, "second-pose", None, details))
    elif off[worst] > TELLING_DEG or not cues:
        details = {
            **pose,
            "tilts": raw.sensors[worst],
            "seen_deg": float(seen[worst]),
            "expected_deg": float(expected[worst]),
            "used": bool(cues),
        }
        doubts.append(Finding("warning", None, "second-pose", float(off[worst]), details))
    return cues, doubts


def _tilt_deg(R_first: Array, R_second: Array) -> Array:
    """Angle (S,) in deg by which up differs between two rotations (S,3,3) to the world."""
    cos = np.einsum("si,si->s", R_first[:, 1], R_second[:, 1])
    return np.asarray(np.degrees(np.arccos(np.clip(cos, -1, 1))))


def _headings(raw: RawRecording, cues: list[face.Cue]) -> tuple[Array, Array, str, list[Finding]]:
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
    joints, _ = places.joints_and_seats(raw.sensors)
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
    details = {
        "facing_deg": float(np.degrees(phi)),
        "opposite_deg": float(np.degrees(face.wrap(phi + np.pi))),
        "method": method,
    }
    return Finding("warning", None, "facing-ambiguous", 180.0, details)


def _heading_off(cue: face.Cue, off: float) -> Finding:
    degrees = float(np.degrees(off))
    details = {"off_deg": degrees, "method": cue.method}
    return Finding("warning", cue.sensor, "heading-off", degrees, details)


def _assumed(sensor: str | None) -> Finding:
    return Finding("warning", sensor, "facing-assumed", 180.0)
