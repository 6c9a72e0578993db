"""Was the static pose one: did the wearer, or a sensor, move in it, and did the wearer stand?

*Posture.* Nobody knows how a sensor sits on its bone, so a seat looks like an N-pose in itself. What tells it
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
from scipy.ndimage import uniform_filter1d

from mocap import orientation as ori
from mocap.calibration import facing as face
from mocap.calibration.static_pose import NEVER_STILL, Pose, Window
from mocap.calibration.stillness import SMOOTH_S, still_runs
from mocap.findings import Finding, Severity
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording, gaps

MOVED_DEG = 5.0
WOBBLE_S = 0.3  # correlation time of soft tissue that wobbles
WOBBLES = 4.0  # of the standard deviation that wobble leaves in a difference of two means
THIRDS = 5.0  # of the wobble within the first and the last third, for their difference: slow drifts
FRAMES = 10  # of a pose, below which wobble cannot be told from movement
PART_S = 0.2  # shortest part of a pose that has a mean
JUMPS = 8.0  # of the median turn per sample that gyr leaves unexplained
UNSEEN_S = 3.0  # the filter corrects a tilt that a gap left within this time (VQF's tauAcc)

LEGS = ("thigh", "pocket", "shank", "foot")
IN_USE = 1.0  # rad/s: mean rate of the leg sensors, smoothed, from which the legs are in use
IN_USE_S = 5.0  # of such frames at least
SEAT_DEG = 40.0  # tilt of both thighs since the pose: more than most people's mean in a motion
TOGETHER = 0.1  # up of the shank along that of the thigh, horizontally; right people: -0.04 at most
SEAT_PELVIS_DEG, STANCE_PELVIS_DEG = 18.0, 10.0  # tilt of a pelvis that sits; of one that stands
STANCE_S = 2.0  # dancers hold a pose for one


def check_pose(raw: RawRecording, window: Window, pose: Pose) -> list[Finding]:
    """Did a sensor, or the wearer, move during the pose?

    A sensor did if its orientation jumps, or changes by more than MOVED_DEG and than its wobble and its gaps
    explain.
    """
    found = []
    unseen = _unseen_deg(raw, window)
    a, b = window.seconds(raw)
    if not window.still:
        text = (
            f"the wearer moves at the time of the pose, {a:.2f} to {b:.2f} s "
            f"({np.degrees(window.rate):.0f} deg/s): name another time, or let it be found"
        )
        # Standing people turn by up to 5 deg/s, 17 with the realistic noise, walking ones by 50 and more.
        severity: Severity = "error" if window.rate > NEVER_STILL else "warning"
        found.append(Finding(severity, None, "pose-not-still", text, float(window.rate)))
    for s, name in enumerate(raw.sensors):
        jump = _jump(raw, window, s)
        if jump:
            k, size = jump
            text = (
                f"sensor {name}: its orientation jumps by {size:.0f} deg during the pose, at "
                f"{raw.start_s + k / raw.rate_hz:.2f} s, which its gyroscope does not see"
            )
            found.append(Finding("warning", name, "moved-in-pose", text, size))
            continue
        change = _moved(raw, window, s)
        if change is None:
            continue
        moved, sigma = change
        drifted, within = float(pose.moved_deg[s]), float(pose.wobble_deg[s])
        seen = [
            x
            for x, wobble in ((moved, WOBBLES * sigma), (drifted, THIRDS * within))
            if x > np.hypot(max(MOVED_DEG, wobble), 2.0 * unseen[s])
        ]
        if seen:
            text = (
                f"sensor {name}: moved by {max(seen):.1f} deg during the pose, {a:.2f} to {b:.2f} s"
            )
            found.append(Finding("warning", name, "moved-in-pose", text, max(seen)))
    return found


def _moved(raw: RawRecording, window: Window, s: int) -> tuple[float, float] | None:
    """Angle in deg between the means before and after the moment that parts them most clearly, and its sigma.

    Wobble of variance v per sample and correlation time WOBBLE_S changes by 2 v (1 - e^(-dt / WOBBLE_S)) from
    sample to sample; the median of that gives v, which one jump does not raise. The mean over T s keeps
    v / (1 + T / 2 WOBBLE_S). None for fewer than FRAMES.
    """
    assert raw.R_world_sensor is not None
    R = raw.R_world_sensor[window.start : window.stop, s]
    at = np.flatnonzero(raw.valid[window.start : window.stop, s] & np.isfinite(R).all((-1, -2)))
    part = max(3, round(PART_S * raw.rate_hz))
    if len(at) < FRAMES:
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


def _jump(raw: RawRecording, window: Window, s: int) -> tuple[int, float] | None:
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


def _unseen_deg(raw: RawRecording, window: Window) -> Array:
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


def check_posture(raw: RawRecording, window: Window, pose: Pose, facing: Array) -> list[Finding]:
    """Did the wearer sit in the pose? facing (S,) rad: the wearer's forward in each sensor's world."""
    using = _legs_in_use(raw, window)
    if using is None:
        return []
    ups = _ups(raw, pose, using)
    thighs = _pair(raw, "thigh") or _pair(raw, "pocket")
    least, low = SEAT_PELVIS_DEG, STANCE_PELVIS_DEG
    if thighs:
        judged, what, least, low = thighs, "both thighs are", SEAT_DEG, 0.5 * SEAT_DEG
    elif "pelvis" in raw.sensors:
        judged, what = [raw.sensors.index("pelvis")], "the pelvis is"
    else:
        return []
    tilt = float(np.nan_to_num(_tilt(ups[judged])).min())
    if tilt < least:
        return []
    shanks = _pair(raw, "shank")
    stance = _stance(raw, window, pose, ups, judged, low)
    bends = ""
    if thighs and shanks and raw.common_heading:
        along = [_along(ups[[t, s]], facing[[t, s]]) for t, s in zip(thighs, shanks, strict=True)]
        if min(along) < TOGETHER:
            return []
        bends = ", and the knees would bend forward"
    elif stance is None:
        return []
    a, b = window.seconds(raw)
    other = "name the time of a stance"
    if stance is not None:
        other = (
            f"at {stance:.1f} s it stands still as in motion: name another time (--at {stance:.1f})"
        )
    text = (
        f"the pose, {a:.2f} to {b:.2f} s, is not one of standing: {what} {tilt:.0f} deg from where the legs' "
        f"motion has {'them' if thighs else 'it'}{bends}. The wearer probably sat; {other}"
    )
    return [Finding("warning", None, "pose-posture", text, tilt)]


def doubtful(raw: RawRecording, window: Window, pose: Pose) -> bool:
    """May the wearer have sat in the pose, without thighs to say so? The pelvis tilts as in a seat, then."""
    using = _legs_in_use(raw, window)
    if using is None or "pelvis" not in raw.sensors or _pair(raw, "thigh") or _pair(raw, "pocket"):
        return False
    tilt = _tilt(_ups(raw, pose, using)[[raw.sensors.index("pelvis")]])
    return bool(tilt[0] > SEAT_PELVIS_DEG)


def _pair(raw: RawRecording, kind: str) -> list[int] | None:
    """Left and right sensor of a kind."""
    sides = [f"{side}_{kind}" for side in ("left", "right")]
    return [raw.sensors.index(n) for n in sides] if set(sides) <= set(raw.sensors) else None


def _legs_in_use(raw: RawRecording, window: Window) -> Bool | None:
    """Frames (T,) outside the window in which the legs turn faster than IN_USE; None for too few."""
    worn = [s for s, n in enumerate(raw.sensors) if face.kind(n) in LEGS]
    if not worn:
        return None
    n = max(1, round(SMOOTH_S * raw.rate_hz))
    gyr = np.where(raw.valid[:, worn, None], np.nan_to_num(raw.gyr[:, worn]), 0.0)
    using = np.linalg.norm(uniform_filter1d(gyr, n, axis=0), axis=-1).mean(axis=1) > IN_USE
    using[window.start : window.stop] = False
    return using if using.sum() >= IN_USE_S * raw.rate_hz else None


def _ups(raw: RawRecording, pose: Pose, frames: Bool) -> Array:
    """Mean of v over frames (T,) for each sensor, as unit vectors (S,3); NaN without a valid sample."""
    assert raw.R_world_sensor is not None
    up = raw.R_world_sensor[frames, :, 1, :]
    ok = raw.valid[frames] & np.isfinite(up).all(-1)
    total = np.where(ok[..., None], up, 0.0).sum(axis=0)
    size = np.linalg.norm(total, axis=-1, keepdims=True)
    unit = total / np.where(size > 0, size, np.nan)
    return np.einsum("sij,sj->si", pose.R_world_sensor, unit)


def _tilt(up: Array) -> Array:
    """Angle in deg of unit vectors (...,3) to the vertical."""
    return np.asarray(np.degrees(np.arccos(np.clip(up[..., 1], -1, 1))))


def _along(up: Array, facing: Array) -> float:
    """Horizontal part of the second of two unit vectors (2,3) along that of the first, in one world."""
    h = face.complex_heading(up) * np.exp(-1j * facing)
    return float((h[1] * np.conj(h[0])).real / max(abs(h[0]), 1e-9))


def _stance(
    raw: RawRecording, window: Window, pose: Pose, ups: Array, judged: list[int], low: float
) -> float | None:
    """Middle, in s, of the longest still run in which the sensors `judged` are within `low` deg of `ups`."""
    best: tuple[int, int] | None = None
    for a, b in still_runs(raw):
        if b - a < STANCE_S * raw.rate_hz or (a < window.stop and b > window.start):
            continue
        frames = np.zeros(len(raw), bool)
        frames[a:b] = True
        there = _ups(raw, pose, frames)[judged]
        off = np.degrees(np.arccos(np.clip((there * ups[judged]).sum(axis=-1), -1, 1)))
        if np.nan_to_num(off, nan=180.0).max() < low and (
            best is None or b - a > best[1] - best[0]
        ):
            best = (a, b)
    return None if best is None else raw.start_s + (best[0] + best[1]) / 2 / raw.rate_hz
