"""The sampling rate, and the scale of each gyroscope: how fast orientation and gravity turn, against gyr.

A rate that is k times too high makes every orientation turn k times as fast as gyr says. Without orientation,
gyr is carried too far or not far enough by the wrong time step, and gravity wanders in all sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mocap.calibration.axes import WANDERS, stretches, wandering_if_scaled
from mocap.calibration.fusion import bridged
from mocap.calibration.measures import DEG, rate_ratio
from mocap.orientation import Array
from mocap.recording import RawRecording

OFF = float(np.log(1.1))  # of the ratio of the two rates: doubted above
UNIT = float(np.log(1.3))  # around 180/pi and pi/180: a unit, not a scale
MOST = 2 / 3  # of the sensors that can tell, must agree
SCALES = (0.5, 2.0)  # tried where there is no orientation
GAIN = 2.0  # by which the wandering of gravity must fall then, over all sensors together
HELPS = 1.2  # and by which in most of them
WINDOWS = 30  # per sensor; those with most turning


@dataclass(frozen=True, eq=False)
class Rates:
    """rate_hz: the likely rate. factor (S,): mends the scale of each gyr.

    ratio: of gyr to what turns, in all sensors alike; 1 where the rate is as stated. by: what turns, the
    "orientation" or "gravity". scales: the same of single sensors whose scale is off, by name.
    """

    rate_hz: float
    factor: Array
    ratio: float = 1.0
    by: Literal["orientation", "gravity"] = "orientation"
    scales: Mapping[str, float] = field(default_factory=dict)


def measure(raw: RawRecording) -> Rates:
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
        return Rates(raw.rate_hz, factor)
    median = float(np.median(off[known]))
    same = np.abs(off[known] - median) < OFF
    if not (abs(median) > OFF and len(known) > 1 and same.mean() >= MOST):
        median = 0.0
    off -= median
    scales = {}
    for s in known:
        if abs(off[s]) > OFF:
            factor[s] = np.exp(-off[s])
            scales[raw.sensors[s]] = float(np.exp(off[s]))
    common = float(np.exp(median))
    return Rates(raw.rate_hz * common, factor, common, "orientation", scales)


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
    right = Rates(raw.rate_hz, np.ones(len(raw.sensors)))
    if len(each) < 2:
        return right
    wander = np.array(each)
    mean = wander.mean(axis=0)
    best = int(mean.argmin())
    helped = wander[:, 0] > HELPS * wander[:, best]
    if mean[0] < WANDERS or mean[0] < GAIN * mean[best] or helped.mean() < MOST:
        return right
    ratio = 1 / SCALES[best - 1]
    return Rates(raw.rate_hz * ratio, right.factor, ratio, "gravity")
