"""What the sensors betray together after the pose: slipped sensors, a trunk that leant, lags.

What cannot be seen, said plainly: a mirror image of the whole body is a possible body, so left and right
exchanged on every limb at once show only where the arms leave a T-pose or the upper arms are raised, and
by how people move (`checks.sides`); a sensor that turned about the vertical does not show, nor one
that slipped with no still, upright moment afterwards, nor a late clock in nothing but a gait.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mocap.calibration import facing as face
from mocap.calibration import headings as heads
from mocap.calibration.limb_levels import activity
from mocap.calibration.static_pose import Pose, Window, tilt_from_pose
from mocap.calibration.stillness import still_runs
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording

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
LEANING_DEG = 25.0
LAG_S = 0.1
LAG_GAIN = 0.1  # by which a lag must correlate better than none
LIVELY = 0.5  # standard deviation of the activity from which its course tells a lag
TRUNK = ("pelvis", "lower_back", "upper_back", "sternum")


def check_slipped(raw: RawRecording, window: Window, pose: Pose, name: str) -> list[Finding]:
    """Is one sensor tilted in a later still stance in which the rest of the body is as in the pose?

    A still run counts if the median tilt over the sensors is below REST_DEG. A limb may be held
    differently on purpose, so a sensor is named only if it is off in most of the runs from the first
    in which it is off, and by more the more freely its segment moves. Beyond POSTURE_DEG it is no slip.
    Arms that were held out in the pose (`name` "t") are judged only where other arms are out again.
    """
    later = [(a, b) for a, b in still_runs(raw) if a >= window.stop and b - a >= REST_FRAMES]
    tilts = [tilt_from_pose(raw, a, b, pose) for a, b in later]
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
        if name == "t" and s in arms:
            others = [a for a in arms if a != s]
            judged = [(run, t) for run, t in judged if _as_in_pose(t[others])]
        off = [k for k, (_, t) in enumerate(judged) if t[s] > limit]
        if not off or len(off) <= 0.5 * (len(judged) - off[0]):
            continue
        (first, _), tilts_then = judged[off[0]]
        since = raw.start_s + first / raw.rate_hz
        tilt = float(np.median([judged[k][1][s] for k in off]))
        text = (
            f"sensor {sensor}: tilted by {tilt:.0f} deg since the pose when the body stands still again "
            f"at {since:.1f} s, the others by {float(np.nanmedian(tilts_then)):.0f} deg: it "
            f"slipped on the bone, or that limb was held differently"
        )
        found.append(Finding("warning", sensor, "slipped", text, tilt))
    return found


def _as_in_pose(tilts: Array) -> bool:
    """Is half of these tilts (deg) below REST_DEG? Those that are NaN do not count."""
    known = tilts[np.isfinite(tilts)]
    return len(known) > 0 and float(np.median(known)) < REST_DEG


def check_leaning(raw: RawRecording, window: Window, pose: Pose) -> list[Finding]:
    """Is the trunk in the pose far from how it is held during the rest of the recording?"""
    found = []
    for s, name in enumerate(raw.sensors):
        if name not in TRUNK:
            continue
        _, up, frames = face.carried(raw, pose, s)
        up = up[(frames < window.start) | (frames >= window.stop)]
        if len(up) < 5 * raw.rate_hz:
            continue
        mean = np.median(up, axis=0)
        tilt = float(np.degrees(np.arctan2(np.hypot(mean[0], mean[2]), mean[1])))
        if tilt > LEANING_DEG:
            text = (
                f"sensor {name}: leans {tilt:.0f} deg in the pose against the median of the recording: "
                f"the wearer leaned in the pose, or mostly leans or sits afterwards"
            )
            found.append(Finding("warning", name, "pose-leaning", text, tilt))
    return found


def check_lags(raw: RawRecording, joints: np.ndarray) -> list[Finding]:
    """Is one sensor's clock behind the others'?

    For each pair of sensors on one limb or the trunk, the lag (at most 0.5 s) at which their activity
    correlates best; one lag per sensor explains them by least absolute deviations (a sensor's lag is
    the median of its pairwise lags, when its neighbours agree among themselves).

    In a gait the thigh is always busy a little before the shank, and a lag of half a stride fits as well as
    none: where the correlation swings to the opposite within the lags tried, it does not tell a clock.
    """
    if raw.rate_hz * LAG_S < 1:
        return []  # a lag of one frame is more than LAG_S, and less than one does not show
    # A lag to 30 ms is enough, and the cost grows with the square of the rate.
    skip = max(1, int(raw.rate_hz // 30))
    rate = raw.rate_hz / skip
    act = activity(raw)[::skip]
    reach = round(0.5 * rate)
    S = len(raw.sensors)
    lag = np.full((S, S), np.nan)
    for a, b in combinations(range(S), 2):
        if heads.comparable(int(joints[a]), int(joints[b])):
            lag[a, b] = _lag(act[:, a], act[:, b], reach) / rate
            lag[b, a] = -lag[a, b]
    found = []
    for s, name in enumerate(raw.sensors):
        mine = lag[s][np.isfinite(lag[s])]
        if len(mine) < 2:
            continue
        late = float(np.median(mine))
        spread = float(np.median(np.abs(mine - late)))
        if abs(late) > LAG_S and spread < 0.25 * abs(late):
            text = (
                f"sensor {name}: runs {abs(late) * 1000:.0f} ms {'behind' if late > 0 else 'ahead of'} "
                f"the sensors next to it: its clock is not synchronised"
            )
            found.append(Finding("warning", name, "lag", text, late))
    return found


def _lag(x: Array, y: Array, reach: int) -> float:
    """Frames by which x is later than y; 0 where that is hardly better, NaN where it cannot be told."""
    if min(x.std(), y.std()) < LIVELY or len(x) < 24 * reach:  # 12 s
        return np.nan
    core = x[reach:-reach]
    shifts = np.arange(-reach, reach + 1)
    c = np.array([np.corrcoef(core, y[reach - k : len(y) - reach - k])[0, 1] for k in shifts])
    best = int(np.argmax(c))
    if c[best] < 0.6 or best in (0, len(c) - 1) or c.min() < 0:
        return np.nan
    return float(shifts[best]) if c[best] > c[reach] + LAG_GAIN else 0.0
