"""SlimeVR trackers, and phones that speak their protocol (owoTrack): UDP, port 6969, big-endian.

A packet is `u32 type, u64 number, payload`. A board introduces itself by a handshake with its MAC and is
answered; then it tells each of its sensors (a board may carry several), and sends rotations and
accelerations, alone or in bundles. There are no times: a packet is of the time at which it came. The
server sends a heartbeat twice a second, and pings.

Rotations are R of the sensor's axes in a z-up world, whose heading is each board's own and drifts;
accelerations are in the sensor's axes, gravity removed. In boards of protocols below 22 these axes are
turned by -90 deg about z. Layouts after the public sources of the SlimeVR server and tracker firmware.

A tracker's name is its MAC and the sensor's number: a4:cf:12:00:00:01/0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from poser.live.heard import Heard
from poser.live.packets import (
    MAX_ACC,
    MAX_DATAGRAM,
    MAX_MESSAGES,
    Packet,
    Rejected,
    number,
    rotation,
)
from poser.live.sources.conversation import Conversation, Datagram, Sender, numeric
from poser.live.sources.order import InOrder
from poser.live.sources.protocol import MAX_DEVICES, Intake, Kind, Told

PORT = 6969
HEARTBEAT, HANDSHAKE, ACCELERATION, PING, BATTERY, INFO = 0, 3, 4, 10, 12, 15
ROTATION, SIGNAL, FLAGS, ROTATION_ACCELERATION, BUNDLE, COMPACT = 17, 19, 22, 23, 100, 101
SERVER_HEARTBEAT = 1
SILENT = frozenset({HEARTBEAT, 11, 13, 14, 18, 20, 21, 24, 25})
"""Types without a use here: serial, tap, error, accuracy, temperature, user action, flex, configuration."""

GREETING = (b"\x03Hey OVR =D 5").ljust(64, b"\0")
FEATURES = bytes([0b11])  # bundles, compact bundles
EVERY_S = 0.5  # heartbeats and pings
GONE_S = 1.0  # a board silent for so long is lost: its name and place are free
HOLD_S = 0.01  # a rotation waits so long for its acceleration, which comes in a packet of its own
MAX_SENSORS = 16  # of a board
MOST_LOST = 3000  # a number further on is no loss
MAX_LETTERS = 256
R_OLD = ori.rot_z(-np.pi / 2)  # of accelerations below protocol 22
NEW_AXES = 22


@dataclass
class _Sensor:
    """One sensor of a board. waiting: a rotation without its acceleration, and when it came."""

    sent: bool = False
    waiting: tuple[float, Array] | None = None
    felt_s: float = -np.inf  # when an acceleration came last
    status: int | None = None


@dataclass
class _Board:
    """A board: who it is, what it told. order: of what is made of it. number: of its last packet."""

    mac: str
    firmware: str
    protocol: int
    heard_s: float
    order: InOrder
    number: int = 0
    lost: int = 0
    battery: float | None = None
    signal: int | None = None
    ping: int = 0
    pinged_s: float = -np.inf
    ping_ms: float | None = None
    sensors: dict[int, _Sensor] = field(default_factory=dict)


class SlimeVR:
    """The protocol's server."""

    def __init__(self) -> None:
        self._boards: dict[Sender, _Board] = {}
        self._order = InOrder()
        self._letters: list[Datagram] = []
        self._told_s = -np.inf

    def hear(self, datagram: bytes, sender: Sender, now_s: float) -> Iterator[Packet | Rejected]:
        """The packets of a datagram; what does not fit is refused."""
        try:
            if len(datagram) > MAX_DATAGRAM:
                raise Rejected("datagram too long")
            kind, at = struct.unpack_from(">IQ", datagram)
            body = datagram[12:]
            if kind == HANDSHAKE:
                self._meet(body, sender, now_s)
                return
            board = self._boards.get(sender)
            if board is None:
                raise Rejected("no handshake")
            _count(board, at)
            board.heard_s = now_s
        except struct.error:
            yield Rejected("too short")
            return
        except Rejected as e:
            yield e
            return
        for k, (what, part) in enumerate(_parts(kind, body)):
            if k >= MAX_MESSAGES:
                yield Rejected("too many messages")
                return
            try:
                yield from self._message(board, sender, what, part, now_s)
            except struct.error:
                yield Rejected("too short")
            except Rejected as e:
                yield e

    def _meet(self, body: bytes, sender: Sender, now_s: float) -> None:
        """A board introduces itself. Raises Rejected, struct.error."""
        protocol, firmware, mac = _introduction(body)
        name = mac or numeric(sender)
        for other, board in list(self._boards.items()):
            if board.mac == name and other != sender:
                if now_s - board.heard_s < GONE_S:
                    raise Rejected("name taken by another device")
                del self._boards[other]
        if sender not in self._boards:
            self._make_room(now_s)
        known = self._boards.get(sender)
        board = _Board(name, firmware, protocol, now_s, self._order)
        if known is not None and known.mac == name:
            board.lost, board.sensors = known.lost, known.sensors
        self._boards[sender] = board
        self._letter(GREETING, sender)

    def _make_room(self, now_s: float) -> None:
        if len(self._boards) < MAX_DEVICES:
            return
        oldest = min(self._boards, key=lambda s: self._boards[s].heard_s)
        if now_s - self._boards[oldest].heard_s < GONE_S:
            raise Rejected("too many devices")
        del self._boards[oldest]

    def _message(
        self, board: _Board, sender: Sender, kind: int, body: bytes, now_s: float
    ) -> Iterator[Packet]:
        """One packet of a board, which may be of a bundle. Raises Rejected, struct.error."""
        if kind == ROTATION:
            sensor, what, *xyzw = struct.unpack_from(">BB4f", body)
            if what == 1:
                yield from _turned(board, sensor, rotation(_wxyz(xyzw)), now_s)
        elif kind == ACCELERATION:
            xyz = _finite(struct.unpack_from(">3f", body), MAX_ACC)
            yield from _felt(board, body[12] if len(body) > 12 else 0, xyz, now_s)
        elif kind == ROTATION_ACCELERATION:
            sensor, *q = struct.unpack_from(">B7h", body)
            R = rotation(_wxyz([x / 2**15 for x in q[:4]]))
            yield from _turned(board, sensor, R, now_s)
            yield from _felt(board, sensor, np.array(q[4:]) / 2**7, now_s)
        elif kind == INFO:
            sensor, status = struct.unpack_from(">BB", body)
            _sensor(board, sensor).status = status
            self._letter(struct.pack(">IBB", INFO, sensor, status), sender)
        elif kind == BATTERY:
            told = struct.unpack_from(">2f" if len(body) >= 8 else ">f", body)
            board.battery = float(np.clip(_finite(told[-1:], 1000.0)[0], 0.0, 1.0))
        elif kind == PING:
            if struct.unpack_from(">I", body)[0] == board.ping:
                board.ping_ms = (now_s - board.pinged_s) * 500.0
        elif kind == SIGNAL:
            board.signal = struct.unpack_from(">Bb", body)[1]
        elif kind == FLAGS:
            self._letter(struct.pack(">IQ", FLAGS, 0) + FEATURES, sender)
        elif kind not in SILENT:
            raise Rejected("type unknown")

    def due(self, now_s: float) -> Iterator[Packet]:
        """Rotations whose acceleration did not come."""
        for board in self._boards.values():
            for k, sensor in board.sensors.items():
                if sensor.waiting is not None and now_s - sensor.waiting[0] >= HOLD_S:
                    yield _released(board, k, sensor)

    def letters(self, now_s: float) -> Iterator[Datagram]:
        waiting, self._letters = self._letters, []
        yield from waiting
        if now_s - self._told_s < EVERY_S:
            return
        self._told_s = now_s
        for sender, board in self._boards.items():
            board.ping = (board.ping + 1) % 2**31
            board.pinged_s = now_s
            yield struct.pack(">IQ", SERVER_HEARTBEAT, 0), sender
            yield struct.pack(">IQI", PING, 0, board.ping), sender

    def _letter(self, letter: bytes, sender: Sender) -> None:
        if len(self._letters) < MAX_LETTERS:
            self._letters.append((letter, sender))

    def heard(self, now_s: float) -> Mapping[str, Heard]:
        found: dict[str, Heard] = {}
        for board in self._boards.values():
            words = [f"firmware {board.firmware}"] if board.firmware else []
            words += [f"signal {board.signal} dBm"] if board.signal is not None else []
            words += ["gone"] if now_s - board.heard_s > GONE_S else []
            for k, sensor in sorted(board.sensors.items()):
                fault = ["the sensor reports a fault"] if sensor.status == 2 else []
                note = ", ".join(words + fault)
                found[f"{board.mac}/{k}"] = Heard(board.battery, board.lost, board.ping_ms, note)
        return found


def _parts(kind: int, body: bytes) -> Iterator[tuple[int, bytes]]:
    """The packets in a bundle, or the packet itself. One that is cut short ends with the bundle."""
    if kind not in (BUNDLE, COMPACT):
        yield kind, body
        return
    size, head = (2, 4) if kind == BUNDLE else (1, 1)
    at = 0
    while at + size <= len(body):
        length = int.from_bytes(body[at : at + size], "big")
        part = body[at + size : at + size + length]
        if length:
            yield int.from_bytes(part[:head], "big"), part[head:]
        at += size + length


def _introduction(body: bytes) -> tuple[int, str, str]:
    """Protocol, firmware and MAC of a handshake; what old firmware leaves out is 0 or empty."""
    if len(body) < 29:
        return 0, "", ""
    (protocol,) = struct.unpack_from(">i", body, 24)
    length = body[28]
    firmware = body[29 : 29 + length].split(b"\0")[0].decode("ascii", "replace")
    mac = body[29 + length : 35 + length]
    named = len(mac) == 6 and any(mac)
    kept = "".join(c for c in firmware if c.isprintable())[:32]
    return protocol, kept, mac.hex(":") if named else ""


def _count(board: _Board, at: int) -> None:
    """Note a packet's number. Raises Rejected for one that comes after a later one: it is of the past."""
    if at == 0:
        return
    if at <= board.number:
        raise Rejected("out of order")
    missing = at - board.number - 1
    board.lost += missing if board.number and missing < MOST_LOST else 0
    board.number = at


def _sensor(board: _Board, k: int) -> _Sensor:
    if k not in board.sensors and len(board.sensors) >= MAX_SENSORS:
        raise Rejected("too many devices")
    return board.sensors.setdefault(k, _Sensor())


def _turned(board: _Board, k: int, R_zup: Array, now_s: float) -> Iterator[Packet]:
    """A rotation; it goes on at once where accelerations do not come."""
    sensor = _sensor(board, k)
    if sensor.waiting is not None:
        yield _released(board, k, sensor)
    sensor.waiting = (now_s, ori.R_YUP_ZUP @ R_zup)
    if sensor.sent and now_s - sensor.felt_s > GONE_S:
        yield _released(board, k, sensor)


def _felt(board: _Board, k: int, acc: Array, now_s: float) -> Iterator[Packet]:
    """An acceleration, of the rotation before it."""
    sensor = _sensor(board, k)
    sensor.felt_s = now_s
    if sensor.waiting is not None:
        yield _released(board, k, sensor, acc if board.protocol >= NEW_AXES else R_OLD @ acc)


def _released(board: _Board, k: int, sensor: _Sensor, acc: Array | None = None) -> Packet:
    assert sensor.waiting is not None
    time_s, R = sensor.waiting
    sensor.waiting = None
    sensor.sent = True
    name, acc_world = f"{board.mac}/{k}", np.full(3, np.nan) if acc is None else R @ acc
    return Packet(name, time_s, R, acc_world, board.order.number(name))


def _wxyz(xyzw: list[float]) -> Array:
    x, y, z, w = _finite(xyzw, 2.0)
    return np.array([w, x, y, z])


def _finite(values: list[float] | tuple[float, ...], limit: float) -> Array:
    return np.array([number(float(v), limit) for v in values])


def _make(told: Told) -> Intake:
    return Conversation(told.addresses[0], SlimeVR(), told.clock)


SOURCE = Kind(
    "slimevr",
    "SlimeVR trackers, and phones with owoTrack",
    _make,
    PORT,
    own_headings=True,
    far=True,
)
