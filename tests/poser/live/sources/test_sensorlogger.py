"""Sensor Logger: golden JSON, systems that differ in sign and unit, and simulated phones over HTTP."""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time as real
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import synthesis
from mocap.recording import Recording
from mocap.synthesis import motions
from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.sources import pushed
from poser.live.sources.pushed import PushServer
from poser.live.sources.sensorlogger import SensorLogger
from poser.live.sources.threads import Letter, Threaded
from tests.poser.live.sources.conftest import (
    RATE,
    Time,
    accelerations,
    heard,
    same_poses,
    wxyz,
    zup,
)

G = 9.80665
GOLDEN = b"""{"messageId": 7, "sessionId": "s", "deviceId": "d", "payload": [
 {"name": "orientation", "time": 1698501144401773000,
  "values": {"qx": 0, "qy": 0, "qz": 0, "qw": 1, "roll": 0, "pitch": 0, "yaw": 0}},
 {"name": "accelerometer", "time": 1698501144400000000, "values": {"x": 0, "y": 0, "z": 1}},
 {"name": "accelerometer", "time": 1698501144410000000, "values": {"x": 0, "y": 0, "z": 1}},
 {"name": "battery", "time": 1698501144410000000, "values": {"batteryLevel": 0.5}},
 {"name": "barometer", "time": 1698501144410000000, "values": {"relativeAltitude": 0.1}}]}"""


def read(reader: SensorLogger, body: bytes, sender: str = "10.0.0.2", at: float = 1.0) -> list:
    return list(reader.read(Letter(body, sender, at)))


def test_a_batch_of_the_documented_form() -> None:
    reader = SensorLogger()
    [packet] = read(reader, GOLDEN)
    assert isinstance(packet, Packet) and packet.device == "d"
    assert packet.time_s == pytest.approx(1698501144.401773, abs=1e-6)
    np.testing.assert_allclose(packet.R_world_sensor, ori.R_YUP_ZUP)
    # Without gravity nobody knows its sign.
    assert packet.acc_world is not None and np.isnan(packet.acc_world).all()
    told = reader.heard()["d"]
    assert told.battery == 0.5 and "no gravity" in told.note


Carried = tuple[str, dict[str, str], Callable[[np.ndarray], dict], Callable[[np.ndarray], dict]]


def entry(name: str, t: float, values: dict[str, float]) -> dict:
    return {"name": name, "time": round(t * 1e9), "values": values}


class Phone:
    """A simulated device: how its system writes what it measures."""

    def __init__(self, device: str, kind: str, sign: float, unit: float, inverse: bool = False):
        self.device, self.kind, self.sign, self.unit, self.inverse = (
            device,
            kind,
            sign,
            unit,
            inverse,
        )
        self.messages = 0

    def samples(self, R: np.ndarray, acc: np.ndarray, t: float) -> list[dict]:
        R_zup = zup(R)
        w, x, y, z = wxyz(R_zup.T if self.inverse else R_zup)
        a = self.sign * (R.T @ np.nan_to_num(acc)) / self.unit
        g = self.sign * (R.T @ np.array([0, G, 0])) / self.unit
        if self.kind == "phone":
            return [
                entry("orientation", t, {"qw": w, "qx": x, "qy": y, "qz": z}),
                entry("accelerometer", t + 1e-4, dict(zip("xyz", a.tolist(), strict=True))),
                entry("gravity", t - 1e-4, dict(zip("xyz", g.tolist(), strict=True))),
            ]
        values = dict(zip(("quaternionW", "quaternionX", "quaternionY", "quaternionZ"), (w, x, y, z),
                          strict=True))  # fmt: skip
        # Earphones' gravity is in m/s^2 whatever the acceleration is in.
        gravity = g * self.unit if self.kind == "headphone" else g
        for axis, ai, gi in zip("XYZ", a.tolist(), gravity.tolist(), strict=True):
            values |= {f"acceleration{axis}": ai, f"gravity{axis}": gi}
        return [entry("wristMotion" if self.kind == "watch" else "headphone", t, values)]

    def batch(self, payload: list[dict]) -> bytes:
        self.messages += 1
        return json.dumps(
            {
                "messageId": self.messages,
                "sessionId": "s",
                "deviceId": self.device,
                "payload": payload,
            }
        ).encode()

    @property
    def name(self) -> str:
        return self.device + ("" if self.kind == "phone" else f"/{self.kind}")


SYSTEMS = {
    "android": ("phone", 1.0, 1.0, False),
    "iphone": ("phone", -1.0, 1.0, False),
    "watch in g": ("watch", -1.0, G, False),
    "watch, standardised": ("watch", 1.0, 1.0, False),
    "world to device": ("phone", 1.0, 1.0, True),
    "earphones": ("headphone", -1.0, G, False),
}


@pytest.fixture(scope="module")
def carried() -> Recording:
    return synthesis.recording(
        motions.builtin(seconds=5.1), ("left_wrist", "right_pocket", "head")
    ).slice(1, 301)


@pytest.mark.parametrize("system", SYSTEMS)
def test_signs_and_units_are_found_by_gravity(carried: Recording, system: str) -> None:
    phone, reader = Phone("d", *SYSTEMS[system]), SensorLogger()
    found = []
    for k in range(0, 300, 10):
        rows = [
            e
            for i in range(k, k + 10)
            for e in phone.samples(carried.R_world_bone[i, 0], carried.acc_world[i, 0], i / RATE)
        ]
        found += read(reader, phone.batch(rows), at=float(k))
    assert all(isinstance(p, Packet) for p in found) and len(found) >= 299
    for p in found[30:290]:
        k = round(p.time_s * RATE)
        np.testing.assert_allclose(p.R_world_sensor, carried.R_world_bone[k, 0], atol=1e-6)
        np.testing.assert_allclose(p.acc_world, carried.acc_world[k, 0], atol=0.15)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"{", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"[1]", "not an object"),
        (b'{"deviceId": "d"}', "field missing"),
        (b'{"deviceId": 3, "payload": []}', "wrong type"),
        (b'{"deviceId": "a\\u0007", "payload": []}', "out of range"),
        (json.dumps({"deviceId": "d", "payload": [0] * 20_001}).encode(), "too many samples"),
        (json.dumps({"deviceId": "d", "payload": [entry("gravity", 1, {"x": 1})]}).encode(),
         "field missing"),
        (b'{"deviceId": "d", "payload": '
         b'[{"name": "gravity", "time": 1, "values": {"x": NaN, "y": 0, "z": 0}}]}',
         "not finite"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(body: bytes, reason: str) -> None:
    [found] = read(SensorLogger(), body)
    assert isinstance(found, Rejected) and found.reason == reason


def test_a_second_device_of_the_same_name_and_a_restart() -> None:
    reader = SensorLogger()
    read(reader, GOLDEN, at=1.0)
    [found] = read(reader, GOLDEN, sender="10.0.0.3", at=2.0)
    assert isinstance(found, Rejected) and found.reason == "name taken by another device"
    assert isinstance(read(reader, GOLDEN, sender="10.0.0.3", at=4.0)[0], Packet)
    # The same phone begins a new session, with a clock that was set back: no sample of it is late.
    again = GOLDEN.replace(b'"s"', b'"s2"').replace(b"1698501144", b"1698501100")
    assert isinstance(read(reader, again, sender="10.0.0.3", at=4.1)[0], Packet)


def test_missing_messages_are_counted() -> None:
    reader = SensorLogger()
    read(reader, GOLDEN)
    read(reader, GOLDEN.replace(b'"messageId": 7', b'"messageId": 10'))
    assert reader.heard()["d"].lost == 2


Served = tuple[Threaded, Time, int]


@pytest.fixture
def served() -> Iterator[Served]:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    time = Time()
    with closing(Threaded(SensorLogger(), PushServer(Address("127.0.0.1", port)), time)) as intake:
        yield intake, time, port


def post(port: int, body: bytes, method: str = "POST", path: str = "/data") -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request(method, path, body, {"Content-Type": "application/json"})
        return connection.getresponse().status
    finally:
        connection.close()


def test_simulated_phones_give_the_poses_of_the_recording(
    carried: Recording, served: Served
) -> None:
    """An iPhone, an Android phone and a watch, each in batches of 0.2 s, over HTTP."""
    intake, time, port = served
    kinds = [("w", *SYSTEMS["watch in g"]), ("p", *SYSTEMS["android"]), ("h", *SYSTEMS["iphone"])]
    phones = [Phone(*k) for k in kinds]
    waiting: list[list[dict]] = [[], [], []]

    def send(k: int) -> None:
        for s, phone in enumerate(phones):
            waiting[s] += phone.samples(
                carried.R_world_bone[k, s], carried.acc_world[k, s], 1e9 + k / RATE
            )
            if (k + 4 * s) % 12 == 11:
                assert post(port, phone.batch(waiting[s])) == 200
                waiting[s] = []

    where = {p.name: n for p, n in zip(phones, carried.sensors, strict=True)}
    source, got = heard(intake, time, carried, send, where, delay_s=0.5, frames=300)
    same_poses(got, carried, round(got[0].time_s), within_deg=0.5)
    found, expected = accelerations(got, carried)
    moving = slice(60, 250)
    assert np.sqrt(np.nanmean((found[moving] - expected[moving]) ** 2)) < 0.3
    assert source.facts()["rejected"] == {}
    assert "g, sign reversed" in source.facts()["heard"]["w/watch"]["note"]


def test_the_server_takes_posts_alone_and_bounded(served: Served) -> None:
    intake, _, port = served
    intake.open()
    assert post(port, b"", "GET", "/../../etc/passwd") == 405
    assert post(port, b"x" * 10, "PUT") == 405
    with socket.create_connection(("127.0.0.1", port)) as s:
        s.sendall(b"POST / HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n")
        assert b" 413 " in s.recv(100)
    with socket.create_connection(("127.0.0.1", port)) as s:
        s.sendall(b"POST / HTTP/1.1\r\n\r\n")
        assert b" 411 " in s.recv(100)
    with socket.create_connection(("127.0.0.1", port)) as s:
        s.sendall(b"\xff\x00 nonsense\r\n\r\n")
        s.recv(100)
    assert post(port, GOLDEN) == 200
    assert [p.device for p, _, _ in intake.receive(0.5)] == ["d"]
    assert intake.rejected["not a POST"] == 2 and intake.rejected["body too large"] == 1


def test_slow_peers_keep_nobody_waiting(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """A body that drips, and more connections than are taken: posts of others get through, looks end."""
    monkeypatch.setattr(pushed, "PATIENCE_S", 0.4)
    monkeypatch.setattr(pushed._Handler, "timeout", 0.4)
    intake, _, port = served
    intake.open()
    stop = threading.Event()

    def drip() -> None:
        with socket.create_connection(("127.0.0.1", port)) as s:
            s.sendall(b"POST / HTTP/1.1\r\nContent-Length: 1000\r\n\r\n")
            while not stop.wait(0.1):
                try:
                    s.sendall(b" ")
                except OSError:
                    return

    threads = [threading.Thread(target=drip, daemon=True) for _ in range(8)]
    for t in threads:
        t.start()
    assert post(port, GOLDEN) == 200
    began = real.monotonic()
    assert [p.device for p, _, _ in intake.receive(0.1)] == ["d"]
    assert real.monotonic() - began < 5.0
    idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(40)]
    real.sleep(0.8)
    for s in idle:
        s.close()
    stop.set()
    for t in threads:
        t.join()
    assert post(port, GOLDEN.replace(b'"d"', b'"e"')) == 200
    list(intake.receive(0.1))
    assert intake.rejected["too many connections"] > 0
    assert intake.rejected["body too slow"] + intake.rejected["connection broke off"] > 0


def test_a_taken_port_is_one_sentence(served: Served) -> None:
    from mocap.errors import PoserError

    _, _, port = served
    with socket.socket() as s:
        s.bind(("127.0.0.1", port))
        s.listen()
        other = Threaded(SensorLogger(), PushServer(Address("127.0.0.1", port)))
        with pytest.raises(PoserError, match=f"cannot listen on 127.0.0.1:{port}"):
            other.open()
