"""The sentences about senders: what each finding of `senders` says to a person, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mocap.findings import Finding
from poser.live.senders import UNITS

_GOOD = "a = R_world_sensor f - (0, 9.80665, 0) of specific force f is expected"
_UNITS = dict(zip(UNITS, ("ms", "us", "ns"), strict=True))


def sentence(finding: Finding) -> str:
    """One sentence for a person."""
    details = dict(finding.details)
    if finding.code == "clock-too-large":
        return "times t are beyond 1e11: ms, us or ns since 1970? Seconds are expected"
    if finding.code == "clock-unit":
        return f"{_who(details)}: {_clock(finding.value or 0.0)}"
    if finding.code == "trunk-lies":
        # Inverse quaternions and another order can differ by constants alone, which a pose hides.
        causes = " or ".join(_WORDS[code](details) for code in details["readings"])
        return f"the wearer turned about, and by the orientations the trunk lay down: {causes}"
    words = _WORDS[finding.code]
    return f"{_who(details)}: acceleration at rest is {finding.value:.1f} m/s^2, not 0: {words(details)}"


def _who(d: Mapping[str, Any]) -> str:
    return "all sensors" if d["all"] else f"sensor {', '.join(d['sensors'])}"


def _clock(pace: float) -> str:
    """Of a device's time that passes `pace` times as fast as ours."""
    if pace in _UNITS:
        return f"its time t is in {_UNITS[pace]}, seconds are expected: divide by {pace:g}"
    return (
        f"its time t runs {pace:.3g} times as fast as this computer's clock; seconds are expected"
    )


def _left_in(d: Mapping[str, Any]) -> str:
    if d["unit"] == "g":
        return f"it is in g, and gravity is left in; {_GOOD}, in m/s^2"
    return f"gravity is left in; {_GOOD}"


def _reversed(d: Mapping[str, Any]) -> str:
    unit = "it is in g, and " if d["unit"] == "g" else ""
    return f"{unit}gravity is taken off twice, or the sign is reversed; {_GOOD}"


def _other_up(d: Mapping[str, Any]) -> str:
    if d["up"] == "y":
        return "y and z are exchanged: the senders' world is z-up (--up z)"
    return "y and z are exchanged: the senders' world is y-up (leave --up z out)"


def _other_up_left_in(d: Mapping[str, Any]) -> str:
    unit = "it is in g, " if d["unit"] == "g" else ""
    return f"{unit}gravity is left in, and {_other_up(d)}"


def _exchanged(d: Mapping[str, Any]) -> str:
    return f"gravity is taken off along another axis than it has; {_other_up(d)}"


def _sensor_axes(d: Mapping[str, Any]) -> str:
    unit = "in g, " if d["unit"] == "g" else ""
    return f"it is {unit}in the sensor's own axes, with gravity; {_GOOD}"


_WORDS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "gravity-left-in": _left_in,
    "gravity-reversed": _reversed,
    "other-up-left-in": _other_up_left_in,
    "axes-exchanged": _exchanged,
    "other-up": _other_up,
    "sensor-axes": _sensor_axes,
    "quaternion-order": lambda d: "quaternions seem to be x, y, z, w; w, x, y, z is expected",
    "quaternion-inverse": lambda d: (
        "quaternions seem to be inverse (sensor from world); world from sensor is expected"
    ),
    "acc-at-rest": lambda d: f"nothing known explains it; {_GOOD}",
}
