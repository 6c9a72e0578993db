"""Did a sensor slip on its bone after the pose?

A sensor that turned about the vertical does not show, nor one that slipped with no still, upright moment
afterwards.
"""

from __future__ import annotations

import numpy as np

from mocap.calibration import facing as face
from mocap.calibration.evidence import Evidence
from mocap.calibration.static_pose import tilt_from_pose
from mocap.findings import Finding
from mocap.orientation import Array

SLIPPED_DEG, REST_DEG = 12.0, 6.0  # tilt of one sensor since the pose; of the others meanwhile
REST_FRAMES = 5  # of a still stance: the mean of fewer wobbles
# Segments that people hold differently each time they stand still.
LOOSE_DEG = {
    "head": 30.0,
    "shoulder_blade": 35.0,
    "hand": 30.0,
    "forearm": 25.0,
    "wrist": 25.0,
    "upper_arm": 18.0,
}
POSTURE_DEG = 45.0  # no strap lets a sensor tilt by more: the limb is held differently
ARM_KINDS = ("upper_arm", "forearm", "wrist", "hand")


def check(evidence: Evidence) -> list[Finding]:
    """Is one sensor tilted in a later still stance in which the rest of the body is as in the pose?

    A still run counts if the median tilt over the sensors is below REST_DEG. A limb may be held
    differently on purpose, so a sensor is named only if it is off in most of the runs from the first
    in which it is off, and by more the more freely its segment moves. Beyond POSTURE_DEG it is no slip.
    Arms that were held out in the pose (a T-pose) are judged only where other arms are out again.
    """
    raw, pose = evidence.raw, evidence.pose
    later = [(a, b) for a, b in evidence.still if a >= pose.window.stop and b - a >= REST_FRAMES]
    tilts = [tilt_from_pose(raw, a, b, pose.static) for a, b in later]
    rows = [
        (run, t)
        for run, t in zip(later, tilts, strict=True)
        if np.isfinite(t).sum() >= 3 and np.nanmedian(t) < REST_DEG
    ]
    found = []
    arms = [s for s, sensor in enumerate(raw.sensors) if face.kind(sensor) in ARM_KINDS]
    for s, sensor in enumerate(raw.sensors):
        limit = LOOSE_DEG.get(face.kind(sensor), SLIPPED_DEG)
        judged = [(run, t) for run, t in rows if t[s] < POSTURE_DEG]
        if pose.name == "t" and s in arms:
            others = [a for a in arms if a != s]
            judged = [(run, t) for run, t in judged if _as_in_pose(t[others])]
        off = [k for k, (_, t) in enumerate(judged) if t[s] > limit]
        if not off or len(off) <= 0.5 * (len(judged) - off[0]):
            continue
        (first, _), tilts_then = judged[off[0]]
        since = raw.start_s + first / raw.rate_hz
        tilt = float(np.median([judged[k][1][s] for k in off]))
        details = {
            "tilt_deg": tilt,
            "since_s": since,
            "others_deg": float(np.nanmedian(tilts_then)),
        }
        found.append(Finding("warning", sensor, "slipped", tilt, details))
    return found


def _as_in_pose(tilts: Array) -> bool:
    """Is half of these tilts (deg) below REST_DEG? Those that are NaN do not count."""
    known = tilts[np.isfinite(tilts)]
    return len(known) > 0 and float(np.median(known)) < REST_DEG
