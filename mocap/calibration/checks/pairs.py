"""Are left and right exchanged on a pair that is alone on its limbs? See `mocap.calibration.sides`."""

from __future__ import annotations

from mocap.calibration import limb_levels
from mocap.calibration.evidence import Evidence
from mocap.calibration.sides import EXCHANGED, WEIGHTS, side_score
from mocap.findings import Finding

# By how much lower the score must be where another level of the limb has the same sides: only the whole limb
# can be exchanged then, which is a rarer mistake than a person who moves like the other side.
WHOLE_LIMB = 0.5
OWN_HEADINGS = 0.5  # the same of shanks each in a world of its own: a right pair showed -1.07


def check(evidence: Evidence) -> list[Finding]:
    """Warnings about shanks and (after an N-pose) forearms whose sides are exchanged.

    In a suit, where another level of the limb has the same sides, it takes `WHOLE_LIMB` more.
    """
    raw, pose, found = evidence.raw, evidence.pose, []
    if evidence.seat_possible:
        return []
    for kind in WEIGHTS if pose.name == "n" else ("shank",):
        sides = [f"left_{kind}", f"right_{kind}"]
        if not {"pelvis", *sides} <= set(evidence.judged):
            continue
        score = side_score(raw, pose.static, pose.facing, pose.sigma, kind)
        limit, whole = EXCHANGED, False
        if kind == "shank" and not raw.common_heading:
            limit -= OWN_HEADINGS
        if score < limit and limb_levels.agrees(raw, evidence.joints, kind):
            limit -= WHOLE_LIMB
            whole = True
        if score < limit:
            details = {"by": "pelvis", "options": [sides], "score": score, "whole_limb": whole}
            found += [Finding("warning", n, "swapped", score, details) for n in sides]
    return found
