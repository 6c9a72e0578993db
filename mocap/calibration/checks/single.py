"""What the sensors' own data betray: units, clipping, dead channels, rates, axes.

The checks of axes are in `checks.axes`, those of an orientation that was written the wrong way in
`checks.orientations`, of the rate in `checks.rates`, of channels in `checks.channels`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap.calibration.checks.axes import check_axes
from mocap.calibration.checks.channels import check_channels, unmeasured, without_spikes
from mocap.calibration.checks.orientations import check_orientation
from mocap.calibration.checks.rates import check_rates
from mocap.calibration.checks.units import KEPT, constant_force, still_gravity
from mocap.calibration.fusion import bridged
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording

GRAVITY_RANGE = (9.3, 10.3)  # m/s^2: more than bias and scale of any usual sensor
RESTLESS = 0.35  # m/s^2: above, the sensor never rests; white noise of that size leaves 0.24
RESTLESS_RANGE = (3.0, 25.0)  # m/s^2: what limbs have at their slowest, even in running and jumping
NOTHING = 0.6  # m/s^2 (or g): a still sensor that reads less has no gravity


def check_sensors(raw: RawRecording) -> list[Finding]:
    """All checks of the sensors' own data: those of one sensor each, then those that compare sensors."""
    raw, found = without_spikes(raw)
    sound: list[str] = []
    for s, name in enumerate(raw.sensors):
        ok = raw.valid[:, s]
        lacking = _lacking(raw, s)
        if lacking:
            found.append(Finding("error", name, "no-data", lacking, float(ok.sum())))
            continue
        gyr, acc = bridged(raw.gyr[:, s], ok), bridged(raw.acc[:, s], ok)
        gravity = _gravity(name, gyr, acc, raw.rate_hz)
        found += gravity
        found += _clipping(name, "acc", acc) + _clipping(name, "gyr", gyr)
        if not any(f.severity == "error" for f in gravity):
            sound.append(name)
    dead = check_channels(raw)
    found += dead
    gone = {f.sensor for f in dead if f.code == "frozen" and f.severity == "error"}
    use = tuple(n for n in sound if n not in gone)
    return found + (_turning(raw.select(use)) if use else [])


def _lacking(raw: RawRecording, s: int) -> str:
    """What there is too little of to judge sensor `s`; empty where nothing is missing."""
    head, leave = f"sensor {raw.sensors[s]}: ", "leave the sensor out (--sensors)"
    absent = unmeasured(raw, s)
    if absent:
        return f"{head}no sample of {' and '.join(absent)}, both acc and gyr are needed: {leave}"
    # A sample counts where gyr and acc are both there.
    count, least = int(raw.valid[:, s].sum()), int(np.ceil(raw.rate_hz))
    if count < least:
        return f"{head}only {count} valid samples, {least} (1 s) are needed: {leave}"
    return ""


def _turning(raw: RawRecording) -> list[Finding]:
    """Rate, orientation and axes of sensors whose acc is known to be in m/s^2."""
    rates = check_rates(raw)
    found = list(rates.findings)
    # What follows goes by the likely rate and scale: either would look like wrong axes.
    raw = replace(raw, rate_hz=rates.rate_hz)
    for s, name in enumerate(raw.sensors):
        ok = raw.valid[:, s]
        gyr, acc = bridged(raw.gyr[:, s], ok) * rates.factor[s], bridged(raw.acc[:, s], ok)
        R = None if raw.R_world_sensor is None else raw.R_world_sensor[:, s]
        if R is not None:
            has = ok & np.isfinite(R).all((-1, -2))
            wrong = check_orientation(name, gyr, acc, R, has, raw.rate_hz)
            if wrong is not None:
                found.append(wrong)
                continue
        found += check_axes(name, gyr, acc, R, ok, raw.rate_hz)
    return found


def _gravity(name: str, gyr: Array, acc: Array, rate_hz: float) -> list[Finding]:
    """Is a still sensor's |acc| 9.81, and if not, in which unit would it be?"""
    g, deviation = still_gravity(gyr, acc)
    if GRAVITY_RANGE[0] <= g <= GRAVITY_RANGE[1]:
        return []
    head = f"sensor {name}: a still sensor reads {g:.3g}, expected 9.81 m/s^2: "
    constant = constant_force(gyr, acc, rate_hz)
    if constant < NOTHING or (g < GRAVITY_RANGE[0] and constant < KEPT * g):
        why = (
            f"gravity seems to be removed already ({constant:.2g} in the mean over half a second), and the "
            f"specific force with gravity is needed"
        )
        return [Finding("error", name, "acc-without-gravity", head + why, constant)]
    if 0.9 <= g <= 1.1:
        return [Finding("error", name, "acc-in-g", head + "acc is in g, multiply by 9.80665", g)]
    if 930 <= g <= 1030:
        why = "acc is in mg or cm/s^2, divide by 1000/9.80665 or by 100"
        return [Finding("error", name, "acc-unit", head + why, g)]
    # A sensor that never rests reads more than g, by as much as it is shaken, or less where it falls.
    if deviation > RESTLESS and RESTLESS_RANGE[0] <= g <= RESTLESS_RANGE[1]:
        return []
    if 8.3 <= g <= 11.3:
        why = "bias or scale of its accelerometer is off"
        return [Finding("warning", name, "acc-gravity", head + why, g)]
    return [Finding("error", name, "acc-unit", head + "its unit is unknown", g)]


def _clipping(name: str, what: str, x: Array) -> list[Finding]:
    """Samples that stay at an axis's extreme while the other axes move."""
    worst, limit = 0, 0.0
    for k in range(3):
        for sign in (1.0, -1.0):
            top = float((sign * x[:, k]).max())
            if top <= 1e-3:
                continue
            at = sign * x[:, k] >= top * (1 - 1e-9)
            others = np.abs(np.diff(np.delete(x, k, axis=1), axis=0)).max(axis=1)
            n = int((at[1:] & at[:-1] & (others > 0.02 * top)).sum())
            if n > worst:
                worst, limit = n, top
    if worst < 3:
        return []
    unit = "m/s^2" if what == "acc" else "rad/s"
    text = (
        f"sensor {name}: {what} stays at its limit of {limit:.4g} {unit} for {worst} samples: the "
        f"sensor's range is too small for this motion"
    )
    return [Finding("warning", name, "clipping", text, limit)]
