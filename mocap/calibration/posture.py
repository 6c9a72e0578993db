"""How the body is held in the static pose, against how it is held while the legs are in use.

With v = C_s R_ws^T e_y, up in a sensor's frame carried to the pose (`mocap.calibration.facing`).
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from mocap.calibration import facing as face
from mocap.calibration.static_pose import StaticPose, StillWindow
from mocap.calibration.stillness import SMOOTH_S
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording

LEGS = ("thigh", "pocket", "shank", "foot")
IN_USE = 1.0  # rad/s: mean rate of the leg sensors, smoothed, from which the legs are in use
IN_USE_S = 5.0  # of such frames at least
STANCE_S = 2.0  # dancers hold a pose for one
SEAT_PELVIS_DEG = 18.0  # tilt of a pelvis that sits


def seat_possible(raw: RawRecording, window: StillWindow, pose: StaticPose) -> bool:
    """May the wearer have sat in the pose, without thighs to say so? The pelvis tilts as in a seat, then."""
    using = legs_in_use(raw, window)
    if using is None or "pelvis" not in raw.sensors or pair(raw, "thigh") or pair(raw, "pocket"):
        return False
    tilted = tilt(ups(raw, pose, using)[[raw.sensors.index("pelvis")]])
    return bool(tilted[0] > SEAT_PELVIS_DEG)


def pair(raw: RawRecording, kind: str) -> list[int] | None:
    """Left and right sensor of a kind."""
    sides = [f"{side}_{kind}" for side in ("left", "right")]
    return [raw.sensors.index(n) for n in sides] if set(sides) <= set(raw.sensors) else None


def legs_in_use(raw: RawRecording, window: StillWindow) -> Bool | None:
    """Frames (T,) outside the window in which the legs turn faster than IN_USE; None for too few."""
    worn = [s for s, n in enumerate(raw.sensors) if face.kind(n) in LEGS]
    if not worn:
        return None
    n = max(1, round(SMOOTH_S * raw.rate_hz))
    gyr = np.where(raw.valid[:, worn, None], np.nan_to_num(raw.gyr[:, worn]), 0.0)
    using = np.linalg.norm(uniform_filter1d(gyr, n, axis=0), axis=-1).mean(axis=1) > IN_USE
    using[window.start : window.stop] = False
    return using if using.sum() >= IN_USE_S * raw.rate_hz else None


def ups(raw: RawRecording, pose: StaticPose, frames: Bool) -> Array:
    """Mean of v over frames (T,) for each sensor, as unit vectors (S,3); NaN without a valid sample."""
    assert raw.R_world_sensor is not None
    up = raw.R_world_sensor[frames, :, 1, :]
    ok = raw.valid[frames] & np.isfinite(up).all(-1)
    total = np.where(ok[..., None], up, 0.0).sum(axis=0)
    size = np.linalg.norm(total, axis=-1, keepdims=True)
    unit = total / np.where(size > 0, size, np.nan)
    return np.einsum("sij,sj->si", pose.R_world_sensor, unit)


def tilt(up: Array) -> Array:
    """Angle in deg of unit vectors (...,3) to the vertical."""
    return np.asarray(np.degrees(np.arccos(np.clip(up[..., 1], -1, 1))))


def along(up: Array, facing: Array) -> float:
    """Horizontal part of the second of two unit vectors (2,3) along that of the first, in one world."""
    h = face.complex_heading(up) * np.exp(-1j * facing)
    return float((h[1] * np.conj(h[0])).real / max(abs(h[0]), 1e-9))


def stance(
    runs: list[tuple[int, int]],
    raw: RawRecording,
    window: StillWindow,
    pose: StaticPose,
    means: Array,
    judged: list[int],
    low: float,
) -> float | None:
    """Middle, in s, of the longest still run in which the sensors `judged` are within `low` deg of `means`.

    runs: all still ones.
    """
    best: tuple[int, int] | None = None
    for a, b in runs:
        if b - a < STANCE_S * raw.rate_hz or (a < window.stop and b > window.start):
            continue
        frames = np.zeros(len(raw), bool)
        frames[a:b] = True
        there = ups(raw, pose, frames)[judged]
        off = np.degrees(np.arccos(np.clip((there * means[judged]).sum(axis=-1), -1, 1)))
        if np.nan_to_num(off, nan=180.0).max() < low and (
            best is None or b - a > best[1] - best[0]
        ):
            best = (a, b)
    return None if best is None else raw.start_s + (best[0] + best[1]) / 2 / raw.rate_hz
