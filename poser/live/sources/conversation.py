"""Devices on UDP that are answered: a socket that tells who sent what, and sends what is due.

Such devices have no clock: when a datagram came is when it was measured. Where the system stamps datagrams
(Linux), that is told to some us even for those that waited while the loop was busy.
"""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from poser.live.addresses import Address
from poser.live.heard import Heard
from poser.live.packets import MAX_DATAGRAM, Packet, Rejected
from poser.live.receiver import Now, Receiver

TIMESTAMPS = 35  # SO_TIMESTAMPNS of Linux, which the standard library does not name
TIMESPEC = struct.Struct("@ll")
OLDEST_S = 10.0
Sender = tuple[Any, ...]
"""A socket address."""
Datagram = tuple[bytes, Sender]


class Talker(Protocol):
    """One protocol of such devices, without a socket or a clock of its own."""

    def hear(
        self, datagram: bytes, sender: Sender, now_s: float
    ) -> Iterator[Packet | Rejected]: ...

    def due(self, now_s: float) -> Iterator[Packet]:
        """Packets that waited for something until now."""
        ...

    def letters(self, now_s: float) -> Iterator[Datagram]:
        """What is to be sent now, and to whom."""
        ...

    def heard(self, now_s: float) -> Mapping[str, Heard]: ...


class Conversation(Receiver):
    """The intake of a `Talker`."""

    def __init__(self, address: Address, talker: Talker, clock: Now):
        super().__init__(address, lambda _: iter(()), clock)
        self._talker = talker
        self._stamped = clock is time.monotonic and _stamps(self._socket)

    def _read(self) -> tuple[bytes, Any, float]:
        if not self._stamped:
            return super()._read()
        datagram, more, _, sender = self._socket.recvmsg(MAX_DATAGRAM + 1, 64)
        now, age = self._clock(), _age_s(more)
        return datagram, sender, now - age

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        yield from super().receive(wait_s)
        now = self._clock()
        for packet in self._talker.due(now):
            yield packet, now, self._empty_s
        for letter, sender in self._talker.letters(now):
            try:
                self._socket.sendto(letter, sender)
            except OSError:
                # The device is gone or the queue full: it asks again, or the next round comes.
                self.rejected["could not be answered"] += 1

    def _decoded(
        self, datagram: bytes, sender: Any, arrival_s: float
    ) -> Iterator[Packet | Rejected]:
        return self._talker.hear(datagram, sender, arrival_s)

    def heard(self) -> Mapping[str, Heard]:
        return self._talker.heard(self._clock())


def _stamps(open_socket: socket.socket) -> bool:
    """Ask the system to stamp datagrams; False where it does not."""
    if sys.platform != "linux":
        return False
    try:
        open_socket.setsockopt(socket.SOL_SOCKET, TIMESTAMPS, 1)
    except OSError:
        return False
    return True


def _age_s(more: list[tuple[int, int, bytes]]) -> float:
    """How long ago a datagram came, by its stamp; 0 where it has none, or the clock was set meanwhile."""
    for level, kind, data in more:
        if (level, kind) == (socket.SOL_SOCKET, TIMESTAMPS) and len(data) >= TIMESPEC.size:
            s, ns = TIMESPEC.unpack_from(data)
            age = time.time() - (s + ns / 1e9)
            return age if 0.0 <= age < OLDEST_S else 0.0
    return 0.0


def numeric(sender: Sender) -> str:
    """The host of a socket address."""
    return str(sender[0])
