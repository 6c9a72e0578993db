"""The sampling rate, and the scale of each gyroscope: how fast orientation and gravity turn, against gyr.

A rate that is k times too high makes every orientation turn k times as fast as gyr says. Without orientation,
gyr is carried too far or not far enough by the wrong time step, and gravity wanders in all sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap.calibration.checks.axes import WANDERS, stretches, wandering_if_scaled
from mocap.calibration.checks.units import DEG, rate_ratio
from mocap.calibration.fusion import bridged
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording

OFF = float(np.log(1.1))  # of the ratio of the two rates: doubted above
FAR = float(np.log(1.25))  # an error above, if of one sensor alone
UNIT = float(np.log(1.3))  # around 180/pi and pi/180: a unit, not a scale
MOST = 2 / 3  # of the sensors that can tell, must agree
SCALES = (0.5, 2.0)  # tried where there is no orientation
GAIN = 2.0  # by which the wandering of gravity must fall then, over all sensors together
HELPS = 1.2  # and by which in most of them
WINDOWS = 30  # per sensor; those with most turning


@dataclass(frozen=True, eq=False)
class Rates:
    """What was found, and by which one may go on: the likely rate, and factors (S,) that mend gyr."""

    findings: list[Finding]
    rate_hz: float
    factor: Array


def check_rates(raw: RawRecording) -> Rates:
    """The sampling rate of `raw`, whose acc is in m/s^2, and the scales of its gyroscopes."""
    if raw.R_world_sensor is None:
        return _by_gravity(raw)
    return _by_orientation(raw)


def _by_orientation(raw: RawRecording) -> Rates:
    S = len(raw.sensors)
    ratio = np.array([rate_ratio(raw, s) or np.nan for s in range(S)])
    off = np.log(ratio)
    # Degrees for radians, or the other way round, is told by the checks of axes and units.
    off[np.abs(np.abs(off) - np.log(1 / DEG)) < UNIT] = np.nan
    known = np.flatnonzero(np.isfinite(off))
    factor = np.ones(S)
    if not len(known):
        return Rates([], raw.rate_hz, factor)
    median = float(np.median(off[known]))
    same = np.abs(off[known] - median) < OFF
    found: list[Finding] = []
    if abs(median) > OFF and len(known) > 1 and same.mean() >= MOST:
        found.append(_rate(raw, float(np.exp(median)), "their orientations turn"))
        off -= median
    else:
        median = 0.0
    for s in known:
        if abs(off[s]) > OFF:
            factor[s] = np.exp(-off[s])
            found.append(_scale(raw, int(s), float(np.exp(off[s])), abs(off[s]) > FAR))
    return Rates(found, raw.rate_hz * float(np.exp(median)), factor)


def _by_gravity(raw: RawRecording) -> Rates:
    """One factor of gyr for all sensors, of `SCALES`, with which gravity wanders clearly less."""
    each = []
    for s in range(len(raw.sensors)):
        ok = raw.valid[:, s]
        if ok.sum() < 2 * raw.rate_hz:
            continue
        gyr, acc = bridged(raw.gyr[:, s], ok), bridged(raw.acc[:, s], ok)
        windows = stretches(gyr, acc, ok, raw.rate_hz, WINDOWS)
        if windows is not None:
            each.append([wandering_if_scaled(windows, f).mean() for f in (1.0, *SCALES)])
    right = Rates([], raw.rate_hz, np.ones(len(raw.sensors)))
    if len(each) < 2:
        return right
    wander = np.array(each)
    mean = wander.mean(axis=0)
    best = int(mean.argmin())
    helped = wander[:, 0] > HELPS * wander[:, best]
    if mean[0] < WANDERS or mean[0] < GAIN * mean[best] or helped.mean() < MOST:
        return right
    ratio = 1 / SCALES[best - 1]
    found = [_rate(raw, ratio, "gravity turns in acc")]
    return Rates(found, raw.rate_hz * ratio, right.factor)


def _rate(raw: RawRecording, ratio: float, what: str) -> Finding:
    """gyr of most sensors is `ratio` times what turns: time steps are taken for `ratio` times as long."""
    rate = raw.rate_hz * ratio
    text = (
        f"the sampling rate is probably {rate:.3g} Hz, not {raw.rate_hz:.4g} (or all gyr is scaled "
        f"by {ratio:.2f}): by this rate {what} {1 / ratio:.2f} times as fast as gyr says"
    )
    return Finding("error", None, "sampling-rate", text, rate)


def _scale(raw: RawRecording, s: int, ratio: float, far: bool) -> Finding:
    name = raw.sensors[s]
    text = (
        f"sensor {name}: gyr is {ratio:.2f} times the rate at which its orientation turns: the scale of its "
        f"gyroscope is off"
    )
    if len(raw.sensors) == 1:
        text += f", or the sampling rate is {raw.rate_hz * ratio:.3g} Hz"
    return Finding("error" if far else "warning", name, "gyr-scale", text, ratio)
