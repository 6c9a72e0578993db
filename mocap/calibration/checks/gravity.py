"""The unit of acc, by gravity."""

from __future__ import annotations

from typing import Any

from mocap.calibration.evidence import Evidence
from mocap.calibration.measures import KEPT, constant_force, still_gravity
from mocap.findings import Finding, Severity
from mocap.orientation import Array

GRAVITY_RANGE = (9.3, 10.3)  # m/s^2: more than bias and scale of any usual sensor
RESTLESS = 0.35  # m/s^2: above, the sensor never rests; white noise of that size leaves 0.24
RESTLESS_RANGE = (3.0, 25.0)  # m/s^2: what limbs have at their slowest, even in running and jumping
NOTHING = 0.6  # m/s^2 (or g): a still sensor that reads less has no gravity


def check(evidence: Evidence) -> list[Finding]:
    """Is a still sensor's |acc| 9.81, and if not, in which unit would it be?"""
    found = []
    for s, name in evidence.each:
        gyr, acc, _ = evidence.channels(s)
        found += _of_sensor(name, gyr, acc, evidence.raw.rate_hz)
    return found


def _of_sensor(name: str, gyr: Array, acc: Array, rate_hz: float) -> list[Finding]:
    g, deviation = still_gravity(gyr, acc)
    if GRAVITY_RANGE[0] <= g <= GRAVITY_RANGE[1]:
        return []

    def finding(severity: Severity, code: str, value: float, **details: Any) -> list[Finding]:
        return [Finding(severity, name, code, value, {"reads": g, **details})]

    constant = constant_force(gyr, acc, rate_hz)
    if constant < NOTHING or (g < GRAVITY_RANGE[0] and constant < KEPT * g):
        return finding("error", "acc-without-gravity", constant, constant=constant)
    if 0.9 <= g <= 1.1:
        return finding("error", "acc-in-g", g)
    if 930 <= g <= 1030:
        return finding("error", "acc-unit", g, likely="mg")
    # A sensor that never rests reads more than g, by as much as it is shaken, or less where it falls.
    if deviation > RESTLESS and RESTLESS_RANGE[0] <= g <= RESTLESS_RANGE[1]:
        return []
    if 8.3 <= g <= 11.3:
        return finding("warning", "acc-gravity", g)
    return finding("error", "acc-unit", g)
