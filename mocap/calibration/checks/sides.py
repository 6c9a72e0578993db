"""Do the arms go to the side that they are named after?"""

from __future__ import annotations

import numpy as np

from mocap.calibration import facing as face
from mocap.calibration import limb_levels
from mocap.calibration.evidence import Evidence
from mocap.calibration.sides import EXCHANGED, side_score
from mocap.calibration.static_pose import StaticPose
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording

SIDES_DEG = 25.0  # with a facing less certain than that, left is not known well enough
RAISED = 0.5  # horizontal part of up in an arm's frame, of 1, from which it is raised sideways
RAISED_S = 2.0  # time for which both arms must have been raised, to tell a side
UNANIMOUS = 0.9  # share of that time, as a difference of the two sides, that must say the same
LOWERED = 0.15  # part of up along left, median, from which an arm counts as lowered from the T-pose


def check(evidence: Evidence) -> list[Finding]:
    """Do the arms rise (from the N-pose) or drop (from the T-pose) on the side they are named after?

    Up in the frame carried to the pose: a left arm raised sideways from the N-pose carries it to the
    left, one lowered from the T-pose to the right. Where the facing is less certain than SIDES_DEG, left
    is not known well enough; arms that lie on the thighs in the pose seem to go to the wrong side.

    In the N-pose only the upper arms tell, because forearms cross the chest; and not for certain, because an
    arm raised forward and turned outward carries up to the other side, and some dance like that. So both
    arms must have been raised sideways for RAISED_S, nearly always to the wrong side; headings must be
    common, as an own one is told by the arm's swing and may be the opposite; and where forearms are worn
    with their sides on the same limbs, their habits must say the same.
    """
    raw, held = evidence.raw, evidence.pose
    name, pose, facing = held.name, held.static, held.facing
    if evidence.seat_possible or not (held.sigma < np.radians(SIDES_DEG)).all():
        return []
    kinds = ("upper_arm",) if name == "n" else ("upper_arm", "forearm", "wrist")
    if name == "n" and not raw.common_heading:
        return []
    found = []
    for kind in kinds:
        sides = [f"left_{kind}", f"right_{kind}"]
        if not all(n in raw.sensors for n in sides):
            continue
        values = [_goes_left(raw, pose, facing, n, name) for n in sides]
        if values[0] < 0 < values[1] and not (name == "n" and _forearms_fit(evidence)):
            details = {"by": "rise", "options": [sides]}
            found += [Finding("warning", n, "swapped", values[0], details) for n in sides]
    return found


def _goes_left(raw: RawRecording, pose: StaticPose, facing: Array, sensor: str, name: str) -> float:
    """How clearly an arm rises or drops to the left: -1 to 1, 0 where it is not clear."""
    s = raw.sensors.index(sensor)
    _, up, _ = face.carried(raw, pose, s)
    h = face.complex_heading(up) * np.exp(-1j * facing[s])
    if name == "t":
        lowered = -float(np.median(h.imag))
        return lowered if abs(lowered) > LOWERED else 0.0
    raised = h.imag[(np.abs(h.imag) > RAISED) & (np.abs(h.imag) > np.abs(h.real))]
    if len(raised) < RAISED_S * raw.rate_hz:
        return 0.0
    share = float(np.sign(raised).mean())
    return share if abs(share) > UNANIMOUS else 0.0


def _forearms_fit(evidence: Evidence) -> bool:
    """Are there forearms on the same limbs as the upper arms, that turn as those of these sides do?"""
    raw, pose = evidence.raw, evidence.pose
    if not {"pelvis", "left_forearm", "right_forearm"} <= set(raw.sensors):
        return False
    same = limb_levels.agrees(raw, evidence.joints, "upper_arm")
    unknown = np.full(len(raw.sensors), np.pi)
    score = side_score(raw, pose.static, pose.facing, unknown, "forearm")
    return same and score > 0.5 * EXCHANGED
