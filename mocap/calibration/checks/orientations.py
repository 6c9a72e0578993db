"""Orientations that were written or read the wrong way: transposed, quaternions rolled, another world.

A reading of R_world_sensor is right if gyr is the rate at which it turns and if it turns acc upright, in
the mean. Both say so of the right one alone: transposing or rolling makes the rate another one, except
for sensors that hardly turn, of which nothing is said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.calibration.axes import from_up, relative
from mocap.calibration.evidence import Evidence
from mocap.calibration.measures import TURNING, turning
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import Bool

# Mean square over g^2 of acc's distance from upright, and square of gyr's relative distance from the rate,
# that leave no doubt of the reading given, and that another reading must reach to be named.
WELL_UP, WELL_RATE = 0.03, 0.16
UP, RATE = 0.05, 0.12
MIN_WINDOWS = 4  # the rate tells, too
GAIN = 4.0  # by how much the sum of the two must fall


def _transposed(R: Array) -> Array:
    return np.swapaxes(R, -1, -2)


def _rolled(R: Array, by: int) -> Array:
    """R (...,3,3) if the four numbers of its quaternions (w, x, y, z) are rolled by that many places."""
    out = np.full(R.shape, np.nan)
    has = np.isfinite(R).all((-1, -2))
    out[has] = ori.from_quat(np.roll(ori.to_quat(R[has]), by, axis=-1))
    return out


@dataclass(frozen=True)
class Reading:
    """How an orientation may have been written: a mistake, and the world that is up in it (None: ours)."""

    code: str
    mistake: str
    up: str | None = None


MENDS: tuple[tuple[Reading, Callable[[Array], Array]], ...] = (
    (Reading("orientation-transposed", "transposed"), _transposed),
    (Reading("quaternion-order", "wxyz-taken"), lambda R: _rolled(R, 1)),
    (Reading("quaternion-order", "xyzw-taken"), lambda R: _rolled(R, -1)),
)


@dataclass(frozen=True)
class Wrong:
    """What explains a sensor's data better than the orientation given: up_deg, acc's mean distance from
    upright, rate_off, gyr's relative one from the rate, both as given."""

    reading: Reading
    up_deg: float
    rate_off: float


def check(evidence: Evidence) -> list[Finding]:
    """An error for each sensor whose orientation was written or read in another way.

    By the likely rate and scale of gyr (`Evidence.rates`).
    """
    found = []
    R_all, rates = evidence.raw.R_world_sensor, evidence.rates
    if R_all is None:
        return []
    for k, (s, name) in enumerate(evidence.each):
        gyr, acc, ok = evidence.channels(s)
        has = ok & np.isfinite(R_all[:, s]).all((-1, -2))
        wrong = explained(gyr * rates.factor[k], acc, R_all[:, s], has, rates.rate_hz)
        if wrong is not None:
            details = {
                "up_deg": wrong.up_deg,
                "rate_off": wrong.rate_off,
                "mistake": wrong.reading.mistake,
                "up": wrong.reading.up,
            }
            found.append(Finding("error", name, wrong.reading.code, wrong.up_deg, details))
    return found


def explained(gyr: Array, acc: Array, R: Array, has: Bool, rate_hz: float) -> Wrong | None:
    """What explains gyr and acc (T,3) if R (T,3,3) of one sensor does not; None if it does or nothing is.

    Files whose world is z-up were turned into ours, before or instead of what mends them.
    """
    given = _score(gyr, acc, R, has, rate_hz)
    if given is None or (given[0] < WELL_UP and given[1] < WELL_RATE):
        return None
    tried: list[tuple[float, Reading]] = []
    zup = ori.R_YUP_ZUP
    for reading, mend in MENDS:
        for before in (np.eye(3), zup.T):
            mended = mend(before @ R)
            for after in (np.eye(3), zup):
                tried += _tried(reading, given, _score(gyr, acc, after @ mended, has, rate_hz))
    for axis, world in (("z", zup), ("-z", zup.T)):
        reading = Reading("orientation-world", "world", axis)
        tried += _tried(reading, given, _score(gyr, acc, world @ R, has, rate_hz))
    if not tried:
        return None
    reading = min(tried, key=lambda score: score[0])[1]
    up = float(np.degrees(2 * np.arcsin(min(1.0, np.sqrt(given[0]) / 2))))
    return Wrong(reading, up, float(np.sqrt(given[1])))


def _score(
    gyr: Array, acc: Array, R: Array, has: Bool, rate_hz: float
) -> tuple[float, float] | None:
    """Mean square over g^2 of acc's distance from upright, square of gyr's relative one from the rate.

    None where the sensor hardly turns, or there is too little of it.
    """
    wanders = from_up(R, acc, has, rate_hz, MIN_WINDOWS)
    w, g = turning(gyr, R, has, rate_hz)
    if wanders is None or (g**2).sum() < TURNING**2 * len(g):
        return None
    return float(wanders[0].mean()), relative(g, w) ** 2


def _tried(
    reading: Reading, given: tuple[float, float], score: tuple[float, float] | None
) -> list[tuple[float, Reading]]:
    """The reading with the sum of its score, if that explains what `given` does not."""
    if score is None or score[0] > UP or score[1] > RATE or sum(given) < GAIN * sum(score):
        return []
    return [(sum(score), reading)]
