"""What every reader of recordings checks: rotations, time, units against gravity, gaps.

A violation raises FormatError naming file, frame, sensor and field; a doubt is returned as a text for
`Document.warnings`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Document, Options
from mocap.orientation import GRAVITY, Array
from mocap.recording import RawRecording, Recording, gaps
from mocap.synthesis import second_difference, sensor_positions

Names = tuple[str, ...]
ROTATION_TOLERANCE = 0.02  # text files round to 3 or 4 decimals
QUATERNION_TOLERANCE = 0.05
STILL_WINDOW_S = 0.5
FASTEST = 60.0  # rad/s: no limb turns faster, few gyroscopes measure it
MAX_GROWTH = 4  # a gap-filled time grid holds at most this many times the samples of the file


def quiet(
    read: Callable[[Path, Options], Document],
) -> Callable[[Path, Options], Document]:
    """A reader without numpy's warnings: what overflows or is not finite is for its checks to find."""

    @functools.wraps(read)
    def inner(path: Path, options: Options) -> Document:
        with np.errstate(all="ignore"):
            return read(path, options)

    return inner


def at(sensors: Names, t: int, s: int, what: str) -> str:
    """`frame 12, sensor head: orientation`."""
    return f"frame {t}, sensor {sensors[s]}: {what}"


def rotations(path: Path, R: Array, sensors: Names, what: str) -> Array:
    """R (T,S,3,3) projected onto SO(3), incomplete matrices set to NaN.

    Raises FormatError for a matrix that is left-handed or not orthonormal.
    """
    has = np.isfinite(R).all((-1, -2))
    bad = np.logical_and(has, ~ori.is_rotation(R, ROTATION_TOLERANCE))
    if bad.any():
        t, s = np.argwhere(bad)[0]
        det = float(np.linalg.det(R[t, s]))
        found = "left-handed" if det < -0.5 else "not orthonormal"
        raise FormatError(
            path, f"{found} (determinant {det:.3f}), expected a rotation", at(sensors, t, s, what)
        )
    out = np.full(R.shape, np.nan)
    out[has] = ori.project(R[has])
    return out


def quaternions(
    path: Path, q: Array, sensors: Names, what: str, scalar_first: bool = True
) -> tuple[Array, int]:
    """Rotations (T,S,3,3) of quaternions (T,S,4), and how many were all zero (a sample not measured).

    Raises FormatError for one whose norm is not 1 within `QUATERNION_TOLERANCE`.
    """
    norm = np.linalg.norm(q, axis=-1)
    zero = norm == 0
    bad = np.isfinite(norm) & ~zero & (np.abs(norm - 1) > QUATERNION_TOLERANCE)
    if bad.any():
        t, s = np.argwhere(bad)[0]
        raise FormatError(
            path, f"quaternion of norm {norm[t, s]:.3g}, expected 1", at(sensors, t, s, what)
        )
    return ori.from_quat(q, scalar_first), int(zero.sum())


def grid(path: Path, t: Array, where: str = "time") -> tuple[float, NDArray[np.int64], list[str]]:
    """Rate in Hz, the frame of each time stamp on a grid of that rate, and warnings.

    t (N,) s must rise. A step that is a whole multiple of the common one leaves samples missing;
    stamps may jitter by less than half a step around the grid. Raises FormatError otherwise.
    """
    if len(t) < 2:
        raise FormatError(path, "fewer than two samples", where)
    if not (np.abs(t) < 1e12).all():
        k = int(np.argmin(np.abs(t) < 1e12))
        raise FormatError(path, f"is {t[k]}, expected seconds", f"frame {k}, {where}")
    step = np.diff(t)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0)) + 1
        raise FormatError(
            path, f"{t[k]:g} s after {t[k - 1]:g} s, must rise", f"frame {k}, {where}"
        )
    # The mean over steps without a gap: stamps rounded to 0.01 s have a median step that is wrong.
    usual = float(step[step < 1.5 * np.median(step)].mean())
    jumps = np.maximum(np.rint(step / usual), 1)
    if jumps.sum() > MAX_GROWTH * len(t) + 10:
        k = int(np.argmax(step)) + 1
        raise FormatError(
            path, f"a gap of {step.max():.3g} s at steps of {usual:.3g} s", f"frame {k}, {where}"
        )
    frames = np.r_[0, np.cumsum(jumps)].astype(np.int64)
    slope, start = np.polyfit(frames, t - t[0], 1)
    off = np.abs(t - t[0] - (start + slope * frames)) / slope
    if off.max() > 0.5:
        k = int(np.argmax(np.abs(step - jumps * usual))) + 1
        raise FormatError(
            path,
            f"a step of {step[k - 1]:.4g} s where {usual:.4g} s is usual, expected a constant rate",
            f"frame {k}, {where}",
        )
    doubts = []
    if off.max() > 0.1:
        doubts.append(f"{where}: stamps jitter by up to {off.max():.0%} of a step, read as even")
    lost = int(frames[-1]) + 1 - len(t)
    if lost:
        doubts.append(f"{where}: {lost} of {frames[-1] + 1} samples are missing")
    return float(f"{1 / slope:.9g}"), frames, doubts


def gap_report(valid: NDArray[np.bool_], sensors: Names) -> list[str]:
    """One warning for all samples that are missing, with counts by sensor."""
    lost = (~valid).sum(axis=0)
    if not lost.any():
        return []
    longest = max(g["frames"] for g in gaps(valid))
    by = ", ".join(f"{n} {k}" for n, k in zip(sensors, lost, strict=True) if k)
    return [
        f"{int(lost.sum())} of {valid.size} samples are missing or not finite ({by}), the longest "
        f"gap {longest} frames"
    ]


def _stillest(acc: Array, rate_hz: float) -> tuple[Array, Array]:
    """Mean |acc| and spread of acc in each sensor's stillest window: (S,), (S,), NaN where none."""
    n = max(4, round(STILL_WINDOW_S * rate_hz))
    S = acc.shape[1]
    if len(acc) < n:
        return np.full(S, np.nan), np.full(S, np.nan)
    cut = acc[: len(acc) // n * n].reshape(-1, n, S, 3)
    spread = np.sqrt(cut.var(axis=1).sum(axis=-1))
    spread[~np.isfinite(spread)] = np.inf
    best = spread.argmin(axis=0)
    size = np.linalg.norm(cut.mean(axis=1), axis=-1)
    each = np.arange(S)
    still = np.isfinite(spread[best, each])
    return (
        np.where(still, size[best, each], np.nan),
        np.where(still, spread[best, each], np.nan),
    )


def gravity_size(acc: Array, rate_hz: float) -> Array:
    """(S,) what each accelerometer reads when it is still, in its own unit; NaN where never still.

    Still: the spread within half a second is below 5 % of the reading.
    """
    size, spread = _stillest(acc, rate_hz)
    with np.errstate(invalid="ignore"):
        return np.where(spread < 0.05 * size, size, np.nan)


def raw(path: Path, rec: RawRecording) -> list[str]:
    """Warnings on a raw recording; raises FormatError where units or axes contradict gravity."""
    doubts = gap_report(rec.valid, rec.sensors)
    doubts += _accelerometer(path, rec)
    doubts += _gyroscope(path, rec)
    if rec.R_world_sensor is not None:
        doubts += _up(path, rec)
    return doubts


def _accelerometer(path: Path, rec: RawRecording) -> list[str]:
    size = gravity_size(rec.acc, rec.rate_hz)
    doubts = []
    for name, g in zip(rec.sensors, size, strict=True):
        where = f"sensor {name}: acc"
        if not np.isfinite(g):
            continue
        if abs(g - GRAVITY) < 0.15 * GRAVITY:
            if abs(g - GRAVITY) > 0.05 * GRAVITY:
                doubts.append(f"{where}: {g:.2f} m/s^2 when still, expected {GRAVITY:.2f}")
            continue
        guess = ""
        if abs(g - 1) < 0.15:
            guess = ", so the unit is g (say units g)"
        elif abs(g - GRAVITY**2) < 0.15 * GRAVITY**2:
            guess = ", so it was m/s^2 already (say units m/s^2)"
        elif abs(g - 1000) < 150:
            guess = ", so the unit is mg"
        elif g < 0.5:
            guess = ", so gravity was removed, and raw acceleration must hold it"
        raise FormatError(path, f"{g:.3g} when still, expected {GRAVITY:.2f} m/s^2{guess}", where)
    if not np.isfinite(size).any() and np.isfinite(rec.acc).any():
        doubts.append("no sensor is ever still for half a second: the unit of acc is not checked")
    return doubts


def _gyr_ratio(rec: RawRecording, s: int) -> tuple[float | None, str]:
    """How many times larger gyr is than what it should measure, and by what that is known."""
    if rec.R_world_sensor is not None:
        ratio = rate_ratio(rec, s)
        if ratio is not None:
            return ratio, "the orientation turns"
    return _tilt_ratio(rec.acc[:, s], rec.gyr[:, s], rec.rate_hz), "gravity in acc turns"


def _fastest(rec: RawRecording, s: int) -> float:
    """99th percentile of |gyr|; 0 without a finite sample."""
    size = np.linalg.norm(rec.gyr[:, s], axis=-1)
    size = size[np.isfinite(size)]
    return float(np.quantile(size, 0.99)) if len(size) else 0.0


def gyr_in_degrees(rec: RawRecording) -> bool:
    """Whether most sensors whose gyr can be checked turn 15 times too fast, or all implausibly fast."""
    ratios = [_gyr_ratio(rec, s)[0] for s in range(len(rec.sensors))]
    known = [r for r in ratios if r is not None]
    if known:
        return float(np.median(known)) > 15
    return max(_fastest(rec, s) for s in range(len(rec.sensors))) > FASTEST


def _gyroscope(path: Path, rec: RawRecording) -> list[str]:
    """Unit of gyr: against the rate of the orientation, else against how gravity moves in acc."""
    doubts = []
    for s, name in enumerate(rec.sensors):
        where = f"sensor {name}: gyr"
        ratio, by = _gyr_ratio(rec, s)
        fast = _fastest(rec, s)
        if (ratio is not None and ratio > 15) or (ratio is None and fast > FASTEST):
            found = f"{ratio:.0f} times what {by}" if ratio else f"up to {fast:.0f} rad/s"
            raise FormatError(path, f"{found}: in degrees (say units deg/s)?", where)
        if ratio is not None and ratio < 1 / 15:
            found = f"{1 / ratio:.0f} times less than {by}"
            raise FormatError(path, f"{found}: in rad already (say units rad/s)?", where)
        if ratio is not None and by.startswith("the") and not 0.5 < ratio < 2:
            doubts.append(f"{where}: {ratio:.2f} times the rate at which the orientation turns")
    return doubts


def rate_ratio(rec: RawRecording, s: int) -> float | None:
    """|gyr| over |rate of R_world_sensor| of sensor `s` where it turns most; None if it hardly does."""
    assert rec.R_world_sensor is not None
    R = rec.R_world_sensor[:, s]
    w = np.linalg.norm(ori.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]), axis=-1) * rec.rate_hz
    g = np.linalg.norm(rec.gyr[1:, s], axis=-1)
    ok = np.isfinite(w) & np.isfinite(g)
    if ok.sum() < 20:
        return None
    w, g = w[ok], g[ok]
    top = w >= np.quantile(w, 0.8)
    turning, measured = float(np.median(w[top])), float(np.median(g[top]))
    if turning < 0.3 or measured < 1e-4:
        return None
    return measured / turning


def _tilt_ratio(acc: Array, gyr: Array, rate_hz: float) -> float | None:
    """How many times larger gyr is than the turning of gravity in acc, or None where unclear.

    For slow motion d acc/dt = -gyr x acc; regressing the left on the right over smoothed signals
    gives 1/ratio. Only the order of magnitude counts.
    """
    n = max(3, round(0.5 * rate_hz))
    if len(acc) < 8 * n:
        return None
    a, w = smoothed(acc, n), smoothed(gyr, n)
    da = np.gradient(a, 1 / rate_hz, axis=0)
    turn = -np.cross(w, a)
    ok = np.isfinite(da).all(-1) & np.isfinite(turn).all(-1)
    if ok.sum() < 4 * n:
        return None
    da, turn = da[ok], turn[ok]
    xy, xx, yy = (da * turn).sum(), (turn * turn).sum(), (da * da).sum()
    if xx == 0 or yy == 0 or xy / np.sqrt(xx * yy) < 0.6:
        return None
    return float(xx / xy)


def smoothed(x: Array, n: int) -> Array:
    """Moving average over n samples along axis 0, run twice."""
    kernel = np.ones(n) / n
    for _ in range(2):
        x = np.stack([np.convolve(c, kernel, "same") for c in x.T], axis=1)
    return x


def _up(path: Path, rec: RawRecording) -> list[str]:
    """Whether R_world_sensor turns the mean specific force upright."""
    assert rec.R_world_sensor is not None
    force = np.einsum("tsij,tsj->tsi", rec.R_world_sensor, rec.acc)
    doubts = []
    for s, name in enumerate(rec.sensors):
        f = force[np.isfinite(force[:, s]).all(-1), s]
        if len(f) < rec.rate_hz:
            continue
        mean = f.mean(axis=0)
        tilt = np.rad2deg(np.arccos(np.clip(mean[1] / max(np.linalg.norm(mean), 1e-9), -1, 1)))
        where = f"sensor {name}: orientation"
        found = f"turns the mean acceleration to ({mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f})"
        if tilt > 60:
            raise FormatError(path, f"{found}, expected (0, {GRAVITY:.1f}, 0): y up", where)
        if tilt > 10:
            doubts.append(f"{where} {found} m/s^2, {tilt:.0f} deg off the vertical")
    return doubts


def calibrated(path: Path, rec: Recording) -> list[str]:
    """Warnings on a calibrated recording; raises FormatError where gravity is in or acc is in g."""
    doubts = gap_report(rec.valid, rec.sensors)
    for s, name in enumerate(rec.sensors):
        a = rec.acc_world[rec.acc_valid[:, s], s]
        if len(a) < rec.rate_hz:
            continue
        mean = a.mean(axis=0)
        where = f"sensor {name}: acc_world"
        found = f"mean ({mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f}) m/s^2"
        if np.linalg.norm(mean - [0, GRAVITY, 0]) < 2.5 or np.linalg.norm(mean) > 8:
            raise FormatError(path, f"{found}, expected about 0: gravity must be removed", where)
        if np.linalg.norm(mean) > 1.5:
            doubts.append(f"{where}: {found}, expected about 0 without gravity")
    return doubts + against_reference(path, rec)


def against_reference(path: Path, rec: Recording) -> list[str]:
    """Orientation and acceleration against a reference motion, where there is one."""
    if rec.reference is None:
        return []
    doubts = []
    R_ref = rec.reference.R_world_joint[:, rec.joint]
    use = rec.ori_valid
    for s, name in enumerate(rec.sensors):
        if use[:, s].any():
            off = ori.angle_between(rec.R_world_bone[use[:, s], s], R_ref[use[:, s], s])
            deg = float(np.rad2deg(np.median(off)))
            if deg > 30:
                doubts.append(f"sensor {name}: {deg:.0f} deg (median) from the reference's bone")
    ratio = _acc_ratio(rec)
    if ratio is not None and not 0.25 < ratio < 4:
        unit = ": in g (say units g)?" if 0.06 < ratio < 0.16 else ""
        raise FormatError(
            path, f"{ratio:.2g} times what the reference motion gives{unit}", "acc_world"
        )
    return doubts


def _acc_ratio(rec: Recording) -> float | None:
    """Slope of acc_world on the reference's accelerations, both relative to the pelvis and smoothed.

    Relative, because references without translation are known only so; None where they do not agree.
    """
    if rec.reference is None or len(rec) < rec.rate_hz or "pelvis" not in rec.sensors:
        return None
    root = rec.sensors.index("pelvis")
    p = sensor_positions(rec.reference, rec.joint, rec.placement)
    n = max(3, round(rec.rate_hz / 10))
    want = second_difference(p - p[:, [root]], rec.rate_hz)
    have = rec.acc_world - rec.acc_world[:, [root]]
    flat = (len(rec), -1)
    a, b = smoothed(have.reshape(flat), n), smoothed(want.reshape(flat), n)
    ok = np.isfinite(a) & np.isfinite(b)
    xy, xx, yy = (a[ok] * b[ok]).sum(), (b[ok] ** 2).sum(), (a[ok] ** 2).sum()
    # Still bodies tell nothing: their reference accelerates less than sensors err.
    if xx < 0.25 * ok.sum() or yy == 0 or xy / np.sqrt(xx * yy) < 0.5:
        return None
    return float(xy / xx)


def rates(R_world_sensor: Array, rate_hz: float) -> Array:
    """Angular rate (T,S,3) rad/s in the sensor's frame: Log(R_{t-1}^T R_t) rate_hz.

    A sample without a predecessor takes the rate towards its successor; without both it is NaN.
    """
    gyr = np.full(R_world_sensor.shape[:-1], np.nan)
    gyr[1:] = ori.log(np.swapaxes(R_world_sensor[:-1], -1, -2) @ R_world_sensor[1:]) * rate_hz
    lone = np.isnan(gyr[:-1, :, 0]) & np.isfinite(R_world_sensor[:-1, :, 0, 0])
    gyr[:-1][lone] = gyr[1:][lone]
    return gyr
