"""What a message may hold: everything else is refused by one of few words, and nothing else is raised."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mocap import orientation as ori
from poser.live import packets
from poser.live.packets import Packet, Rejected

GOOD: dict[str, Any] = {"device": "head", "t": 3.5, "q": [1, 0, 0, 0], "a": [0, 9, 0], "seq": 7}
REASONS = {
    "datagram too long", "not JSON", "not an object", "field missing", "wrong type", "not finite",
    "out of range", "time out of range", "not a unit quaternion", "too many lines",
}  # fmt: skip


def decoded(datagram: bytes) -> list[Packet | Rejected]:
    return list(packets.from_json(datagram))


def test_a_good_message_comes_back_whole() -> None:
    turned = ori.rot_y(0.4) @ ori.rot_x(-1.1)
    fields = GOOD | {"q": ori.to_quat(turned).tolist(), "screen": True, "distances": {"watch": 0.3}}
    [packet] = decoded(json.dumps(fields).encode())
    assert isinstance(packet, Packet)
    assert (packet.device, packet.time_s, packet.seq) == ("head", 3.5, 7)
    assert packet.R_world_sensor is not None and packet.acc_world is not None
    np.testing.assert_allclose(packet.R_world_sensor, turned, atol=1e-12)
    np.testing.assert_allclose(packet.acc_world, [0, 9, 0])
    assert packet.status is not None
    assert (packet.status.screen, packet.status.proximity) == (True, None)
    assert packet.status.distances == {"watch": 0.3}


def test_acceleration_and_number_may_be_absent() -> None:
    [packet] = decoded(json.dumps({k: GOOD[k] for k in ("device", "t", "q")}).encode())
    assert isinstance(packet, Packet)
    assert packet.seq is None and packet.acc_world is not None
    assert np.isnan(packet.acc_world).all()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"device": None}, "field missing"),
        ({"device": 3}, "wrong type"),
        ({"device": ""}, "out of range"),
        ({"device": "x" * 65}, "out of range"),
        ({"device": "he\x1b[2Jad"}, "out of range"),
        ({"t": None}, "field missing"),
        ({"t": "3.5"}, "wrong type"),
        ({"t": True}, "wrong type"),
        ({"t": 1e300}, "time out of range"),
        ({"t": 10**4000}, "time out of range"),
        ({"t": float("nan")}, "not finite"),
        ({"t": float("inf")}, "not finite"),
        ({"q": [1, 0, 0]}, "wrong type"),
        ({"q": {"w": 1}}, "wrong type"),
        ({"q": "1000"}, "wrong type"),
        ({"q": [0, 0, 0, 0]}, "not a unit quaternion"),
        ({"q": [1, 0.2, 0, 0]}, "not a unit quaternion"),
        ({"q": [1, 0, 0, 1e99]}, "out of range"),
        ({"a": [0, 0, 1e5]}, "out of range"),
        ({"a": [0, None, 0]}, "field missing"),
        ({"seq": -1}, "out of range"),
        ({"seq": 1.5}, "wrong type"),
        ({"screen": 1}, "wrong type"),
        ({"distances": [1]}, "wrong type"),
        ({"distances": {"watch": -1}}, "out of range"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], reason: str) -> None:
    [refused] = decoded(json.dumps(GOOD | change).encode())
    assert isinstance(refused, Rejected)
    assert refused.reason == reason


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"\xff\xfe\x00", "not JSON"),
        (b"{", "not JSON"),
        (b"[" * 8000, "not JSON"),
        (b'{"a":' * 1500, "not JSON"),
        (b"9" * 8000, "not JSON"),
        (b"[1]", "not an object"),
        (b'{"device": "head", "t": 1e999, "q": [1,0,0,0]}', "not finite"),
        (b"x" * 9000, "datagram too long"),
    ],
)
def test_hostile_datagrams(datagram: bytes, reason: str) -> None:
    [refused] = decoded(datagram)
    assert isinstance(refused, Rejected)
    assert refused.reason == reason


def test_a_bad_line_does_not_spoil_its_neighbours() -> None:
    good = json.dumps(GOOD).encode()
    kinds = [type(p) for p in decoded(good + b"\nnonsense\n\n" + good)]
    assert kinds == [Packet, Rejected, Packet]


def test_lines_of_a_datagram_are_bounded() -> None:
    """What is beyond the 64th costs nothing and counts once: 4096 lines fit into a datagram."""
    taken = decoded(b"1\n" * 4096)
    assert len(taken) == packets.MAX_MESSAGES + 1
    assert all(isinstance(f, Rejected) for f in taken)
    assert [f.reason for f in taken[-2:]] == ["not an object", "too many lines"]  # type: ignore[union-attr]
    small = b'{"device":"a","t":0,"q":[1,0,0,0]}\n'
    assert all(isinstance(f, Packet) for f in decoded(b"\n" + small * 64))
    *good, last = decoded(small * 65)
    assert len(good) == 64 and all(isinstance(f, Packet) for f in good)
    assert isinstance(last, Rejected) and last.reason == "too many lines"


leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
words = st.sampled_from(["watch", "", "x"])
values = (
    leaves
    | st.lists(leaves, max_size=5)
    | st.dictionaries(words, leaves, max_size=3)
    | st.lists(st.lists(leaves, max_size=2), max_size=4)
)


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)  # a busy machine is no fault
@given(st.fixed_dictionaries({}, optional=dict.fromkeys((*GOOD, "screen", "distances"), values)))
def test_any_object_is_taken_or_refused(fields: dict[str, Any]) -> None:
    for change in (fields, GOOD | fields):
        for found in decoded(json.dumps(change).encode()):
            if isinstance(found, Rejected):
                assert found.reason in REASONS
            elif found.R_world_sensor is not None:
                assert ori.is_rotation(found.R_world_sensor)


@given(st.binary(max_size=300))
def test_any_bytes_are_taken_or_refused(datagram: bytes) -> None:
    assert all(isinstance(f, Rejected) and f.reason in REASONS for f in decoded(datagram))
