"""Did the wearer stand in the static pose, or sit?

Nobody knows how a sensor sits on its bone, so a seat looks like an N-pose in itself. What tells it
is the motion: with v = C_s R_ws^T e_y, up in the sensor's frame carried to the pose (`facing`), a thigh
that was horizontal in the pose carries up by 60 deg and more whenever the legs are in use. A wearer who
stood, and then squats or dances low, does the same; but there the thigh goes forward and the shank back,
which carries up in opposite directions. After a seat both carry it the same way: a knee that bends forward.

Without thighs a seat leaves only the pelvis, which tips backward by some 20 deg, as much as dancers lean
forward. That is said only where the wearer stands as still at another time with the pelvis as in motion.

Not seen: a seat with neither pelvis nor thighs worn, after which the legs hardly move, or with shanks drawn
far back under the seat; six sensors without another stance; arms that hung in a different way.
"""

from __future__ import annotations

import numpy as np

from mocap.calibration.evidence import Evidence
from mocap.calibration.posture import (
    SEAT_PELVIS_DEG,
    along,
    legs_in_use,
    pair,
    stance,
    tilt,
    ups,
)
from mocap.findings import Finding

SEAT_DEG = 40.0  # tilt of both thighs since the pose: more than most people's mean in a motion
TOGETHER = 0.1  # up of the shank along that of the thigh, horizontally; right people: -0.04 at most
STANCE_PELVIS_DEG = 10.0  # tilt of a pelvis that stands


def check(evidence: Evidence) -> list[Finding]:
    """A warning where both thighs, or the pelvis alone, were not where motion has them."""
    raw, held = evidence.raw, evidence.pose
    window, pose, facing = held.window, held.static, held.facing
    using = legs_in_use(raw, window)
    if using is None:
        return []
    means = ups(raw, pose, using)
    thighs = pair(raw, "thigh") or pair(raw, "pocket")
    least, low = SEAT_PELVIS_DEG, STANCE_PELVIS_DEG
    if thighs:
        judged, least, low = thighs, SEAT_DEG, 0.5 * SEAT_DEG
    elif "pelvis" in raw.sensors:
        judged = [raw.sensors.index("pelvis")]
    else:
        return []
    tilt_deg = float(np.nan_to_num(tilt(means[judged])).min())
    if tilt_deg < least:
        return []
    shanks = pair(raw, "shank")
    stance_s = stance(evidence.still, raw, window, pose, means, judged, low)
    bends = False
    if thighs and shanks and raw.common_heading:
        bent = [along(means[[t, s]], facing[[t, s]]) for t, s in zip(thighs, shanks, strict=True)]
        if min(bent) < TOGETHER:
            return []
        bends = True
    elif stance_s is None:
        return []
    a, b = window.seconds(raw)
    details = {
        "start_s": a,
        "end_s": b,
        "of": "thighs" if thighs else "pelvis",
        "tilt_deg": tilt_deg,
        "knees_forward": bends,
        "stance_s": stance_s,
    }
    return [Finding("warning", None, "pose-posture", tilt_deg, details)]
