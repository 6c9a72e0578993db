"""The socket under more than can be taken: a look at it ends, poses leave, what is genuine gets through."""

from __future__ import annotations

import json
import math
import socket
import struct
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from mocap.recording import Recording
from poser.live import osc_messages, packets
from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.receiver import CATCH_UP, LOOKS, POLL_S, Decoder, Receiver
from tests.poser.live.conftest import packets_of
from tests.poser.live.test_loop import Collect, Wire, free_port, line  # noqa: F401 (a fixture)


class Clock:
    """Moves by what decoding takes."""

    def __init__(self) -> None:
        self.now = 50.0

    def __call__(self) -> float:
        return self.now


def costly(clock: Clock | Wire, decode: Decoder, seconds: float) -> Decoder:
    """`decode` that takes so long for each message."""

    def slow(datagram: bytes) -> Iterator[Packet | Rejected]:
        for found in decode(datagram):
            clock.now += seconds
            yield found

    return slow


def told(k: int, time_s: float | None = None) -> bytes:
    """Packet k of a device whose clock says `time_s`, or counts packets."""
    t = k if time_s is None else time_s
    return json.dumps({"device": "head", "t": t, "q": [1, 0, 0, 0], "seq": k}).encode()


EACH_S = 2.0**-10  # of decoding: the clock's sums are exact


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def receiver(free_port: int, clock: Clock) -> Iterator[Receiver]:  # noqa: F811
    decode = costly(clock, packets.from_json, EACH_S)
    with closing(Receiver(Address("127.0.0.1", free_port), decode, clock)) as receiver:
        receiver.open()
        yield receiver


@pytest.fixture
def sender(free_port: int) -> Iterator[socket.socket]:  # noqa: F811
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", free_port))
        yield sender


def test_a_look_at_the_socket_ends(receiver: Receiver, clock: Clock, sender: socket.socket) -> None:
    """After the 6th datagram at 1 ms each; only when all 24 are taken the socket is seen empty."""
    for k in range(24):
        sender.send(told(k))
    seen: list[int] = []
    for _ in range(4):
        taken = list(receiver.receive(0.0))
        assert len(taken) == 6
        assert all(since is None for _, _, since in taken)
        seen += [int(packet.time_s) for packet, _, _ in taken]
    assert seen == list(range(24))
    assert list(receiver.receive(0.0)) == []
    empty = clock.now
    clock.now += 0.5
    sender.send(told(24))
    [(_, arrival, since)] = receiver.receive(0.0)
    assert (arrival, since) == (empty + 0.5, empty)


def test_after_a_stop_of_the_loop_a_look_takes_longer(
    receiver: Receiver, clock: Clock, sender: socket.socket
) -> None:
    assert list(receiver.receive(0.0)) == []
    for k in range(150):
        sender.send(told(k))
    clock.now += 1.0
    assert len(list(receiver.receive(0.0))) == math.ceil((POLL_S + CATCH_UP) / EACH_S)
    assert len(list(receiver.receive(0.0))) == math.ceil(POLL_S / EACH_S)


def test_poses_keep_leaving_while_somebody_sends_lines(
    recording: Recording,
    free_port: int,  # noqa: F811
) -> None:
    """4096 bad lines 60 times a second, at 20 us a line: all of them would take 5 s a second."""
    genuine = [(at, line(p)) for at, p in packets_of(recording)]
    bad = [(k / 60, b"1\n" * 4096) for k in range(120)]
    wire, sink = Wire(free_port, sorted(genuine + bad, key=lambda sent: sent[0])), Collect()
    decode = costly(wire, packets.from_json, 20e-6)
    report = wire.drive(decode, recording.sensors, recording.rate_hz, 2.1, sink)
    assert len(sink.poses) >= len(recording)
    assert not any(pose.note for pose in sink.poses[: len(recording) - 1])
    for counts in report.source["devices"].values():
        assert (counts["received"], counts["late"], counts["lost"]) == (len(recording), 0, 0)
    assert report.source["rejected"] == {"not an object": 120 * 64, "too many lines": 120}
    # The rows behind the last packet wait for the whole buffer.
    usual = report.lag.quantile_ms(0.9)
    assert usual is not None and usual < 25


def test_poses_keep_leaving_under_more_than_can_be_taken(free_port: int) -> None:  # noqa: F811
    """At 1 ms a datagram, 2000 a second: the socket is never empty."""
    genuine = [(k / 60, told(k, k / 60)) for k in range(60)]
    flood = [(k / 2000, b"1") for k in range(2000)]
    wire, sink = Wire(free_port, sorted(genuine + flood, key=lambda sent: sent[0])), Collect()
    decode = costly(wire, packets.from_json, 0.001)
    report = wire.drive(decode, ("head",), 60.0, 1.0, sink)
    assert len(sink.poses) >= 55
    worst = report.lag.quantile_ms(1.0)
    # At first rows wait for LOOKS of 7.5 ms; then for the buffer of 50 ms, a look, and the frame begun.
    assert worst is not None and worst < 50 + 7.5 * LOOKS
    settled = report.lag.quantile_ms(1.0, last=40)
    assert settled is not None and settled < 50 + 10
    # As many of them as of all: 6 of 7.5 ms are for 15 datagrams.
    assert report.source["devices"]["head"]["received"] >= 10


def element(content: bytes) -> bytes:
    return struct.pack(">i", len(content)) + content


HEAD = b"#bundle\0" + bytes(8)


def nested(levels: int) -> bytes:
    bundle = b"/a\0\0"
    for _ in range(levels):
        bundle = HEAD + element(bundle)
    return bundle


@pytest.mark.parametrize(
    ("datagram", "reasons"),
    [
        (HEAD + element(b"/a\0\0") * 64, ["address unknown"] * 63 + ["too many messages"]),
        (HEAD + element(b"/a\0\0") * 1000, ["address unknown"] * 63 + ["too many messages"]),
        (nested(400), ["too many messages"]),
        # The library would read the same four bytes for ever.
        (HEAD + struct.pack(">i", -4) + b"/a\0\0", ["not OSC"]),
        (HEAD + struct.pack(">i", 0) * 2000, ["not OSC"]),
        (HEAD + struct.pack(">i", 999) + b"/a\0\0", ["not OSC"]),
        (HEAD, ["not OSC"]),
        # It would log each of these types.
        (b"/poser/imu\0\0," + b"z" * 8000 + bytes(8), ["wrong type"]),
        (b"/poser/imu\0\0," + b"i" * 8000 + bytes(8), ["wrong type"]),
        (b"/poser/imu\0X," + b"z" * 8000 + bytes(8), ["wrong type"]),
    ],
)
def test_messages_of_an_osc_datagram_are_bounded(datagram: bytes, reasons: list[str]) -> None:
    found = list(osc_messages.from_osc(datagram))
    assert [f.reason for f in found if isinstance(f, Rejected)] == reasons
    assert len(found) == len(reasons)


def test_messages_in_bundles_come_in_order() -> None:
    one, two, three = (
        osc_messages.imu_message(Packet("head", 0.0, np.eye(3), np.zeros(3), k)) for k in range(3)
    )
    inner = HEAD + element(one) + element(two)
    found = list(osc_messages.from_osc(HEAD + element(inner) + element(three)))
    assert [f.seq for f in found if isinstance(f, Packet)] == [0, 1, 2]
