"""Is the clock of one sensor late? Nothing but a gait does not tell."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mocap.calibration import headings as heads
from mocap.calibration.evidence import Evidence
from mocap.findings import Finding
from mocap.orientation import Array

LAG_S = 0.1
LAG_GAIN = 0.1  # by which a lag must correlate better than none
LIVELY = 0.5  # standard deviation of the activity from which its course tells a lag


def check(evidence: Evidence) -> list[Finding]:
    """Is one sensor's clock behind the others'?

    For each pair of sensors on one limb or the trunk, the lag (at most 0.5 s) at which their activity
    correlates best; one lag per sensor explains them by least absolute deviations (a sensor's lag is
    the median of its pairwise lags, when its neighbours agree among themselves).

    In a gait the thigh is always busy a little before the shank, and a lag of half a stride fits as well as
    none: where the correlation swings to the opposite within the lags tried, it does not tell a clock.
    """
    raw, joints = evidence.raw, evidence.joints
    if raw.rate_hz * LAG_S < 1:
        return []  # a lag of one frame is more than LAG_S, and less than one does not show
    # A lag to 30 ms is enough, and the cost grows with the square of the rate.
    skip = max(1, int(raw.rate_hz // 30))
    rate = raw.rate_hz / skip
    act = evidence.activity[::skip]
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
            found.append(Finding("warning", name, "lag", late, {"late_s": late}))
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
