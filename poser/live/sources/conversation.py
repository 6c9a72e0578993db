"""Devices on UDP that are answered: a socket that tells who sent what, and sends what is due."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.receiver import Clock, Receiver
from poser.live.sources.protocol import Heard

Sender = tuple[Any, ...]
"""A socket address."""
Letter = tuple[bytes, Sender]


class Talker(Protocol):
    """One protocol of such devices, without a socket or a clock of its own."""

    def hear(
        self, datagram: bytes, sender: Sender, now_s: float
    ) -> Iterator[Packet | Rejected]: ...

    def due(self, now_s: float) -> Iterator[Packet]:
        """Packets that waited for something until now."""
        ...

    def letters(self, now_s: float) -> Iterator[Letter]:
        """What is to be sent now, and to whom."""
        ...

    def heard(self, now_s: float) -> Mapping[str, Heard]: ...


class Conversation(Receiver):
    """The intake of a `Talker`."""

    def __init__(self, address: Address, talker: Talker, clock: Clock):
        super().__init__(address, lambda _: iter(()), clock)
        self._talker = talker

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


def numeric(sender: Sender) -> str:
    """The host of a socket address."""
    return str(sender[0])
