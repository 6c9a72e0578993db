"""What gravity and orientation say of the units of acc and gyr: shared by readers and diagnostics."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording

FASTEST = 60.0  # rad/s: no limb turns faster, no usual gyroscope measures it
DEG = np.pi / 180
STILL_WINDOW_S = 0.5
STILL_SPREAD = 0.05  # of the reading, within the window
MEAN_S = 0.125  # gyr and the rate of the orientation are compared as means over this time
TURNING = 0.15  # rad/s, rms: below, the two are not compared
AGREES = 0.9  # correlation of the two, above which their ratio means something
TILT_AGREES = 0.6  # the same of gyr and the turning of gravity in acc
WRONG_UNIT = 15  # times too large or too small: no scale, a unit
# Of |acc|, what the mean over half a second keeps: nearly all of gravity, little of noise and movement.
KEPT = 0.7


def stillest(acc: Array, rate_hz: float) -> tuple[Array, Array]:
    """Mean |acc| and spread of acc in each sensor's stillest half second: (S,), (S,), NaN where none."""
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

    acc (T,S,3). Still: the spread within half a second is below 5 % of the reading.
    """
    size, spread = stillest(acc, rate_hz)
    with np.errstate(invalid="ignore"):
        return np.where(spread < STILL_SPREAD * size, size, np.nan)


def usual_force(acc: Array, rate_hz: float) -> tuple[Array, Array]:
    """Medians of |mean acc| over half seconds and of |acc| over samples: (S,), (S,); acc (T,S,3), any unit.

    The first is about gravity however a person moves, who is not accelerated one way for long; far below
    the second (`KEPT`) there is no gravity in acc. NaN under 2 s of samples, and where all are zero.
    """
    n = max(1, round(STILL_WINDOW_S * rate_hz))
    sizes = np.full((2, acc.shape[1]), np.nan)
    for s in range(acc.shape[1]):
        known = acc[np.isfinite(acc[:, s]).all(axis=-1), s]
        if len(known) >= 2 * rate_hz and known.any():
            sizes[0, s] = np.median(np.linalg.norm(means(known, n), axis=-1))
            sizes[1, s] = np.median(np.linalg.norm(known, axis=-1))
    return sizes[0], sizes[1]


def still_gravity(gyr: Array, acc: Array) -> tuple[float, float]:
    """Median |acc| of the tenth of the samples (T,3) with the slowest rotation, and its median deviation."""
    rate = np.linalg.norm(gyr, axis=1)
    size = np.linalg.norm(acc[rate <= np.percentile(rate, 10)], axis=1)
    median = float(np.median(size))
    return median, float(np.median(np.abs(size - median)))


def constant_force(gyr: Array, acc: Array, rate_hz: float) -> float:
    """Median |mean acc| over half seconds, of the tenth of them (of (T,3)) with the slowest rotation.

    Gravity stays in the mean, whereas noise and shaking, which |acc| holds as well, do not.
    """
    n = max(4, round(STILL_WINDOW_S * rate_hz))
    rate = uniform_filter1d(np.linalg.norm(gyr, axis=1), n, axis=0)
    size = np.linalg.norm(uniform_filter1d(acc, n, axis=0), axis=1)
    return float(np.median(size[rate <= np.percentile(rate, 10)]))


def mean_force(raw: RawRecording) -> Array:
    """(S,3) mean of R_world_sensor acc, about (0, 9.81, 0); NaN without orientation or under 2 s."""
    out = np.full((len(raw.sensors), 3), np.nan)
    if raw.R_world_sensor is None:
        return out
    force = np.einsum("tsij,tsj->tsi", raw.R_world_sensor, raw.acc)
    ok = np.isfinite(force).all(-1)
    for s in np.flatnonzero(ok.sum(axis=0) >= 2 * raw.rate_hz):
        out[s] = force[ok[:, s], s].mean(axis=0)
    return out


def fastest(raw: RawRecording, s: int) -> float:
    """99th percentile of |gyr| of sensor `s`, rad/s; 0 without a finite sample."""
    size = np.linalg.norm(raw.gyr[:, s], axis=-1)
    size = size[np.isfinite(size)]
    return float(np.quantile(size, 0.99)) if len(size) else 0.0


def turning(gyr: Array, R: Array, has: Bool, rate_hz: float) -> tuple[Array, Array]:
    """Rate of R (T,3,3) and gyr (T,3), both in the sensor's frame, as means over `MEAN_S`: (N,3), (N,3).

    rate_t = Log(R_{t-1}^T R_t) rate_hz; where `has` (T,) is False on either side, both are zero.
    """
    pair = has[1:] & has[:-1]
    rate = np.zeros_like(gyr)
    rate[1:][pair] = ori.log(np.swapaxes(R[:-1][pair], -1, -2) @ R[1:][pair]) * rate_hz
    n = max(1, round(MEAN_S * rate_hz))
    used = np.where(np.r_[False, pair][:, None], np.nan_to_num(gyr), 0.0)
    return means(rate, n), means(used, n)


def rate_ratio(raw: RawRecording, s: int) -> float | None:
    """|gyr| over |rate of R_world_sensor| of sensor `s`: median over the fifth of the time with most turning.

    None where it hardly turns, or where the two disagree in direction (correlation below `AGREES`), so
    that their axes are in doubt rather than their sizes.
    """
    if raw.R_world_sensor is None:
        return None
    R = raw.R_world_sensor[:, s]
    has: Bool = np.isfinite(R).all((-1, -2)) & np.isfinite(raw.gyr[:, s]).all(-1)  # type: ignore[assignment]
    if has.sum() < 20:
        return None
    w, g = turning(raw.gyr[:, s], R, has, raw.rate_hz)
    ww, gg, wg = (w * w).sum(), (g * g).sum(), (w * g).sum()
    if ww < TURNING**2 * len(w) or gg == 0 or wg < AGREES * np.sqrt(ww * gg):
        return None
    turns, measured = np.linalg.norm(w, axis=1), np.linalg.norm(g, axis=1)
    top = turns + measured >= np.quantile(turns + measured, 0.8)
    return float(np.median(measured[top] / np.maximum(turns[top], 1e-9)))


def tilt_ratio(acc: Array, gyr: Array, rate_hz: float) -> float | None:
    """How many times larger gyr (T,3) is than the turning of gravity in acc (T,3), or None where unclear.

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
    if xx == 0 or yy == 0 or xy / np.sqrt(xx * yy) < TILT_AGREES:
        return None
    return float(xx / xy)


def gyr_ratio(raw: RawRecording, s: int) -> tuple[float | None, str]:
    """How many times larger gyr is than what it should measure, and by what that is known."""
    ratio = rate_ratio(raw, s)
    if ratio is not None:
        return ratio, "the orientation turns"
    return tilt_ratio(raw.acc[:, s], raw.gyr[:, s], raw.rate_hz), "gravity in acc turns"


def means(x: Array, n: int) -> Array:
    """Means of consecutive blocks of n rows."""
    m = len(x) // n
    return x[: m * n].reshape(m, n, -1).mean(axis=1)


def smoothed(x: Array, n: int) -> Array:
    """Moving average over n samples along axis 0, run twice; NaN spreads no further than the kernel."""
    kernel = np.ones(n) / n
    for _ in range(2):
        x = np.stack([np.convolve(c, kernel, "same") for c in x.T], axis=1)
    return x
