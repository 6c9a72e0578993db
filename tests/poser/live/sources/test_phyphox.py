"""phyphox: golden answers, and a simulated phone that serves its remote access over the loopback."""

from __future__ import annotations

import json
import threading
import time as real
from collections.abc import Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit
from xml.etree import ElementTree

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import synthesis
from mocap.recording import Recording
from mocap.synthesis import motions
from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.sources import phyphox
from poser.live.sources.phyphox import Phyphox, Poller, inputs
from poser.live.sources.threads import Letter, Threaded
from tests.poser.live.sources.conftest import RATE, wxyz, zup

ROOT = Path(__file__).resolve().parents[4]
CONFIG = {
    "crc32": "1f", "title": "Body tracking",
    "inputs": [
        {"source": "attitude", "outputs": [{"x": "attX"}, {"y": "attY"}, {"z": "attZ"}, {"abs": "attW"},
                                           {"t": "attT"}]},
        {"source": "linear_acceleration", "outputs": [{"x": "accX"}, {"y": "accY"}, {"z": "accZ"},
                                                      {"t": "accT"}]},
        {"source": "gravity", "outputs": [{"x": "gX"}, {"y": "gY"}, {"z": "gZ"}, {"t": "gT"}]},
        {"source": "audio", "outputs": [{"out": "recording"}]},
    ],
}  # fmt: skip


def answer(buffers: dict[str, list[Any]], session: str = "1a", measuring: bool = True) -> bytes:
    """As the app writes it."""
    return json.dumps({
        "buffer": {n: {"size": 0, "updateMode": "partial", "buffer": v} for n, v in buffers.items()},
        "status": {"session": session, "measuring": measuring, "timedRun": False, "countDown": 0},
    }).encode()  # fmt: skip


def read(reader: Phyphox, body: bytes, what: bytes = phyphox.ANSWERED) -> list[Packet | Rejected]:
    return list(reader.read(Letter(what + body, "phone:8080", 1.0)))


@pytest.fixture
def reader() -> Phyphox:
    """One that knows the experiment."""
    reader = Phyphox()
    assert read(reader, phyphox.described(inputs(CONFIG)), phyphox.DESCRIBED) == []
    return reader


def test_the_experiment_tells_its_buffers() -> None:
    attitude, acceleration, gravity = inputs(CONFIG)
    assert (attitude.time, attitude.parts) == ("attT", ("attW", "attX", "attY", "attZ"))
    assert acceleration.query(None) == "accT=full&accX=full&accY=full&accZ=full"
    assert gravity.query(12.5) == "gT=12.5|gT&gX=12.5|gT&gY=12.5|gT&gZ=12.5|gT"
    with pytest.raises(Rejected, match="experiment without attitude"):
        inputs({"inputs": CONFIG["inputs"][1:]})


def test_an_answer_of_the_documented_form(reader: Phyphox) -> None:
    times = [k / 100 for k in range(20)]
    still = {"gX": [0.0] * 20, "gY": [0.0] * 20, "gZ": [9.81] * 20, "gT": times}
    turned = {
        "attX": [0.0] * 20,
        "attY": [0.0] * 20,
        "attZ": [0.0] * 20,
        "attW": [1.0] * 20,
        "attT": times,
    }
    felt = {"accX": [0.0] * 20, "accY": [0.0] * 20, "accZ": [1.0] * 20, "accT": times}
    found = read(reader, answer(still | turned | felt))
    assert len(found) == 20
    last = found[-1]
    assert isinstance(last, Packet) and last.device == "phone:8080"
    np.testing.assert_allclose(last.R_world_sensor, ori.R_YUP_ZUP)
    np.testing.assert_allclose(last.acc_world, [0, 1, 0], atol=1e-9)
    # A hole in a buffer is one sample.
    [bad] = read(
        reader, answer({"attX": [None], "attY": [0], "attZ": [0], "attW": [1], "attT": [1.0]})
    )
    assert isinstance(bad, Rejected) and bad.reason == "field missing"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"<html>", "not JSON"),
        (
            answer({n: [0.0] * 5001 for n in ("attX", "attY", "attZ", "attW", "attT")}),
            "too many samples",
        ),
        (
            answer({n: [0.0] for n in ("attX", "attY", "attZ", "attW", "attT")}),
            "not a unit quaternion",
        ),
    ],
)
def test_what_does_not_fit_is_refused(reader: Phyphox, body: bytes, reason: str) -> None:
    [found] = read(reader, body)
    assert isinstance(found, Rejected) and found.reason == reason


def test_other_answers_make_nothing(reader: Phyphox) -> None:
    for body in (
        b"3",
        b"[]",
        b"{}",
        b'{"buffer": 3, "status": []}',
        b'{"buffer": {"attT": {"buffer": 3}}}',
    ):
        assert [f for f in read(reader, body) if isinstance(f, Packet)] == []


class SimulatedPhone:
    """Serves what it has measured since the threshold, as the app does, at its own pace."""

    def __init__(self, recording: Recording):
        self.recording, self.began = recording, real.monotonic()
        self.session, self.slow_s = "1a", 0.0
        self.asked = 0
        phone = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                body = phone.serve(self.path)
                try:
                    self.send_response(200)
                    self.send_header("Content-Length", str(len(body)))
                    self.end_headers()
                    self.wfile.write(body)
                except OSError:
                    return

            def log_message(self, format: str, *args: object) -> None: ...

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True).start()

    @property
    def address(self) -> Address:
        return Address("127.0.0.1", self.server.server_address[1])

    def serve(self, path: str) -> bytes:
        self.asked += 1
        real.sleep(self.slow_s)
        split = urlsplit(path)
        if split.path == "/config":
            return json.dumps(CONFIG).encode()
        now = real.monotonic() - self.began
        last = min(len(self.recording), int(now * RATE))
        buffers: dict[str, list[Any]] = {}
        for name, asked in parse_qsl(split.query):
            threshold = -np.inf if asked == "full" else float(asked.partition("|")[0]) + 1e-6
            rows = [k for k in range(last) if k / RATE > threshold]
            buffers[name] = [self._value(name, k) for k in rows]
        return answer(buffers, self.session)

    def _value(self, name: str, k: int) -> float:
        R, acc = self.recording.R_world_bone[k, 0], np.nan_to_num(self.recording.acc_world[k, 0])
        if name.endswith("T"):
            return float(f"{k / RATE:.7e}")
        if name.startswith("att"):
            return wxyz(zup(R))["WXYZ".index(name[-1])]
        v = R.T @ (acc if name.startswith("acc") else np.array([0, 9.80665, 0]))
        return float(v["XYZ".index(name[-1])])

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture(scope="module")
def carried() -> Recording:
    return synthesis.recording(motions.walk(4.0), ("right_pocket",)).slice(1, 200)


@pytest.fixture
def phone(carried: Recording) -> Iterator[SimulatedPhone]:
    found = SimulatedPhone(carried)
    yield found
    found.close()


def listen(intake: Threaded, seconds: float) -> list[tuple[Packet, float]]:
    found, until = [], real.monotonic() + seconds
    while real.monotonic() < until:
        found += [(p, at) for p, at, _ in intake.receive(0.02)]
    return found


def test_a_simulated_phone_is_followed(phone: SimulatedPhone, carried: Recording) -> None:
    """Each sample once, with the acceleration of its time, as old as it was measured before the newest."""
    with closing(Threaded(Phyphox(), Poller((phone.address,)))) as intake:
        intake.open()
        found = listen(intake, 2.0)
    assert len(found) > 60
    times = [p.time_s for p, _ in found]
    assert (np.diff(times) > 0).all() and np.diff(times).max() < 1.5 / RATE
    for p, _ in found[20:]:
        k = round(p.time_s * RATE)
        np.testing.assert_allclose(p.R_world_sensor, carried.R_world_bone[k, 0], atol=1e-5)
        np.testing.assert_allclose(p.acc_world, np.nan_to_num(carried.acc_world[k, 0]), atol=1e-4)
    offset = np.array([at - p.time_s for p, at in found])
    assert np.ptp(offset) < 1.5  # a busy machine answers late
    assert found[0][0].device == str(phone.address)


def test_a_dead_or_slow_phone_keeps_nobody_waiting(phone: SimulatedPhone) -> None:
    """One that answers, one that is slow, one that is not there."""
    slow = SimulatedPhone(phone.recording)
    slow.slow_s = 5.0
    gone = Address("127.0.0.1", 9)
    intake = Threaded(Phyphox(), Poller((phone.address, slow.address, gone)))
    intake.open()
    looks, until, devices = [], real.monotonic() + 1.5, set()
    while real.monotonic() < until:
        began = real.monotonic()
        devices |= {p.device for p, _, _ in intake.receive(0.01)}
        looks.append(real.monotonic() - began)
    began = real.monotonic()
    intake.close()
    assert devices == {str(phone.address)}
    assert np.median(looks) < 0.1
    assert intake.rejected["no answer"] >= 1
    assert real.monotonic() - began < 2 * phyphox.ANSWER_S + 3
    slow.close()


def test_a_measurement_that_begins_anew(phone: SimulatedPhone) -> None:
    with closing(Threaded(Phyphox(), Poller((phone.address,)))) as intake:
        intake.open()
        before = listen(intake, 0.8)
        phone.began, phone.session = real.monotonic(), "2b"
        after = listen(intake, 0.8)
    assert before[-1][0].time_s > 0.2
    assert min(p.time_s for p, _ in after[-5:]) < 1.0 and len(after) > 10


def test_the_experiment_of_the_examples_has_the_inputs() -> None:
    tree = ElementTree.parse(ROOT / "examples" / "poser.phyphox")
    config = {"inputs": [
        {"source": s.attrib["type"], "outputs": [{o.attrib["component"]: o.text} for o in s.iter("output")]}
        for s in tree.iter("sensor")
    ]}  # fmt: skip
    assert {i.source for i in inputs(config)} == set(phyphox.INPUTS)
    containers = {c.text for c in tree.iter("container")}
    assert {n for i in inputs(config) for n in (i.time, *i.parts)} <= containers
