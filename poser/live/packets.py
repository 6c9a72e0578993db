"""One message of one sensor: what it holds, and why it is refused.

As JSON, one object a line, several lines a datagram:

    {"device": "left_forearm", "t": 12.34, "q": [1, 0, 0, 0], "a": [0, 0, 0], "seq": 741}

device: the sensor's name. t: s on the device's own clock, any origin. q: unit quaternion w, x, y, z of
R_world_sensor. a: acceleration of the sensor in world axes, gravity removed, m/s^2; may be absent. The
world is right-handed with y up (or z up, where the receiver was told so). seq: counts the device's
packets, modulo 65536 or not at all; may be absent. For tracked consumer devices also, all optional:
screen, proximity: true or false; distances: metres to other devices by name. Other fields are ignored.

As OSC: address /poser/imu, arguments device (s), t (d), seq (i, -1: none), w, x, y, z (f), then
optionally ax, ay, az (f); address /poser/state, arguments device (s), t (d), screen (i), proximity (i),
then any number of other device (s), metres (f).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap.errors import PoserError
from mocap.gate import MAX_ACC
from mocap.orientation import Array

MAX_DATAGRAM = 8192  # bytes; 17 sensors in one datagram take 2.5 kB
MAX_MESSAGES = 64  # in a datagram: a suit has 17 sensors, and each message costs time
MAX_NAME = 64
MAX_TIME_S = 1e11  # a clock in milliseconds since 1970 sent as seconds is refused
TIME_TOO_LARGE = "time out of range"
MAX_DISTANCE_M = 1000.0
MAX_DISTANCES = 16
UNIT_TOLERANCE = 0.01
SEQUENCE_MODULUS = 65536


class Rejected(PoserError):
    """A message is not used. reason: one of few fixed words, which receivers count by."""

    def __init__(self, reason: str):
        self.reason = reason
        super().__init__(reason)


@dataclass(frozen=True)
class Status:
    """What a consumer device says about itself: screen lit, proximity sensor covered, distances in m."""

    screen: bool | None = None
    proximity: bool | None = None
    distances: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Packet:
    """One checked message.

    time_s: the device's clock. R_world_sensor (3,3), acc_world (3,) m/s^2 without gravity, NaN where it
    was not sent; both None in a message that carries a status alone. seq: 0 to 65535, or None. sender: the
    address that it came from, None where the intake tells senders apart itself.
    """

    device: str
    time_s: float
    R_world_sensor: Array | None
    acc_world: Array | None
    seq: int | None = None
    status: Status | None = None
    sender: tuple[str, int] | None = None


def from_json(datagram: bytes) -> Iterator[Packet | Rejected]:
    """The packets of a datagram, line by line; a bad line does not spoil its neighbours.

    What follows the first MAX_MESSAGES lines is refused as one.
    """
    if len(datagram) > MAX_DATAGRAM:
        yield Rejected("datagram too long")
        return
    lines = [line for line in datagram.splitlines() if line.strip()]
    for line in lines[:MAX_MESSAGES]:
        try:
            yield from_fields(_object(line))
        except Rejected as e:
            yield e
    if len(lines) > MAX_MESSAGES:
        yield Rejected("too many lines")


def _object(line: bytes) -> dict[str, Any]:
    try:
        value = json.loads(line, parse_constant=_not_finite)
    # RecursionError: "[[[[..."; ValueError: also bytes that are not UTF-8 and integers of 5000 digits.
    except (ValueError, RecursionError) as e:
        raise Rejected("not JSON") from e
    if not isinstance(value, dict):
        raise Rejected("not an object")
    return value


def _not_finite(_: str) -> float:
    raise Rejected("not finite")


def from_fields(fields: Mapping[str, Any]) -> Packet:
    """The packet of a decoded message. Raises Rejected."""
    device, time_s = (
        _name(fields.get("device")),
        number(fields.get("t"), MAX_TIME_S, TIME_TOO_LARGE),
    )
    status = _status(fields)
    if "q" not in fields:
        if status is None:
            raise Rejected("field missing")
        return Packet(device, time_s, None, None, None, status)
    R = rotation(_vector(fields["q"], 4, 2.0))
    acc = _vector(fields["a"], 3, MAX_ACC) if fields.get("a") is not None else np.full(3, np.nan)
    return Packet(device, time_s, R, acc, _sequence(fields.get("seq")), status)


def rotation(wxyz: Array) -> Array:
    """R (3,3) of a quaternion w, x, y, z whose norm is 1 within UNIT_TOLERANCE. Raises Rejected."""
    norm = math.sqrt(float(wxyz @ wxyz))
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise Rejected("not a unit quaternion")
    # In closed form, since for a single one the general function takes twenty times as long.
    w, x, y, z = (wxyz / norm).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def number(value: Any, limit: float, beyond: str = "out of range") -> float:
    """A finite number within +-limit; True is none. Raises Rejected, for `beyond` where it is larger."""
    if value is None:
        raise Rejected("field missing")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Rejected("wrong type")
    if isinstance(value, float) and not math.isfinite(value):
        raise Rejected("not finite")
    if abs(value) > limit:
        raise Rejected(beyond)
    return float(value)


def _name(value: Any) -> str:
    if value is None:
        raise Rejected("field missing")
    if not isinstance(value, str):
        raise Rejected("wrong type")
    if not 0 < len(value) <= MAX_NAME or not value.isprintable():
        raise Rejected("out of range")
    return value


def _vector(value: Any, length: int, limit: float) -> Array:
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != length:
        raise Rejected("wrong type")
    return np.array([number(x, limit) for x in value])


def _sequence(value: Any) -> int | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int):
        raise Rejected("wrong type")
    if not 0 <= value < 2**64:
        raise Rejected("out of range")
    return value % SEQUENCE_MODULUS


def _status(fields: Mapping[str, Any]) -> Status | None:
    if not {"screen", "proximity", "distances"} & fields.keys():
        return None
    distances = fields.get("distances") or {}
    if not isinstance(distances, Mapping):
        raise Rejected("wrong type")
    if len(distances) > MAX_DISTANCES:
        raise Rejected("out of range")
    metres = {_name(k): number(v, MAX_DISTANCE_M) for k, v in distances.items()}
    if any(m < 0 for m in metres.values()):
        raise Rejected("out of range")
    return Status(_flag(fields.get("screen")), _flag(fields.get("proximity")), metres)


def _flag(value: Any) -> bool | None:
    if value is not None and not isinstance(value, bool):
        raise Rejected("wrong type")
    return value
