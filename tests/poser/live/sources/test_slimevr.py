"""SlimeVR: bytes of the documented layout, and simulated trackers over the loopback."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.recording import Recording
from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.sources import slimevr
from poser.live.sources.conversation import Conversation
from poser.live.sources.slimevr import SlimeVR
from tests.poser.live.sources.conftest import (
    Time,
    accelerations,
    heard,
    only,
    same_poses,
    wxyz,
    zup,
)

MAC = bytes.fromhex("a4cf12000001")
HOST = ("127.0.0.1", 5000)


def introduction(mac: bytes = MAC, protocol: int = 22, firmware: bytes = b"0.7.2") -> bytes:
    """A handshake: type 3, number 0, board 4, imu 13, mcu 2, three zeros, protocol, firmware, MAC, type."""
    return (
        struct.pack(">IQ7i", 3, 0, 4, 13, 2, 0, 0, 0, protocol)
        + bytes([len(firmware)]) + firmware + mac + b"\x01"
    )  # fmt: skip


def told(
    server: SlimeVR, *datagrams: bytes, now: float = 1.0, sender: tuple = HOST
) -> list[object]:
    return [found for d in datagrams for found in server.hear(d, sender, now)]


@pytest.fixture
def server() -> SlimeVR:
    """One that has met a tracker of the present protocol."""
    server = SlimeVR()
    assert told(server, introduction()) == []
    return server


def test_the_handshake_is_answered() -> None:
    server = SlimeVR()
    golden = bytes.fromhex(
        "00000003 0000000000000000 00000004 0000000d 00000002 00000000 00000000 00000000 00000016"
        "05 302e372e32 a4cf12000001 01"
    )
    assert golden == introduction()
    assert told(server, golden) == []
    greeting, *rest = list(server.letters(1.0))
    assert greeting == (b"\x03Hey OVR =D 5" + bytes(51), HOST)
    assert [letter[:4] for letter, _ in rest] == [b"\0\0\0\x01", b"\0\0\0\x0a"]
    assert server.heard(1.0) == {}  # no sensor yet


def test_sensor_info_is_acknowledged_without_a_number(server: SlimeVR) -> None:
    list(server.letters(1.0))
    info = bytes.fromhex("0000000f 0000000000000001 01 01 0d 0000 01 05 00")
    assert told(server, info) == []
    assert list(server.letters(1.1)) == [(bytes.fromhex("0000000f 01 01"), HOST)]
    assert list(server.heard(1.1)) == ["a4:cf:12:00:00:01/1"]
    told(server, bytes.fromhex("0000000f 0000000000000002 01 02 0d"))
    assert "fault" in server.heard(1.1)["a4:cf:12:00:00:01/1"].note


# x 0.5, y 0.5, z 0.5, w 0.5: x becomes y, y becomes z, z becomes x, in a z-up world.
ROTATION = "00000011 0000000000000001 00 01 3f000000 3f000000 3f000000 3f000000 00"
ACCELERATION = "00000004 0000000000000002 3f800000 00000000 00000000 00"


def test_rotation_then_acceleration(server: SlimeVR) -> None:
    assert told(server, bytes.fromhex(ROTATION)) == []
    packet = only(told(server, bytes.fromhex(ACCELERATION), now=1.002))
    assert packet.device == "a4:cf:12:00:00:01/0"
    assert packet.time_s == 1.0
    R_zup = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert packet.R_world_sensor is not None and packet.acc_world is not None
    np.testing.assert_allclose(ori.R_ZUP_YUP @ packet.R_world_sensor, R_zup, atol=1e-7)
    # 1 m/s^2 along the sensor's x is along y of the z-up world, which is -z of ours.
    np.testing.assert_allclose(packet.acc_world, [0, 0, -1], atol=1e-7)


def test_old_boards_have_turned_accelerations() -> None:
    server = SlimeVR()
    told(server, introduction(protocol=21), bytes.fromhex(ROTATION))
    packet = only(told(server, bytes.fromhex(ACCELERATION)))
    # x of the board is -y of the sensor; -y is -z of the z-up world, which is -y of ours.
    np.testing.assert_allclose(packet.acc_world, [0, -1, 0], atol=1e-7)


def test_a_rotation_without_acceleration_goes_on(server: SlimeVR) -> None:
    told(server, bytes.fromhex(ROTATION))
    assert list(server.due(1.0 + slimevr.HOLD_S / 2)) == []
    [packet] = server.due(1.0 + slimevr.HOLD_S)
    assert packet.acc_world is not None and np.isnan(packet.acc_world).all()
    # Once none came for long, the next ones do not wait.
    later = struct.pack(">IQ", 17, 5) + bytes.fromhex(ROTATION)[12:]
    assert only(told(server, later, now=3.0)).time_s == 3.0


def test_owotrack_s_acceleration_has_no_sensor(server: SlimeVR) -> None:
    told(server, bytes.fromhex(ROTATION))
    assert only(told(server, bytes.fromhex(ACCELERATION)[:-1])).device.endswith("/0")


def compact(sensor: int, q_xyzw: list[int], acc: list[int]) -> bytes:
    return struct.pack(">B7h", sensor, *q_xyzw, *acc)


def test_compact_packets_in_bundles(server: SlimeVR) -> None:
    """16384 / 2^15 = 0.5; 256 / 2^7 = 2 m/s^2. In a compact bundle lengths and types are a byte."""
    golden = bytes.fromhex(
        "00000065 0000000000000001"
        "10 17 00 4000 4000 4000 4000 0100 0000 0000"
        "10 17 01 0000 0000 0000 7fff 0000 0000 ff80"
    )
    first, second = told(server, golden)
    assert isinstance(first, Packet) and isinstance(second, Packet)
    assert (first.device[-2:], second.device[-2:]) == ("/0", "/1")
    np.testing.assert_allclose(first.acc_world, [0, 0, -2], atol=1e-4)
    np.testing.assert_allclose(second.R_world_sensor, ori.R_YUP_ZUP, atol=1e-4)
    np.testing.assert_allclose(second.acc_world, [0, -1, 0], atol=1e-4)


def test_bundles(server: SlimeVR) -> None:
    parts = [bytes.fromhex(h)[:4] + bytes.fromhex(h)[12:] for h in (ROTATION, ACCELERATION)]
    battery = struct.pack(">I2f", 12, 3.9, 0.75)
    bundle = b"".join(struct.pack(">H", len(p)) + p for p in [*parts, battery, b""])
    packet = only(told(server, struct.pack(">IQ", 100, 7) + bundle))
    np.testing.assert_allclose(packet.acc_world, [0, 0, -1], atol=1e-7)
    assert server.heard(1.0)[packet.device].battery == pytest.approx(0.75)


def test_ping_and_features(server: SlimeVR) -> None:
    letters = {letter[:4]: letter for letter, _ in server.letters(1.0)}
    ping = letters[b"\0\0\0\x0a"]
    assert told(server, ping, now=1.024) == []  # trackers send it back as it is
    told(server, bytes.fromhex(ROTATION))
    assert server.heard(1.0)["a4:cf:12:00:00:01/0"].ping_ms == pytest.approx(12.0)
    told(server, bytes.fromhex("00000016 0000000000000002 00"))
    answer = [letter for letter, _ in server.letters(1.1)]
    assert answer == [bytes.fromhex("00000016 0000000000000000 03")]
    assert [letter[3] for letter, _ in server.letters(1.6)] == [1, 10]


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", "too short"),
        (b"\0\0\0\x11", "too short"),
        (bytes.fromhex(ROTATION)[:20], "too short"),
        (bytes.fromhex("00000011 0000000000000009 00 01 00000000 00000000 00000000 00000000 00"),
         "not a unit quaternion"),
        (bytes.fromhex("00000011 0000000000000009 00 01 7fc00000 00000000 00000000 3f800000 00"),
         "not finite"),
        (bytes.fromhex("00000004 0000000000000009 7f800000 00000000 00000000 00"), "not finite"),
        (struct.pack(">IQ", 77, 9), "type unknown"),
        (struct.pack(">IQ", 101, 9) + b"\x10\x17\x00", "too short"),
        (b"\0" * 9000, "datagram too long"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(server: SlimeVR, datagram: bytes, reason: str) -> None:
    [found] = told(server, datagram)
    assert isinstance(found, Rejected) and found.reason == reason


def test_strangers_are_refused() -> None:
    [found] = told(SlimeVR(), bytes.fromhex(ROTATION))
    assert isinstance(found, Rejected) and found.reason == "no handshake"


def test_a_bundle_holds_so_many(server: SlimeVR) -> None:
    part = b"\x10\x17" + compact(0, [0, 0, 0, 32767], [0, 0, 0])
    found = told(server, struct.pack(">IQ", 101, 1) + part * 100)
    assert sum(isinstance(f, Rejected) for f in found) == 1 and len(found) == 65


def test_a_second_board_of_the_same_name_waits_until_the_first_is_gone(server: SlimeVR) -> None:
    other = ("127.0.0.1", 6000)
    [found] = told(server, introduction(), now=1.5, sender=other)
    assert isinstance(found, Rejected) and found.reason == "name taken by another device"
    assert told(server, introduction(), now=2.6, sender=other) == []
    told(server, bytes.fromhex(ROTATION), now=2.7, sender=other)
    [packet] = server.due(2.8)
    assert packet.device == "a4:cf:12:00:00:01/0"
    [late] = told(server, bytes.fromhex(ROTATION), now=2.8)
    assert isinstance(late, Rejected) and late.reason == "no handshake"


def test_boards_are_bounded() -> None:
    server = SlimeVR()
    for k in range(40):
        told(server, introduction(bytes([1, 2, 3, 4, 5, k])), sender=("127.0.0.1", 6000 + k))
    [found] = told(server, introduction(b"\1\2\3\4\5\xff"), sender=("127.0.0.1", 7000))
    assert isinstance(found, Rejected) and found.reason == "too many devices"
    # Those that are gone make room.
    assert told(server, introduction(b"\1\2\3\4\5\xff"), now=9.0, sender=("127.0.0.1", 7000)) == []


def test_random_bytes_stop_nothing(server: SlimeVR) -> None:
    rng = np.random.default_rng(5)
    good = [bytes.fromhex(ROTATION), bytes.fromhex(ACCELERATION), introduction()]
    for k in range(3000):
        bad = bytearray(good[k % 3] if k % 2 else rng.bytes(int(rng.integers(0, 80))))
        for at in rng.integers(0, max(1, len(bad)), size=3):
            if bad:
                bad[at] = rng.integers(256)
        for found in server.hear(bytes(bad), HOST, 1.0 + k / 1000):
            assert isinstance(found, Packet | Rejected)
        list(server.letters(1.0 + k / 1000))


class Trackers:
    """Six trackers of our own, each with a socket, that replay a recording as firmware does."""

    def __init__(self, recording: Recording, port: int, way: str, lose: float = 0.0):
        self._recording, self._to, self._way = recording, ("127.0.0.1", port), way
        self._rng = np.random.default_rng(1)
        self._lose = lose
        self.sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in recording.sensors]
        for s in self.sockets:
            s.setblocking(False)
        self.numbers = [0] * len(self.sockets)
        self.held: list[bytes | None] = [None] * len(self.sockets)
        self.greeted = [False] * len(self.sockets)
        self.swap: set[int] = set()
        self.off: set[int] = set()

    @staticmethod
    def mac(s: int) -> bytes:
        return MAC[:5] + bytes([s])

    def where(self) -> dict[str, str]:
        return {f"{self.mac(s).hex(':')}/0": n for s, n in enumerate(self._recording.sensors)}

    def restart(self, s: int) -> None:
        """Switched off and on: numbers begin anew, and it has to be met again."""
        self.numbers[s], self.greeted[s] = 0, False

    def listen(self, s: int) -> list[bytes]:
        out = []
        while True:
            try:
                out.append(self.sockets[s].recv(256))
            except BlockingIOError:
                return out

    def send(self, k: int) -> None:
        for s in range(len(self.sockets)):
            if s in self.off:
                continue
            for letter in self.listen(s):
                self.greeted[s] |= letter.startswith(b"\x03Hey OVR")
                if letter[:4] == b"\0\0\0\x0a":
                    self.sockets[s].sendto(letter, self._to)
            if not self.greeted[s]:
                self.sockets[s].sendto(introduction(self.mac(s)), self._to)
                continue
            for datagram in self._frame(s, k):
                if self._rng.random() < self._lose:
                    continue
                if k in self.swap and self.held[s] is None:
                    self.held[s] = datagram
                    continue
                self.sockets[s].sendto(datagram, self._to)
                if (kept := self.held[s]) is not None and k not in self.swap:
                    self.sockets[s].sendto(kept, self._to)
                    self.held[s] = None

    def _frame(self, s: int, k: int) -> Iterator[bytes]:
        R, acc = self._recording.R_world_bone[k, s], self._recording.acc_world[k, s]
        felt = np.nan_to_num(R.T @ acc)
        w, *xyz = wxyz(zup(R))
        if self._way == "compact":
            q = np.round(np.array([*xyz, w]) * 32767).astype(int).tolist()
            yield self._numbered(
                s, 101, b"\x10\x17" + compact(0, q, np.round(felt * 128).astype(int).tolist())
            )
            return
        turn = struct.pack(">BB4fB", 0, 1, *xyz, w, 0)
        pull = struct.pack(">3fB", *felt, 0)
        if self._way == "bundle":
            parts = [struct.pack(">I", kind) + p for kind, p in ((17, turn), (4, pull))]
            yield self._numbered(s, 100, b"".join(struct.pack(">H", len(p)) + p for p in parts))
        else:
            yield self._numbered(s, 17, turn)
            yield self._numbered(s, 4, pull)

    def _numbered(self, s: int, kind: int, body: bytes) -> bytes:
        self.numbers[s] += 1
        return struct.pack(">IQ", kind, self.numbers[s]) + body

    def close(self) -> None:
        for s in self.sockets:
            s.close()


@pytest.fixture
def time() -> Time:
    return Time()


@pytest.fixture
def intake(time: Time) -> Iterator[Conversation]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    found = Conversation(Address("127.0.0.1", port), SlimeVR(), time)
    yield found
    found.close()


@pytest.mark.parametrize("way", ["single", "bundle", "compact"])
def test_a_simulated_set_gives_the_poses_of_the_recording(
    worn: Recording, intake: Conversation, time: Time, way: str
) -> None:
    """Met in the first frames; then each frame's measurement is the sample of its time."""
    trackers = Trackers(worn, intake._to[1], way)
    source, got = heard(intake, time, worn, trackers.send, trackers.where())
    trackers.close()
    assert not intake.rejected
    # A frame to ask, one to be answered.
    first = 1
    assert _fits(got, worn, first)
    same_poses(got, worn, first, 0.02 if way == "compact" else 1e-3)
    found, expected = accelerations(got, worn, first)
    np.testing.assert_allclose(found[2:], expected[2:], atol=0.02 if way == "compact" else 1e-4)
    counts = source.facts()["devices"]
    assert all(c["lost"] == c["late"] == c["reordered"] == 0 for c in counts.values())


def _fits(got: list, recording: Recording, skip: int) -> bool:
    a = got[30]
    k = round(a.time_s * 60.0) + skip
    return bool(
        np.rad2deg(ori.angle_between(a.R_world_bone, recording.R_world_bone[k])).max() < 0.02
    )


def test_loss_reordering_restart(worn: Recording, intake: Conversation, time: Time) -> None:
    """2 % of the datagrams lost, some sent a frame late, one tracker off and on: the others go on, and it
    comes back; a second device of a name and random bytes are counted."""
    trackers = Trackers(worn, intake._to[1], "bundle", lose=0.02)
    trackers.swap = {60, 61, 120}
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(k: int) -> None:
        trackers.off = {2} if 150 <= k < 240 else set()
        if k == 150:
            trackers.restart(2)
        if k == 100:
            stranger.sendto(introduction(Trackers.mac(0)), trackers._to)
            stranger.sendto(b"\xff" * 40, trackers._to)
        trackers.send(k)

    source, got = heard(intake, time, worn, send, trackers.where())
    facts = source.facts()
    trackers.close()
    stranger.close()
    assert facts["rejected"]["name taken by another device"] == 1
    assert facts["rejected"]["no handshake"] == 1
    assert facts["rejected"]["out of order"] > 3
    name = {p: d for d, p in trackers.where().items()}
    lost = [facts["devices"][name[p]]["lost"] for p in worn.sensors]
    assert min(lost) > 1
    valid = np.array([s.valid for s in got])
    t = np.array([s.time_s for s in got])
    away = (t > 2.8) & (t < 3.8)
    assert not valid[away][:, 2].any()
    assert valid[away][:, [0, 1, 3, 4, 5]].mean() > 0.95
    assert valid[(t > 4.2) & (t < 5.8)].mean() > 0.95
    assert len(got) >= len(worn) - 10


def test_the_names_are_those_of_the_table() -> None:
    assert slimevr.SOURCE.spelling == "slimevr[:6969]" and slimevr.SOURCE.own_headings
