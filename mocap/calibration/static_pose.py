"""The static pose: find when the wearer stood still, and average the sensors over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.calibration.stillness import (
    MIN_S,
    SMOOTH_S,
    STILL_RATE,
    still_runs,
    stillness,
    sway,
    threshold,
)
from mocap.errors import CalibrationError
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording

# Over this time, wobble and tremor have taken back what they turned, and slow movement shows. Steps have,
# too, which is why it only places the window within a still run.
CALM_S = 1.0
NEVER_STILL = 0.6  # rad/s: if the calmest moments are faster than this, nobody stood still
MAX_S = 2.0  # longest part of a still run that is averaged
# Trunk or thighs this far from where they are in motion: sitting, lying; or standing before deep movement.
IMPLAUSIBLE_DEG = 40.0
RIVAL = 1 / 3  # of the best score: another window that good, in another posture, is worth a word
POSTURE_DEG = 30.0  # tilt of some sensor from which two windows are in different postures
# A seat tips the pelvis back by 20 deg, and has the thighs level; whoever stands again is within 10.
SEATED_DEG = 15.0
_UPRIGHT = ("pelvis", "sternum", "lower_back", "upper_back", "left_thigh", "right_thigh",
            "left_shank", "right_shank")  # fmt: skip


@dataclass(frozen=True)
class StillWindow:
    """Frames start to stop-1, taken for the static pose.

    rate: mean smoothed rate of rotation over sensors and frames, rad/s. still: whether it is a still
    run (False: the time was given and the wearer moved then). found: by search, not by a given time. rival:
    frames of another still window, in another posture, that would be about as good; None where there is none.
    """

    start: int
    stop: int
    rate: float
    still: bool
    found: bool
    rival: tuple[int, int] | None = None

    def seconds(self, raw: RawRecording) -> tuple[float, float]:
        """Start and end in s on the recording's clock."""
        return raw.start_s + self.start / raw.rate_hz, raw.start_s + self.stop / raw.rate_hz


@dataclass(frozen=True, eq=False)
class StaticPose:
    """Averages over a window.

    R_world_sensor (S,3,3): chordal means. acc (S,3) m/s^2: mean specific force in the sensor's frame.
    moved_deg (S,): angle between the means of the first and the last third. wobble_deg (S,): rms angle
    to these within the thirds.
    """

    R_world_sensor: Array
    acc: Array
    moved_deg: Array
    wobble_deg: Array


def find_static(raw: RawRecording, at: float | None = None) -> StillWindow:
    """The window of the static pose.

    at: a time in s on the recording's clock (`raw.start_s` is frame 0); the still run around it, at
    most 1 s to each side, or 0.25 s to each side where the wearer moved. Without it: the best still
    run: long (up to MAX_S), calm, early (recordings begin with the pose), and with trunk and legs
    held roughly as during the rest of the recording, which a wearer who sits or lies does not. Where one in
    another posture has more than RIVAL of its score, that is the window's `rival`.
    Raises CalibrationError where `at` lies outside the recording or nothing is still.
    """
    rate = stillness(raw)
    if at is not None:
        return _around(raw, rate, at)
    finite = rate[np.isfinite(rate)]
    runs = still_runs(raw)
    if not runs or np.percentile(finite, 1) > NEVER_STILL:
        calm = float(finite.min()) if len(finite) else np.nan
        raise CalibrationError(
            f"no static pose found: the body is never still for {MIN_S:g} s (calmest moment "
            f"{np.degrees(calm):.0f} deg/s); name a time"
        )
    slow = stillness(raw, CALM_S)
    windows = [_calmest(slow, a, b, raw.rate_hz) for a, b in runs]
    scores = [_score(raw, rate, a, b) for a, b in windows]
    order = np.argsort(scores)[::-1]
    start, stop = windows[order[0]]
    lean = _leans(raw, rate, start, stop)
    rivals = [
        windows[k]
        for k in order[1:]
        if scores[k] > RIVAL * scores[order[0]]
        and _apart_deg(raw, windows[k], (start, stop)) > POSTURE_DEG
        and not _sits(_leans(raw, rate, *windows[k]), lean)
    ]
    rival = rivals[0] if rivals else None
    return StillWindow(start, stop, float(rate[start:stop].mean()), True, True, rival)


def _apart_deg(raw: RawRecording, first: tuple[int, int], other: tuple[int, int]) -> float:
    """Tilt in deg of the sensor that differs most between two still windows; 0 if none is seen."""
    means = []
    for a, b in (first, other):
        ok = raw.valid[a:b, :, None]
        count = np.maximum(ok.sum(axis=0), 1)
        means.append(np.where(ok, np.nan_to_num(raw.acc[a:b]), 0.0).sum(axis=0) / count)
    size = np.linalg.norm(means[0], axis=1) * np.linalg.norm(means[1], axis=1)
    cos = np.einsum("si,si->s", *means) / np.maximum(size, 1e-9)
    return float(np.degrees(np.arccos(np.clip(np.where(size > 0, cos, 1.0), -1, 1))).max())


def average(raw: RawRecording, window: StillWindow) -> StaticPose:
    """Mean orientation and specific force of every sensor over the window.

    Needs R_world_sensor. Raises CalibrationError naming a sensor that has no valid sample there.
    """
    if raw.R_world_sensor is None:
        raise CalibrationError("the recording has no R_world_sensor: fuse it first")
    S = len(raw.sensors)
    R_all, acc_all = (x[window.start : window.stop] for x in (raw.R_world_sensor, raw.acc))
    valid = raw.valid[window.start : window.stop] & np.isfinite(R_all).all((-1, -2))
    R, acc = np.empty((S, 3, 3)), np.empty((S, 3))
    moved, wobble = np.zeros(S), np.zeros(S)
    for s, name in enumerate(raw.sensors):
        ok = np.flatnonzero(valid[:, s])
        if len(ok) == 0:
            a, b = window.seconds(raw)
            raise CalibrationError(
                f"sensor {name}: no valid sample in the static pose, {a:.2f} to {b:.2f} s"
            )
        R[s], acc[s] = ori.mean(R_all[ok, s]), acc_all[ok, s].mean(axis=0)
        if len(ok) >= 3:
            moved[s], wobble[s] = _drift(R_all[ok, s])
    return StaticPose(R, acc, moved, wobble)


def _drift(R: Array) -> tuple[float, float]:
    """Angle in deg between the means of the first and the last third, and the rms angle to them."""
    n = len(R) // 3
    thirds = R[:n], R[-n:]
    means = [ori.mean(x) for x in thirds]
    around = [ori.angle_between(m, x) for m, x in zip(means, thirds, strict=True)]
    wobble = np.sqrt(np.mean(np.square(around)))
    return float(np.degrees(ori.angle_between(*means))), float(np.degrees(wobble))


def _around(raw: RawRecording, rate: Array, at: float) -> StillWindow:
    last = raw.start_s + (len(raw) - 1) / raw.rate_hz
    if not raw.start_s - 1e-9 <= at <= last + 1e-9:
        raise CalibrationError(
            f"the pose at {at:g} s lies outside the recording, {raw.start_s:g} to {last:g} s"
        )
    k = min(len(raw) - 1, max(0, round((at - raw.start_s) * raw.rate_hz)))
    still = rate < threshold(raw, rate)
    half, shortest = round(MAX_S / 2 * raw.rate_hz), round(MIN_S / 2 * raw.rate_hz)
    start, stop = max(0, k - shortest), min(len(raw), k + shortest + 1)
    run = next(((a, b) for a, b in still_runs(raw) if a <= k < b), None)
    if run is None:
        if not rate[start:stop].mean() < threshold(raw, rate):
            return StillWindow(start, stop, float(rate[start:stop].mean()), False, False)
        # Noise broke the stance here, so it goes on for as long as either side is still.
        moves = np.flatnonzero(~still)
        before, after = moves[moves < start], moves[moves >= stop]
        run = (
            int(before[-1]) + 1 if len(before) else 0,
            int(after[0]) if len(after) else len(raw),
        )
    start, stop = max(run[0], k - half), min(run[1], k + half + 1)
    return StillWindow(start, stop, float(rate[start:stop].mean()), True, False)


def _calmest(slow: Array, a: int, b: int, rate_hz: float) -> tuple[int, int]:
    """The part of [a, b) that lasts at most MAX_S and turns least, by the mean square of `slow` (T,)."""
    # Smoothing hides the first movement at either end.
    trim = min(round(SMOOTH_S / 2 * rate_hz), (b - a - round(MIN_S * rate_hz)) // 2)
    a, b = a + max(trim, 0), b - max(trim, 0)
    n = min(b - a, max(1, round(MAX_S * rate_hz)))
    sums = np.convolve(slow[a:b] ** 2, np.ones(n), mode="valid")
    k = a + int(np.argmin(sums))
    return k, k + n


def _score(raw: RawRecording, rate: Array, a: int, b: int) -> float:
    """Between 0 and 1: length, calmness, earliness, plausibility of a window.

    Length counts squared: a moment of rest is common, a stance of MAX_S is meant. A lean of l deg counts
    1 / (1 + (l / IMPLAUSIBLE_DEG)^4): 0.05 for a seat, but 0.3 for a stance before squats and low dances.
    """
    length = min(1.0, (b - a) / (MAX_S * raw.rate_hz)) ** 2
    calm = 1.0 / (1.0 + (rate[a:b].mean() / STILL_RATE) ** 2)
    early = 1.0 - 0.7 * a / len(raw)
    lean = _lean_from_motion(raw, rate, a, b)
    plausible = 1.0 / (1.0 + (lean / IMPLAUSIBLE_DEG) ** 4)
    return float(length * calm * early * plausible)


def _lean_from_motion(raw: RawRecording, rate: Array, a: int, b: int) -> float:
    """How far, in deg, up in the window is from up while moving: upper fifth over trunk and legs.

    Not the median, because whoever sits has shanks and trunk upright as well.
    """
    leans = _leans(raw, rate, a, b)
    leans = leans[np.isfinite(leans)]
    return float(np.percentile(leans, 80)) if len(leans) else 0.0


def _leans(raw: RawRecording, rate: Array, a: int, b: int) -> Array:
    """That angle (S,) in deg of every sensor; NaN for arms and head, and where too little is seen."""
    moving = rate > max(3 * sway(rate), threshold(raw, rate))
    angles = np.full(len(raw.sensors), np.nan)
    for s, name in enumerate(raw.sensors):
        if name not in _UPRIGHT:
            continue
        here, there = raw.acc[a:b, s][raw.valid[a:b, s]], raw.acc[:, s][raw.valid[:, s] & moving]
        if len(here) and len(there) > 5 * raw.rate_hz:
            u, v = here.mean(axis=0), there.mean(axis=0)
            cos = u @ v / max(np.linalg.norm(u) * np.linalg.norm(v), 1e-9)
            angles[s] = np.degrees(np.arccos(np.clip(cos, -1, 1)))
    return angles


def _sits(leans: Array, stance: Array) -> bool:
    """Is some part of trunk or legs SEATED_DEG further from where it is in motion than in another window?"""
    return bool((np.nan_to_num(leans - stance) > SEATED_DEG).any())


def tilt_from_pose(raw: RawRecording, a: int, b: int, pose: StaticPose) -> Array:
    """Angle (S,) in deg between up in the sensor's frame during [a, b) and in the pose.

    Independent of any heading; NaN without a valid sample.
    """
    assert raw.R_world_sensor is not None
    up = raw.R_world_sensor[a:b, :, 1, :]
    ok: Bool = raw.valid[a:b] & np.isfinite(up).all(-1)
    count = ok.sum(axis=0)
    mean = np.where(ok[..., None], up, 0.0).sum(axis=0)
    mean[count == 0] = np.nan
    cos = np.einsum("si,si->s", mean, pose.R_world_sensor[:, 1, :])
    with np.errstate(invalid="ignore"):
        return np.degrees(np.arccos(np.clip(cos / np.linalg.norm(mean, axis=1), -1, 1)))
