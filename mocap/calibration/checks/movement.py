"""Did the wearer, or a sensor, move in the static pose?"""

from __future__ import annotations

import numpy as np

from mocap import orientation as ori
from mocap.calibration.evidence import Evidence
from mocap.calibration.static_pose import NEVER_STILL, StillWindow
from mocap.findings import Finding, Severity
from mocap.orientation import Array
from mocap.recording import RawRecording, gaps

MOVED_DEG = 5.0
WOBBLE_S = 0.3  # correlation time of soft tissue that wobbles
WOBBLES = 4.0  # of the standard deviation that wobble leaves in a difference of two means
THIRDS = 5.0  # of the wobble within the first and the last third, for their difference: slow drifts
FRAMES = 10  # of a pose, below which wobble cannot be told from movement
PART_S = 0.2  # shortest part of a pose that has a mean
JUMPS = 8.0  # of the median turn per sample that gyr leaves unexplained
UNSEEN_S = 3.0  # the filter corrects a tilt that a gap left within this time (VQF's tauAcc)


def check(evidence: Evidence) -> list[Finding]:
    """Did a sensor, or the wearer, move during the pose?

    A sensor did if its orientation jumps, or changes by more than MOVED_DEG and than its wobble and its gaps
    explain.
    """
    raw, window, static = evidence.raw, evidence.pose.window, evidence.pose.static
    found = []
    unseen = _unseen_deg(raw, window)
    a, b = window.seconds(raw)
    if not window.still:
        # Standing people turn by up to 5 deg/s, 17 with the realistic noise, walking ones by 50 and more.
        severity: Severity = "error" if window.rate > NEVER_STILL else "warning"
        details = {"start_s": a, "end_s": b, "rate_deg_s": float(np.degrees(window.rate))}
        found.append(Finding(severity, None, "pose-not-still", float(window.rate), details))
    for s, name in enumerate(raw.sensors):
        jump = _jump(raw, window, s)
        if jump:
            k, size = jump
            details = {"jump_deg": size, "at_s": raw.start_s + k / raw.rate_hz}
            found.append(Finding("warning", name, "moved-in-pose", size, details))
            continue
        change = _moved(raw, window, s)
        if change is None:
            continue
        moved, sigma = change
        drifted, within = float(static.moved_deg[s]), float(static.wobble_deg[s])
        seen = [
            x
            for x, wobble in ((moved, WOBBLES * sigma), (drifted, THIRDS * within))
            if x > np.hypot(max(MOVED_DEG, wobble), 2.0 * unseen[s])
        ]
        if seen:
            details = {"moved_deg": max(seen), "start_s": a, "end_s": b}
            found.append(Finding("warning", name, "moved-in-pose", max(seen), details))
    return found


def _moved(raw: RawRecording, window: StillWindow, s: int) -> tuple[float, float] | None:
    """Angle in deg between the means before and after the moment that parts them most clearly, and its sigma.

    Wobble of variance v per sample and correlation time WOBBLE_S changes by 2 v (1 - e^(-dt / WOBBLE_S)) from
    sample to sample; the median of that gives v, which one jump does not raise. The mean over T s keeps
    v / (1 + T / 2 WOBBLE_S). None for fewer than FRAMES, or than two parts.
    """
    assert raw.R_world_sensor is not None
    R = raw.R_world_sensor[window.start : window.stop, s]
    at = np.flatnonzero(raw.valid[window.start : window.stop, s] & np.isfinite(R).all((-1, -2)))
    part = max(3, round(PART_S * raw.rate_hz))
    if len(at) < max(FRAMES, 2 * part):
        return None
    x = np.degrees(ori.log(ori.mean(R[at]).T @ R[at]))
    step = (np.diff(x, axis=0) ** 2).sum(axis=1) / (
        2 * (1 - np.exp(-np.diff(at) / raw.rate_hz / WOBBLE_S))
    )
    variance = float(np.median(step))
    n = np.arange(part, len(x) - part + 1)
    total = np.cumsum(x, axis=0)
    before = total[n - 1] / n[:, None]
    after = (total[-1] - total[n - 1]) / (len(x) - n)[:, None]
    keeps = sum(1 / (1 + m / raw.rate_hz / (2 * WOBBLE_S)) for m in (n, len(x) - n))
    moved, sigma = np.linalg.norm(after - before, axis=1), np.sqrt(variance * keeps)
    k = int(np.argmax(moved - np.maximum(MOVED_DEG, WOBBLES * sigma)))
    return float(moved[k]), float(sigma[k])


def _jump(raw: RawRecording, window: StillWindow, s: int) -> tuple[int, float] | None:
    """Frame and deg of the largest turn within the window that gyr does not explain, if there is one.

    Of R_{t-1}^T R_t; whether gyr of a file belongs to the step before a sample or after it, is not known.
    """
    assert raw.R_world_sensor is not None
    part = slice(window.start, window.stop)
    R, gyr = raw.R_world_sensor[part, s], raw.gyr[part, s] / raw.rate_hz
    ok = raw.valid[part, s] & np.isfinite(R).all((-1, -2))
    t = np.flatnonzero(ok[1:] & ok[:-1]) + 1
    if len(t) < JUMPS:
        return None
    turn = np.swapaxes(R[t - 1], -1, -2) @ R[t]
    left = np.degrees(
        np.min([ori.angle_between(ori.exp(gyr[k]), turn) for k in (t, t - 1)], axis=0)
    )
    k = int(np.argmax(left))
    if left[k] > max(MOVED_DEG, JUMPS * float(np.median(left))):
        return window.start + int(t[k]), float(left[k])
    return None


def _unseen_deg(raw: RawRecording, window: StillWindow) -> Array:
    """How far, in deg, each sensor (S,) may have turned unseen in gaps that bear on the window, 1 sigma.

    A gap of d s between rates of w rad/s (root mean square over 0.1 s to either side) hides about w d; the
    filter puts that right within UNSEEN_S, which looks like movement. Gaps are independent.
    """
    square = np.zeros(len(raw.sensors))
    near, margin = max(1, round(0.1 * raw.rate_hz)), round(UNSEEN_S * raw.rate_hz)
    for gap in gaps(raw.valid):
        s, start, stop = gap["sensor"], gap["start"], gap["start"] + gap["frames"]
        if stop < window.start - margin or start > window.stop + margin:
            continue
        beside = np.r_[max(0, start - near) : start, stop : min(len(raw), stop + near)]
        gyr = raw.gyr[beside, s][raw.valid[beside, s]]
        if len(gyr):
            square[s] += (gyr**2).sum(axis=1).mean() * (gap["frames"] / raw.rate_hz) ** 2
    return np.asarray(np.degrees(np.sqrt(square)))
