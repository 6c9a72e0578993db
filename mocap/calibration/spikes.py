"""Single samples that no sensor can have measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap.calibration.measures import WRONG_UNIT, gyr_ratio
from mocap.orientation import GRAVITY
from mocap.recording import Bool, RawRecording

# Of one axis: the widest ranges of sensors people wear are 4000 deg/s (70 rad/s) and 200 g.
MOST_GYR, MOST_ACC = 75.0, 200 * GRAVITY  # rad/s, m/s^2
USUAL_ACC = 20 * GRAVITY  # m/s^2: a median above is another unit (mg, cm/s^2)
RARE = 0.01  # of a sensor's samples: gyr beyond its range more often is another unit (deg/s)
LEAP = 0.5  # of its peak, from one sample to the next: movement, in whatever unit, takes several


@dataclass(frozen=True)
class Spike:
    """Samples of one sensor that none can have measured: their number, and time, quantity ("acc", "gyr"),
    and value (m/s^2, rad/s) of the first."""

    sensor: str
    count: int
    first_s: float
    what: str
    value: float


def without_spikes(raw: RawRecording) -> tuple[RawRecording, list[Spike]]:
    """`raw` with the samples that no sensor can have measured missing (NaN, not valid); one `Spike` a sensor.

    Where such values are the sensor's usual ones, its unit is wrong, and nothing is changed.
    """
    beyond = {"acc": np.zeros_like(raw.valid), "gyr": np.zeros_like(raw.valid)}
    with np.errstate(invalid="ignore"):
        for what, x, most in (("acc", raw.acc, MOST_ACC), ("gyr", raw.gyr, MOST_GYR)):
            beyond[what] = raw.valid & (np.abs(x) > most).any(axis=-1)
    for s in range(len(raw.sensors)):
        if beyond["acc"][:, s].any():
            size = np.linalg.norm(raw.acc[raw.valid[:, s], s], axis=-1)
            beyond["acc"][:, s] &= bool(np.median(size) < USUAL_ACC)
        if beyond["gyr"][:, s].any():
            beyond["gyr"][:, s] &= _stray(raw, s, beyond["gyr"][:, s])
    bad: Bool = beyond["acc"] | beyond["gyr"]
    if not bad.any():
        return raw, []
    found = []
    for s in map(int, np.flatnonzero(bad.any(axis=0))):
        t, n = int(bad[:, s].argmax()), int(bad[:, s].sum())
        what = "acc" if beyond["acc"][t, s] else "gyr"
        values = getattr(raw, what)[t, s]
        value = float(values[np.abs(values).argmax()])
        found.append(Spike(raw.sensors[s], n, raw.start_s + t / raw.rate_hz, what, value))
    gyr, acc = (np.where(bad[..., None], np.nan, x) for x in (raw.gyr, raw.acc))
    return replace(raw, gyr=gyr, acc=acc, valid=raw.valid & ~bad), found


def _stray(raw: RawRecording, s: int, beyond: Bool) -> bool:
    """Whether gyr `beyond` (T,) its range is rare, comes and goes at a leap, and is no turning in deg/s."""
    gyr = raw.gyr[:, s]
    if beyond.sum() > max(1, RARE * raw.valid[:, s].sum()):
        return False
    for a, b in np.flatnonzero(np.diff(np.r_[False, beyond, False])).reshape(-1, 2):
        peak = np.linalg.norm(gyr[a:b], axis=-1).max()
        for inside, outside in ((a, a - 1), (b - 1, b)):
            known = 0 <= outside < len(gyr) and raw.valid[outside, s]
            if known and np.linalg.norm(gyr[inside] - gyr[outside]) < LEAP * peak:
                return False
    rest = raw.gyr.copy()
    rest[beyond, s] = np.nan
    ratio = gyr_ratio(replace(raw, gyr=rest), s)[0]
    return ratio is None or ratio < WRONG_UNIT
