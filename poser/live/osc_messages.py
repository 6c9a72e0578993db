"""Messages over Open Sound Control, by the library python-osc."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import PoserError
from mocap.gate import MAX_ACC
from poser.live.packets import (
    MAX_DATAGRAM,
    MAX_DISTANCES,
    MAX_MESSAGES,
    Packet,
    Rejected,
    from_fields,
)  # fmt: skip

IMU, STATE = "/poser/imu", "/poser/state"
_BUNDLE = b"#bundle\0"
_BUNDLE_HEAD = 16  # bytes: the word and a time
_MAX_ARGUMENTS = 4 + 2 * MAX_DISTANCES
# The library logs each type that it does not know, which takes long: thousands fit into a datagram.
_TYPES = frozenset(b",sdfihTFN")


def library() -> Any:
    """The package `pythonosc`; raises PoserError where it is not installed."""
    try:
        import pythonosc
    except ImportError as e:
        raise PoserError("OSC and VMC need the package 'python-osc': pip install python-osc") from e
    _quiet()
    return pythonosc


@cache
def _quiet() -> None:
    """The library logs bytes of malformed datagrams on the root logger, and so on the user's terminal."""
    root = logging.getLogger()
    root.addFilter(lambda record: "pythonosc" not in Path(record.pathname).parts)


def from_osc(datagram: bytes) -> Iterator[Packet | Rejected]:
    """The packets of a datagram: one message, or bundles of them; other addresses are refused.

    A bundle whose parts do not fit counts as one refusal, and so does what follows the first MAX_MESSAGES
    messages and bundles.
    """
    _quiet()
    if len(datagram) > MAX_DATAGRAM:
        yield Rejected("datagram too long")
        return
    waiting, taken = [datagram], 0
    while waiting:
        part = waiting.pop()
        taken += 1
        try:
            if taken > MAX_MESSAGES:
                waiting = []
                raise Rejected("too many messages")
            if part.startswith(_BUNDLE):
                waiting += reversed(_parts(part))
            else:
                yield _packet(part)
        except Rejected as e:
            yield e


def _parts(bundle: bytes) -> list[bytes]:
    """The messages and bundles in a bundle, in order. Raises Rejected.

    Not by the library, which never ends on a size below zero.
    """
    parts, at = [], _BUNDLE_HEAD
    while at < len(bundle):
        begin = at + 4
        at = begin + int.from_bytes(bundle[at:begin], "big", signed=True)
        if not begin < at <= len(bundle):
            raise Rejected("not OSC")
        parts.append(bundle[begin:at])
    if not parts:
        raise Rejected("not OSC")
    return parts


def _packet(message: bytes) -> Packet:
    """The packet of one message. Raises Rejected."""
    from pythonosc.osc_message import OscMessage

    address, ended, _ = message.partition(b"\0")
    if not (address.startswith(b"/") and ended):
        raise Rejected("not OSC")
    if address not in (IMU.encode(), STATE.encode()):
        raise Rejected("address unknown")
    # Behind the address, which is filled up to a multiple of four bytes with one zero at least.
    types, ended, _ = message[len(address) // 4 * 4 + 4 :].partition(b"\0")
    if not (types.startswith(b",") and ended):
        raise Rejected("not OSC")
    if len(types) > 1 + _MAX_ARGUMENTS or not _TYPES.issuperset(types):
        raise Rejected("wrong type")
    try:
        arguments = OscMessage(message).params
    # The library promises ParseError, but bytes from the network also find its struct.error, IndexError
    # and UnicodeDecodeError: whatever it is, this message is not OSC.
    except Exception as e:
        raise Rejected("not OSC") from e
    return from_fields(_imu(arguments) if address == IMU.encode() else _state(arguments))


def _imu(x: list[Any]) -> dict[str, Any]:
    if len(x) not in (7, 10):
        raise Rejected("field missing" if len(x) < 10 else "wrong type")
    fields = {"device": x[0], "t": x[1], "q": x[3:7]}
    # OSC has no optional arguments: -1 stands for no number.
    return fields | ({} if x[2] == -1 else {"seq": x[2]}) | ({"a": x[7:]} if len(x) > 7 else {})


def _state(x: list[Any]) -> dict[str, Any]:
    if len(x) < 4 or len(x) % 2:
        raise Rejected("field missing")
    if any(isinstance(flag, bool) or flag not in (0, 1) for flag in x[2:4]):
        raise Rejected("wrong type")
    names, metres = x[4::2], x[5::2]
    if len(names) > MAX_DISTANCES or not all(isinstance(n, str) for n in names):
        raise Rejected("wrong type")
    return {
        "device": x[0], "t": x[1], "screen": bool(x[2]), "proximity": bool(x[3]),
        "distances": dict(zip(names, metres, strict=True)),
    }  # fmt: skip


def imu_message(packet: Packet) -> bytes:
    """A packet as a datagram of one OSC message: what a sender has to send."""
    from pythonosc.osc_message_builder import OscMessageBuilder

    from mocap.orientation import to_quat

    assert packet.R_world_sensor is not None and packet.acc_world is not None
    message = OscMessageBuilder(IMU)
    message.add_arg(packet.device, "s")
    message.add_arg(packet.time_s, "d")
    message.add_arg(-1 if packet.seq is None else packet.seq, "i")
    values = to_quat(packet.R_world_sensor).tolist()
    if np.abs(packet.acc_world).max() <= MAX_ACC:
        values += packet.acc_world.tolist()
    for value in values:
        message.add_arg(value, "f")
    return bytes(message.build().dgram)
