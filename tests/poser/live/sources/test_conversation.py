"""Datagrams that wait while the loop is busy are of the time at which they came."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from poser.live.addresses import Address
from poser.live.heard import Heard
from poser.live.packets import Packet, Rejected
from poser.live.sources.conversation import Conversation, Datagram, Sender


class Echo:
    """Makes a packet of every datagram, and sends it back."""

    def __init__(self) -> None:
        self.waiting: list[Datagram] = []

    def hear(self, datagram: bytes, sender: Sender, now_s: float) -> Iterator[Packet | Rejected]:
        self.waiting.append((datagram, sender))
        yield Packet("a", now_s, np.eye(3), np.zeros(3))

    def due(self, now_s: float) -> Iterator[Packet]:
        return iter(())

    def letters(self, now_s: float) -> Iterator[Datagram]:
        waiting, self.waiting = self.waiting, []
        yield from waiting

    def heard(self, now_s: float) -> dict[str, Heard]:
        return {}


def _off_s() -> float:
    """By how much times of packets that waited lie outside the looks at the clock around their sending."""
    with (
        closing(Conversation(Address("127.0.0.1", 0), Echo(), time.monotonic)) as intake,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        intake.open()
        list(intake.receive(0.0))
        sent = []
        for _ in range(5):
            sent.append(time.monotonic())
            sender.sendto(b"x", ("127.0.0.1", intake.port))
            time.sleep(0.02)
        found = [p.time_s for p, _, _ in intake.receive(0.1)]
        while len(found) < 5:
            found += [p.time_s for p, _, _ in intake.receive(0.1)]
    looks = zip(sent, found, [*sent[1:], time.monotonic()], strict=True)
    return max(max(before - at, at - after) for before, at, after in looks)


@pytest.mark.skipif(sys.platform != "linux", reason="stamps of the system")
def test_what_waited_is_of_its_time() -> None:
    # Two clocks are read one after the other: on a busy machine a try may fall between them.
    assert min(_off_s() for _ in range(5)) < 0.005


def test_answers_arrive_and_a_dead_peer_stops_nothing() -> None:
    with (
        closing(Conversation(Address("127.0.0.1", 0), Echo(), time.monotonic)) as intake,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        intake.open()
        sender.settimeout(5.0)
        sender.sendto(b"hello", ("127.0.0.1", intake.port))
        assert len(list(intake.receive(1.0))) == 1
        assert sender.recv(16) == b"hello"
        sender.sendto(b"bye", ("127.0.0.1", intake.port))
        sender.close()
        for _ in range(20):
            list(intake.receive(0.01))
