"""Is the facing certain, and does the motion agree with it?"""

from __future__ import annotations

import numpy as np

from mocap.calibration import facing as face
from mocap.calibration.evidence import Evidence
from mocap.findings import Finding

UNCERTAIN_DEG = 15.0
ASSUMED_DEG = 180.0  # sigma of a facing that was assumed, or could be the opposite: said already
DISAGREES_DEG = 30.0  # more than twice the uncertainty of what the motion says
MOST = 0.6  # of the cues must agree with each other


def check(evidence: Evidence) -> list[Finding]:
    """A warning where the facing, or the heading of a sensor of its own, is not known well; and where legs
    and trunk say another one.
    """
    sigma = np.degrees(evidence.pose.sigma)
    if evidence.raw.common_heading:
        return _uncertain(None, float(sigma[0])) + _disagrees(evidence)
    return [f for s, n in enumerate(evidence.raw.sensors) for f in _uncertain(n, float(sigma[s]))]


def _uncertain(sensor: str | None, degrees: float) -> list[Finding]:
    if not UNCERTAIN_DEG < degrees < ASSUMED_DEG:
        return []
    return [Finding("warning", sensor, "facing-uncertain", degrees, {"sigma_deg": degrees})]


def _disagrees(evidence: Evidence) -> list[Finding]:
    pose = evidence.pose
    if not pose.sigma[0] < np.pi:
        return []
    cues = face.from_motion(evidence.raw, pose.static, pose.window, pose.name == "n")
    if not cues:
        return []
    seen, spread, kept = face.combine(cues)
    off = float(np.degrees(face.wrap(seen - pose.facing[0])))
    if abs(off) > DISAGREES_DEG + 2 * np.degrees(spread) and len(kept) > MOST * len(cues):
        return [Finding("warning", None, "facing-disagrees", off, {"off_deg": off})]
    return []
