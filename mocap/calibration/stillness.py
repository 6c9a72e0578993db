"""How fast the whole body turns, and when it is still: from gyroscopes alone."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtri

from mocap.errors import CalibrationError
from mocap.orientation import Array
from mocap.recording import RawRecording

SMOOTH_S = 0.4  # rates are averaged over this time: tremor and soft tissue are not movement
STILL_RATE = 0.12  # rad/s: standing people sway below 5 deg/s, slow limb movements exceed 10
# Of the rate that noisy gyroscopes alone leave: below, a frame counts as still.
NOISE_QUANTILE = 0.999
NOISE_S = 1.0  # the gyroscopes' noise is taken where it is least over this time
MIN_S = 0.5  # shortest still run that counts


def stillness(raw: RawRecording, smooth_s: float = SMOOTH_S) -> Array:
    """Rate of rotation of the whole body (T,), rad/s: rms over sensors of |smoothed gyr|.

    The mean over smooth_s keeps net rotation and removes tremor. Invalid samples do not count; frames
    without any valid sensor are infinite.
    """
    n = max(1, round(smooth_s * raw.rate_hz))
    weight = uniform_filter1d(raw.valid.astype(float), n, axis=0)
    gyr = np.where(raw.valid[..., None], np.nan_to_num(raw.gyr), 0.0)
    smooth = uniform_filter1d(gyr, n, axis=0) / np.maximum(weight, 1e-9)[..., None]
    rate = np.linalg.norm(smooth, axis=-1)
    has = weight > 0.3
    count = has.sum(axis=1)
    mean = np.sqrt(np.where(has, rate**2, 0.0).sum(axis=1) / np.maximum(count, 1))
    return np.where(count > 0, mean, np.inf)


def threshold(raw: RawRecording, rate: Array) -> float:
    """Limit (rad/s) of `stillness` (`rate`, of `raw`) below which the body counts as still.

    STILL_RATE, or more where people tremble, or where the gyroscopes' noise alone exceeds it (skin that
    wobbles counts as such). White noise of variance v per axis and sample, averaged over n samples,
    leaves the mean square of 3 S normal numbers of variance v / n in three axes of S sensors: 3 v / n
    times a chi-square of 3 S degrees of freedom over 3 S, which scatters more the fewer sensors there are.
    """
    dof = 3 * max(1, int(raw.valid.any(axis=0).sum()))
    scatter = np.sqrt(chdtri(dof, 1 - NOISE_QUANTILE) / dof)
    return max(sway(rate), float(scatter) * _noise_rate(raw))


def sway(rate: Array) -> float:
    """STILL_RATE, or more where the calmest moments are not that calm, rad/s."""
    return max(STILL_RATE, 1.6 * float(np.percentile(rate[np.isfinite(rate)], 2)))


def _noise_rate(raw: RawRecording) -> float:
    """What the gyroscopes' noise leaves in `stillness`, rad/s, root mean square; 0 where it cannot be told.

    White noise e_t of variance v changes by |e_t - e_{t-1}|^2 = 2 v from sample to sample, by more than
    people do when they stand: v is taken over the NOISE_S in which that is least. Noise that takes back
    what it turned, such as a wobble, leaves less.
    """
    n, span = (max(1, round(s * raw.rate_hz)) for s in (SMOOTH_S, NOISE_S))
    both = raw.valid[1:] & raw.valid[:-1]
    change = np.where(both[..., None], np.diff(np.nan_to_num(raw.gyr), axis=0), 0.0)
    if len(both) < span:
        return 0.0
    square, count = (
        np.convolve(x, np.ones(span), mode="valid")
        for x in ((change**2).sum(axis=(1, 2)), both.sum(axis=1).astype(float))
    )
    enough = count > 0.5 * count.max()
    if not enough.any():
        return 0.0
    return float(np.sqrt((square[enough] / count[enough]).min() / 2 / n))


def still_runs(raw: RawRecording) -> list[tuple[int, int]]:
    """All runs [start, stop) of at least MIN_S in which the whole body is still, first to last."""
    rate = stillness(raw)
    if not np.isfinite(rate).any():
        raise CalibrationError("no frame has a valid sensor")
    still = rate < threshold(raw, rate)
    edges = np.flatnonzero(np.diff(np.r_[False, still, False])).reshape(-1, 2)
    return [(int(a), int(b)) for a, b in edges if b - a >= MIN_S * raw.rate_hz]
