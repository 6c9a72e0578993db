"""Units and axes of a recording, held against gravity, its own orientation and a reference.

A contradiction raises FormatError naming file, sensor and field; a doubt is returned as a text for
`Document.warnings`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Options
from mocap.formats._checks import gap_report, half_report, smoothed
from mocap.orientation import GRAVITY, Array
from mocap.recording import RawRecording, Recording
from mocap.synthesis import second_difference, sensor_positions

STILL_WINDOW_S = 0.5
LIMB_SPEED = 6.0  # m/s: between two ends of a swing
FASTEST = 60.0  # rad/s: no limb turns faster, few gyroscopes measure it


def factors(options: Options) -> tuple[float, float]:
    """Factors of acc to m/s^2 and of gyr to rad/s, where the user says that a file, against its format,
    has them in g or deg/s."""
    return (
        GRAVITY if "g" in options.units else 1.0,
        np.pi / 180 if "deg/s" in options.units else 1.0,
    )


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
    if rec.R_world_sensor is not None:
        has = np.asarray(np.isfinite(rec.R_world_sensor).all(axis=(-1, -2)), bool)
        doubts += half_report(rec.valid & ~has, rec.sensors, "orientation")
    doubts += _accelerometer(path, rec)
    doubts += _gyroscope(path, rec)
    doubts += _up(path, rec)
    return doubts


def _accelerometer(path: Path, rec: RawRecording) -> list[str]:
    """Size of gravity: when still, else as the mean of what the orientation turns into the world."""
    still = gravity_size(rec.acc, rec.rate_hz)
    mean = np.linalg.norm(_mean_force(rec), axis=-1)
    doubts = []
    for s, name in enumerate(rec.sensors):
        size, when = (still[s], "when still") if np.isfinite(still[s]) else (mean[s], "on average")
        if not np.isfinite(size):
            continue
        where = f"sensor {name}: acc"
        off = abs(size / GRAVITY - 1)
        if off > (0.15 if when == "when still" else 0.4):
            raise FormatError(
                path, f"{size:.3g} {when}, expected {GRAVITY:.2f} m/s^2{_guess(size)}", where
            )
        if off > 0.05 and when == "when still":
            doubts.append(f"{where}: {size:.2f} m/s^2 {when}, expected {GRAVITY:.2f}")
    if not (np.isfinite(still) | np.isfinite(mean)).any() and np.isfinite(rec.acc).any():
        doubts.append("no sensor is ever still for half a second: the unit of acc is not checked")
    return doubts


def _guess(size: float) -> str:
    """What explains an accelerometer that reads `size` where gravity alone acts."""
    if abs(size - 1) < 0.3:
        return ", so the unit is g (--units g)"
    if abs(size / GRAVITY**2 - 1) < 0.3:
        return ", so it was m/s^2 already (--units m/s^2)"
    if abs(size - 1000) < 300:
        return ", so the unit is mg"
    return ", so gravity was removed, and raw acceleration must hold it" if size < 0.5 else ""


def _mean_force(rec: RawRecording) -> Array:
    """(S,3) mean of R_world_sensor acc, about (0, 9.81, 0); NaN without orientation or under 2 s."""
    out = np.full((len(rec.sensors), 3), np.nan)
    if rec.R_world_sensor is None:
        return out
    force = np.einsum("tsij,tsj->tsi", rec.R_world_sensor, rec.acc)
    ok = np.isfinite(force).all(-1)
    for s in np.flatnonzero(ok.sum(axis=0) >= 2 * rec.rate_hz):
        out[s] = force[ok[:, s], s].mean(axis=0)
    return out


def _swing(rec: RawRecording | Recording) -> float:
    """What the mean acceleration of a limb may be, m/s^2: its change of speed over the time."""
    return 1.0 + LIMB_SPEED / rec.seconds


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
            raise FormatError(path, f"{found}: in degrees (--units deg/s)?", where)
        if ratio is not None and ratio < 1 / 15:
            found = f"{1 / ratio:.0f} times less than {by}"
            raise FormatError(path, f"{found}: in rad already (--units rad/s)?", where)
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


def _up(path: Path, rec: RawRecording) -> list[str]:
    """Whether R_world_sensor turns the mean specific force upright."""
    doubts = []
    for name, mean in zip(rec.sensors, _mean_force(rec), strict=True):
        if not np.isfinite(mean).all():
            continue
        tilt = np.rad2deg(np.arccos(np.clip(mean[1] / max(np.linalg.norm(mean), 1e-9), -1, 1)))
        where = f"sensor {name}: orientation"
        found = f"turns the mean acceleration to ({mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f})"
        if tilt > 60:
            raise FormatError(path, f"{found}, expected (0, {GRAVITY:.1f}, 0): y up", where)
        if np.hypot(mean[0], mean[2]) > _swing(rec):
            doubts.append(f"{where} {found} m/s^2, {tilt:.0f} deg off the vertical")
    return doubts


def missing(rec: Recording) -> list[str]:
    """The warnings about samples that are missing, in whole or in part."""
    # A second difference has no value at either end, and some sensors measure orientation alone.
    half = rec.valid & ~rec.acc_valid & rec.acc_valid.any(axis=0)
    half[[0, -1]] = False
    return [
        *gap_report(rec.valid, rec.sensors),
        *half_report(rec.valid & ~rec.ori_valid, rec.sensors, "orientation"),
        *half_report(half, rec.sensors, "acceleration"),
    ]


def calibrated(path: Path, rec: Recording) -> list[str]:
    """Warnings on a calibrated recording; raises FormatError where gravity is in or acc is in g."""
    doubts = missing(rec)
    for s, name in enumerate(rec.sensors):
        a = rec.acc_world[rec.acc_valid[:, s], s]
        if len(a) < 2 * rec.rate_hz:
            continue
        mean = a.mean(axis=0)
        where = f"sensor {name}: acc_world"
        found = f"mean ({mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f}) m/s^2"
        if np.linalg.norm(mean - [0, GRAVITY, 0]) < 2.5 or np.linalg.norm(mean) > 8:
            raise FormatError(path, f"{found}, expected about 0: gravity must be removed", where)
        if np.linalg.norm(mean) > _swing(rec):
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
        unit = ": in g (--units g)?" if 0.06 < ratio < 0.16 else ""
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
