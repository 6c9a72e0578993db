"""Did the trunk lean in the pose?"""

from __future__ import annotations

import numpy as np

from mocap.calibration import facing as face
from mocap.calibration.evidence import Evidence
from mocap.findings import Finding

LEANING_DEG = 25.0
TRUNK = ("pelvis", "lower_back", "upper_back", "sternum")


def check(evidence: Evidence) -> list[Finding]:
    """Is the trunk in the pose far from how it is held during the rest of the recording?"""
    raw, window, found = evidence.raw, evidence.pose.window, []
    for s, name in enumerate(raw.sensors):
        if name not in TRUNK:
            continue
        _, up, frames = face.carried(raw, evidence.pose.static, s)
        up = up[(frames < window.start) | (frames >= window.stop)]
        if len(up) < 5 * raw.rate_hz:
            continue
        mean = np.median(up, axis=0)
        tilt = float(np.degrees(np.arctan2(np.hypot(mean[0], mean[2]), mean[1])))
        if tilt > LEANING_DEG:
            found.append(Finding("warning", name, "pose-leaning", tilt, {"tilt_deg": tilt}))
    return found
