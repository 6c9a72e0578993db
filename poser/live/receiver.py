"""Datagrams from the network, decoded: the socket of `poser live`."""

from __future__ import annotations

import select
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from mocap import orientation as ori
from mocap.errors import PoserError
from poser.live.addresses import Address, resolved
from poser.live.heard import Heard
from poser.live.packets import MAX_DATAGRAM, Packet, Rejected

RECEIVE_BYTES = 4 << 20  # asked for: some seconds of a suit at 100 Hz
# A flood must not keep rows from leaving: a look at the socket ends after POLL_S, and after a stop of the
# loop CATCH_UP of that time later, in which a suit's packets of the whole stop can be taken (20 us each).
POLL_S = 0.005
CATCH_UP = 0.1
LOOKS = 10  # one after the other that do not empty the socket: then rows wait for it no longer
Decoder = Callable[[bytes], Iterator[Packet | Rejected]]
Now = Callable[[], float]


def y_up(decode: Decoder) -> Decoder:
    """The same messages from senders whose world is z-up: v_yup = R_YUP_ZUP v_zup."""

    def turned(datagram: bytes) -> Iterator[Packet | Rejected]:
        for found in decode(datagram):
            if isinstance(found, Packet) and found.R_world_sensor is not None:
                assert found.acc_world is not None
                R, acc = ori.R_YUP_ZUP @ found.R_world_sensor, ori.R_YUP_ZUP @ found.acc_world
                yield replace(found, R_world_sensor=R, acc_world=acc)
            else:
                yield found

    return turned


class Reading:
    """Up to when all that came has been read: `read_s`, on the receiver's clock (`Intake.read_s`)."""

    def __init__(self, now_s: float):
        self.read_s = now_s
        self._looks = 0

    def emptied(self, at_s: float) -> None:
        """Nothing was left at this time."""
        self.read_s, self._looks = at_s, 0

    def broken_off(self, now_s: float, arrival_s: float | None) -> None:
        """A look ended before nothing was left. arrival_s: when what it took last had come, where known."""
        self._looks += 1
        if self._looks > LOOKS:
            self.read_s = now_s
        elif arrival_s is not None:
            self.read_s = arrival_s


class Receiver:
    """Datagrams of a UDP socket, decoded; refused ones are counted by reason and never stop it.

    Raises PoserError where the host's name is unknown.
    """

    ended = False  # who listens cannot know
    _stamped = False  # datagrams tell when they came

    def __init__(self, address: Address, decode: Decoder, clock: Now = time.monotonic):
        family, self._to = resolved(address, f"cannot listen on {address}", socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        # A machine that stops for a second must not lose what arrives meanwhile; the system caps it.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        self._address, self._decode, self._clock = address, decode, clock
        self._empty_s: float | None = None  # when nothing was left to take
        self._left_s = clock()  # when the last look ended
        self._reading = Reading(self._left_s)
        self.rejected: Counter[str] = Counter()

    def open(self) -> None:
        """Listen. Raises PoserError where the address is taken or is not ours."""
        try:
            self._socket.bind(self._to)
        except OSError as e:
            raise PoserError(f"cannot listen on {self._address}: {e.strerror or e}") from e
        self._left_s = self._clock()
        self._reading.emptied(self._left_s)

    @property
    def read_s(self) -> float:
        """See `Intake`."""
        return self._reading.read_s

    @property
    def port(self) -> int:
        return int(self._socket.getsockname()[1])

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        """Packets, when they were found, and when they had not come yet (None before the first look).

        Waits for the first one at most `wait_s`. Ends when the socket is empty, or POLL_S and CATCH_UP of the
        time since the last look later; then the rest is for the next look. What the caller does with a packet
        counts.
        """
        select.select([self._socket], [], [], wait_s)
        now = self._clock()
        until = now + POLL_S + CATCH_UP * (now - self._left_s)
        yield from self._take(until)
        self._left_s = self._clock()

    def _take(self, until_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        """What waits in the socket: at least one datagram, and no further one from `until_s` on."""
        while True:
            looked = self._clock()
            try:
                datagram, sender, arrival = self._read()
            except BlockingIOError:
                self._empty_s = looked
                self._reading.emptied(looked)
                return
            except OSError:
                # Some systems report an earlier send's failure here; it is not about what we receive.
                self.rejected["receive error"] += 1
                return
            for found in self._decoded(datagram, sender, arrival):
                if isinstance(found, Rejected):
                    self.rejected[found.reason] += 1
                else:
                    yield replace(found, sender=sender[:2]), arrival, self._empty_s
            if (now := self._clock()) >= until_s:
                self._reading.broken_off(now, arrival if self._stamped else None)
                return

    def _read(self) -> tuple[bytes, Any, float]:
        """A datagram that waits, who sent it, and when it was found."""
        datagram, sender = self._socket.recvfrom(MAX_DATAGRAM + 1)
        return datagram, sender, self._clock()

    def _decoded(
        self, datagram: bytes, sender: Any, arrival_s: float
    ) -> Iterator[Packet | Rejected]:
        """What a datagram holds; kinds of devices that are answered look at its sender, too."""
        return self._decode(datagram)

    def heard(self) -> Mapping[str, Heard]:
        """Nothing: these devices send measurements alone."""
        return {}

    def close(self) -> None:
        self._socket.close()
