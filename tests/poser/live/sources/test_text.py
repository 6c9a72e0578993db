"""Text lines of the two research apps: golden lines, and simulated phones over the loopback."""

from __future__ import annotations

import socket
from contextlib import closing

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import synthesis
from mocap.recording import Recording
from mocap.synthesis import motions
from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.receiver import Receiver
from poser.live.sources.text import Text
from tests.poser.live.sources.conftest import (
    RATE,
    Time,
    accelerations,
    heard,
    only,
    same_poses,
    wxyz,
    zup,
)

G = 9.80665


def decoded(*datagrams: bytes) -> list[object]:
    decode = Text()
    return [found for d in datagrams for found in decode(d)]


def test_a_line_of_mobileposer() -> None:
    """t1 t2 ax ay az qx qy qz qw: iPhone's acceleration, in g and of opposite sign, along y."""
    packet = only(decoded(b"left;phone:1690000000.5 12.25 0 0.1 0 0 0 0 1\n"))
    assert (packet.device, packet.time_s) == ("left_phone", 12.25)
    np.testing.assert_allclose(packet.R_world_sensor, ori.R_YUP_ZUP, atol=1e-12)
    np.testing.assert_allclose(packet.acc_world, [0, 0, 0.1 * G], atol=1e-9)


LINE = "tom;watch;motion:{t} 0 0 {az} 0 0 {g} 0.1 0.2 0.3 0 0 0 1\n"


def test_lines_of_imucoco_and_their_gravity() -> None:
    """Joined by &, with a line break behind each; gravity tells sign and unit."""
    for g, az, up in ((-1.0, 0.5, -0.5 * G), (9.8, 2.0, 2.0), (-9.8, 2.0, -2.0)):
        parts = "&".join(
            LINE.format(t=k / 50, az=az, g=g).removeprefix("tom;watch;motion:") for k in range(30)
        )
        found = decoded(f"tom;watch;motion:{parts}".encode())
        last = found[-1]
        assert len(found) == 30 and isinstance(last, Packet) and last.device == "tom_watch"
        np.testing.assert_allclose(last.acc_world, [0, up, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"\xff\xfe;a:1", "not text"),
        (b"hello", "not ID;TYPE:numbers"),
        (b"a;b;c;d:1 2", "not ID;TYPE:numbers"),
        (b"a;phone:1 2 3", "wrong number of values"),
        (b"a;phone:" + b"1 " * 500, "wrong number of values"),
        (b"a;phone:1 2 0 x 0 0 0 0 1", "not a number"),
        (b"a;phone:1 2 0 nan 0 0 0 0 1", "not finite"),
        (b"a;phone:1 2 0 0 0 0 0 0 2", "not a unit quaternion"),
        (b"a;phone:1 1e300 0 0 0 0 0 0 1", "out of range"),
        (b"a" * 80 + b";phone:1 2 0 0 0 0 0 0 1", "out of range"),
        (b"x" * 9000, "datagram too long"),
    ],
)
def test_what_does_not_fit_is_refused(line: bytes, reason: str) -> None:
    [found] = decoded(line)
    assert isinstance(found, Rejected) and found.reason == reason


def test_devices_are_bounded() -> None:
    found = decoded(*(f"a{k};phone:1 2 0 0 0 0 0 0 1".encode() for k in range(40)))
    assert [f.reason for f in found if isinstance(f, Rejected)] == ["too many devices"] * 8


@pytest.fixture(scope="module")
def carried() -> Recording:
    """A watch, a phone and earphones."""
    return synthesis.recording(
        motions.builtin(seconds=4.1), ("left_wrist", "right_pocket", "head")
    ).slice(1, 241)


@pytest.mark.parametrize("app", ["mobileposer", "imucoco"])
def test_simulated_phones_give_the_poses_of_the_recording(carried: Recording, app: str) -> None:
    names = {"left_wrist": "w;watch", "right_pocket": "p;phone", "head": "h;phone"}
    time = Time()
    with (
        closing(Receiver(Address("127.0.0.1", 0), Text(), time)) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):

        def send(k: int) -> None:
            for s, place in enumerate(carried.sensors):
                R = carried.R_world_bone[k, s]
                w, x, y, z = wxyz(zup(R))
                a = -np.nan_to_num(R.T @ carried.acc_world[k, s]) / G
                down = -(R.T @ np.array([0, 1.0, 0]))
                t = 500 + k / RATE
                if app == "mobileposer":
                    text = f"{names[place]}:0 {t!r} {_words(a)} {x} {y} {z} {w}"
                else:
                    text = f"{names[place]};motion:{t!r} {_words(a)} {_words(down)} 0 0 0 {x} {y} {z} {w}\n"
                if not (k == 30 and s == 1):  # one lost
                    sender.sendto(text.encode(), ("127.0.0.1", receiver.port))
            if k == 10:
                sender.sendto(b"p;phone:0 1 0 0 0 0 0 0 1", ("127.0.0.1", receiver.port))

        where = {n.replace(";", "_"): p for p, n in names.items()}
        source, got = heard(receiver, time, carried, send, where)
    same_poses(got, carried, within_deg=0.1)
    found, expected = accelerations(got, carried)
    np.testing.assert_allclose(found[40:220], expected[40:220], atol=1e-3)
    assert source.facts()["rejected"] == {}
    assert len(got) >= len(carried) - 1


def _words(v: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in v)
