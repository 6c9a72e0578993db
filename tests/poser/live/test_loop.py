"""The loop end to end: replays, sockets, hostile senders, sinks that fail, Ctrl-C."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import synthesis
from mocap.errors import PoserError
from mocap.estimator import Pose, Sample, replay, samples
from mocap.formats import read
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.live import loop, osc_messages, packets, telling
from poser.live.addresses import Address
from poser.live.assembler import Assembler, Row
from poser.live.receiver import Receiver, y_up
from poser.live.recorder import Recorder
from poser.live.samples import Network, RecordingSource
from poser.live.sinks.motion_file import MotionFile
from tests.poser.live.conftest import Hold, packets_of

BODY = Skeleton.default()


class Collect:
    """A sink for tests."""

    name = "collect"

    def __init__(self) -> None:
        self.poses: list[Pose] = []
        self.closed = False

    def write(self, pose: Pose) -> None:
        self.poses.append(pose)

    def close(self) -> dict[str, Any]:
        self.closed = True
        return {}


class Time:
    """A clock that moves only when somebody sleeps."""

    def __init__(self) -> None:
        self.now = 50.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds


def drive(
    source: Any, sinks: list[Any], look_ahead: int = 0, tell: Any = lambda _: None
) -> loop.Report:
    report = loop.Report()
    source.open()
    loop.run(source, Hold(source.rate_hz, source.sensors, look_ahead), sinks, BODY, report, tell)
    loop.close(source, sinks, report)
    return report


@pytest.mark.parametrize("speed", [1.0, 4.0, None])
def test_a_replay_gives_what_the_batch_gives(recording: Recording, speed: float | None) -> None:
    clock, sink = Time(), Collect()
    report = drive(RecordingSource(recording, speed, clock, clock.sleep), [sink])
    estimator, state = Hold(recording.rate_hz, recording.sensors), ()
    for pose, sample in zip(sink.poses, samples(recording), strict=True):
        state, expected = estimator.step(state, sample)
        assert expected is not None
        # To rounding: a selection of sensors is projected onto SO(3) again.
        np.testing.assert_allclose(pose.R_parent_joint, expected.R_parent_joint, atol=1e-14)
        assert pose.time_s == sample.time_s
    spent = clock.now - 50.0
    assert spent == pytest.approx(0 if speed is None else recording.seconds / speed, abs=0.02)
    assert report.frames == report.samples == len(recording)
    p99 = report.lag.quantile_ms(0.99)
    assert p99 is None if speed is None else (p99 is not None and 0 <= p99 < 3)


def test_the_look_ahead_counts_as_latency(recording: Recording) -> None:
    clock = Time()
    report = drive(RecordingSource(recording, 1.0, clock, clock.sleep), [], look_ahead=5)
    assert report.lag.quantile_ms(0.5) == pytest.approx(5e3 / 60, abs=3)
    # The poses that come at the end, pushed out at once, would flatter it.
    assert len(report.lag) == len(recording) - 5
    assert (len(report.step), report.samples) == (len(recording), len(recording))


@pytest.mark.parametrize("frames", [120, 3])
def test_the_last_frames_come_out_whatever_the_look_ahead(
    recording: Recording, frames: int
) -> None:
    """As many poses as samples, those of the batch form, even of fewer samples than the look-ahead."""
    short, sink = recording.slice(0, frames), Collect()
    report = drive(RecordingSource(short, None), [sink], look_ahead=5)
    batch = replay(Hold(short.rate_hz, short.sensors, 5), short)
    assert report.frames == len(sink.poses) == frames
    R = np.stack([p.R_parent_joint for p in sink.poses])
    np.testing.assert_allclose(R, batch.motion.R_parent_joint, atol=1e-14)
    times = [p.time_s for p in sink.poses]
    np.testing.assert_allclose(times, [s.time_s for s in samples(short)])


class Slow(Hold):
    """Takes its time over each sample, by the test's clock."""

    clock: Time
    takes_s: float

    def step(self, state: tuple, sample: Sample) -> tuple[tuple, Pose | None]:
        self.clock.sleep(self.takes_s)
        return super().step(state, sample)


@pytest.mark.parametrize("takes", [0.5, 1.1, 2.0, 40.0])
def test_a_loop_that_is_too_slow_leaves_samples_out_and_says_so(
    recording: Recording, takes: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """However many frames' time a frame takes: never later than the bound and a frame, to the end."""
    clock, report, sink, told = Time(), loop.Report(), Collect(), list[str]()
    long = synthesis.recording(motions.walk(8.0))
    source = RecordingSource(long, 1.0, clock, clock.sleep)
    estimator = Slow(long.rate_hz, long.sensors)
    estimator.clock, estimator.takes_s = clock, takes / long.rate_hz
    source.open()
    loop.run(
        source, estimator, [sink], BODY, report, lambda r: told.append(telling.status(r, source))
    )
    loop.close(source, [], report)
    telling.summary(report)
    said, facts = capsys.readouterr().out, report.to_dict()
    assert facts["behind_s"] <= loop.MOST_BEHIND_S + estimator.takes_s
    assert facts["left_out"] + facts["samples"] == len(long)
    assert sink.poses[-1].time_s == pytest.approx(long.start_s + (len(long) - 1) / long.rate_hz)
    # As many as there is time for.
    assert facts["samples"] == pytest.approx(len(long) / max(1.0, takes), rel=0.1, abs=2)
    assert clock.now - 50.0 < long.seconds + loop.MOST_BEHIND_S + 2 * estimator.takes_s
    assert ("samples left out" in told[-1]) is (takes > 1)
    assert ("samples were left out" in said) is (takes > 1)
    assert ("behind the source" in said) is (takes > 1)


def test_an_estimator_that_can_hurry_is_told_how_late_it_is(recording: Recording) -> None:
    """One that takes half the time once it is late: nothing has to be left out."""

    class Hurries(Slow):
        def told_late(self, state: tuple, late_s: float) -> tuple:
            self.takes_s = (0.5 if late_s > 0.05 else 1.5) / self.rate_hz
            return state

    clock = Time()
    source = RecordingSource(recording, 1.0, clock, clock.sleep)
    estimator, report = Hurries(recording.rate_hz, recording.sensors), loop.Report()
    estimator.clock = clock
    source.open()
    loop.run(source, estimator, [], BODY, report)
    assert report.left_out == 0 and report.samples == len(recording)
    assert 0.05 < report.most_behind_s < 0.1


def test_the_body_stands_on_the_floor(recording: Recording) -> None:
    sink = Collect()
    drive(RecordingSource(recording, None), [sink])
    pose = sink.poses[0]
    _, p = BODY.forward(pose.R_parent_joint, pose.p_world_root)
    assert p[[10, 11], 1].min() == pytest.approx(0.02)


def line(packet: packets.Packet) -> bytes:
    assert packet.R_world_sensor is not None and packet.acc_world is not None
    fields = {
        "device": packet.device, "t": packet.time_s, "seq": packet.seq,
        "q": ori.to_quat(packet.R_world_sensor).tolist(), "a": packet.acc_world.tolist(),
    }  # fmt: skip
    return json.dumps(fields).encode()


class Wire:
    """Datagrams through a real socket by a clock of its own: 2 ms a poll, however busy the machine is.

    Loopback delivers before `sendto` returns, so what is due at a poll's time has arrived by then.
    """

    TICK_S = 0.002

    def __init__(self, port: int, datagrams: list[tuple[float, bytes]]):
        self.now = 50.0
        self._port = port
        self._due = [(self.now + at, d) for at, d in datagrams]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def __call__(self) -> float:
        return self.now

    def tick(self, _: loop.Report) -> None:
        self.now += self.TICK_S
        while self._due and self._due[0][0] <= self.now:
            self._socket.sendto(self._due.pop(0)[1], ("127.0.0.1", self._port))

    def drive(
        self, decode: Any, sensors: tuple[str, ...], rate_hz: float, seconds: float, sink: Collect
    ) -> loop.Report:
        """What the loop reports about these sensors, each worn where its name says."""
        receiver = Receiver(Address("127.0.0.1", self._port), decode, self)
        box, where = Assembler(sensors, rate_hz), {n: n for n in sensors}
        source = Network(receiver, box, sensors, where, seconds=seconds, clock=self)
        with self._socket:
            return drive(source, [sink], tell=self.tick)


@pytest.fixture
def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


@pytest.mark.parametrize("kind", ["udp", "osc"])
def test_over_the_network(recording: Recording, free_port: int, kind: str) -> None:
    """What arrives is what was measured, a poll later at most."""
    decode = packets.from_json if kind == "udp" else osc_messages.from_osc
    encode = line if kind == "udp" else osc_messages.imu_message
    sent = [(at, encode(p)) for at, p in packets_of(recording, start_s=1e5)]
    sensors, sink = recording.sensors, Collect()
    wire = Wire(free_port, sent)
    report = wire.drive(decode, sensors, recording.rate_hz, recording.seconds + 0.2, sink)
    facts = report.source
    assert facts["rejected"] == {} and facts["skipped_frames"] == 0
    for counts in facts["devices"].values():
        assert counts["received"] == len(recording)
        assert not any(counts[k] for k in ("lost", "clock", "late", "reordered", "duplicates"))
    # The rows after the last packet have no valid sensor.
    assert 0 <= len(sink.poses) - len(recording) <= 0.25 * recording.rate_hz
    estimator, state = Hold(recording.rate_hz, sensors), ()
    for pose, sample in zip(sink.poses, samples(recording), strict=False):
        state, expected = estimator.step(state, sample)
        assert expected is not None
        off = ori.angle_between(pose.R_parent_joint, expected.R_parent_joint).max()
        # A poll's time at 12 rad/s, and the 32 bits of OSC's floats.
        assert off < 0.03
    moved = ori.angle_between(sink.poses[0].R_parent_joint, sink.poses[60].R_parent_joint)
    assert moved.max() > 0.2
    lag = report.lag.quantile_ms(0.5)
    assert lag is not None and 0 <= lag <= 1e3 / recording.rate_hz + 4


def test_a_loop_that_stands_still_loses_no_datagram(recording: Recording, free_port: int) -> None:
    """A second in which nobody polls: the socket keeps what comes; but for the first frames and the newest,
    those of that time are left out."""
    sent = [(at, line(p)) for at, p in packets_of(recording)]

    class Stopping(Wire):
        def tick(self, report: loop.Report) -> None:
            super().tick(report)
            if 50.5 < self.now < 51.5:
                self.tick(report)

    sink = Collect()
    wire = Stopping(free_port, sent)
    report = wire.drive(packets.from_json, recording.sensors, 60.0, recording.seconds + 0.2, sink)
    for counts in report.source["devices"].values():
        assert (counts["received"], counts["lost"], counts["clock"]) == (len(recording), 0, 0)
    assert 40 < report.left_out < 60 and report.most_behind_s < 0.3
    assert not any(p.note for p in sink.poses[: len(recording) - report.left_out])


def test_a_recording_holds_what_came_however_slow_the_loop_is(
    recording: Recording, free_port: int, tmp_path: Path
) -> None:
    """A packet takes 0.5 ms to read and a frame 0.3 s: looks end before the socket is empty, and rows wait
    for what is still in it."""
    sent = [(at, line(p)) for at, p in packets_of(recording)]
    wire, kept = Wire(free_port, sent), list[Row]()

    class Keeping(Recorder):
        def take(self, rows: Any, whole: Any = None) -> None:
            kept.extend(rows)

    def slowly(datagram: bytes) -> Any:
        wire.now += 0.0005
        return packets.from_json(datagram)

    estimator = Slow(recording.rate_hz, recording.sensors)
    estimator.takes_s = 0.3
    receiver = Receiver(Address("127.0.0.1", free_port), slowly, wire)
    box = Assembler(recording.sensors, 60.0)
    recorder = Keeping(tmp_path / "s.npz", recording.sensors, 60.0)
    source = Network(
        receiver, box, recording.sensors, {n: n for n in recording.sensors},
        seconds=recording.seconds + 1.0, clock=wire, recorder=recorder,
    )  # fmt: skip
    estimator.clock = Ticking(wire)
    report = loop.Report()
    with wire._socket:
        source.open()
        loop.run(source, estimator, [], BODY, report, wire.tick)
        loop.close(source, [], report)
    assert report.left_out > 0
    assert np.mean([row.valid for row in kept[: len(recording)]]) > 0.99


class Ticking(Time):
    """Lets a wire's time pass, and what is due meanwhile be sent."""

    def __init__(self, wire: Wire):
        self.wire = wire

    def sleep(self, seconds: float) -> None:
        until = self.wire.now + seconds
        while self.wire.now < until:
            self.wire.tick(loop.Report())


def hostile(rng: np.random.Generator) -> Iterator[bytes]:
    good = {"device": "head", "t": 0.5, "q": [1, 0, 0, 0], "seq": 3}
    yield b""
    yield b"\n\n"
    yield rng.bytes(60_000)
    yield b"[" * 8000
    yield b"\x00" * 100
    yield b"/poser/imu\x00\x00,sdiffff\x00"
    yield b"#bundle\x00" * 500
    for change in (
        {"q": [0, 0, 0, 0]},
        {"t": "x"},
        {"device": "stranger"},
        {"seq": -3},
        {"t": None},
    ):
        yield json.dumps(good | change).encode()
    for n in range(60):
        yield rng.bytes(n)


@pytest.mark.parametrize("decode", [packets.from_json, osc_messages.from_osc])
def test_hostile_packets_are_counted_and_stop_nothing(
    decode: Any, free_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    bad = list(hostile(np.random.default_rng(3)))
    wire = Wire(free_port, [(0.1, b) for b in bad])
    report = wire.drive(decode, ("head",), 60.0, 0.6, Collect())
    counted = sum(report.source["rejected"].values())
    expected = len(bad)
    if decode is packets.from_json:
        lines = [[x for x in b.splitlines() if x.strip()] for b in bad]
        expected = sum(1 if len(b) > 8192 else len(x) for b, x in zip(bad, lines, strict=True))
    assert counted == expected
    # python-osc would log what it cannot read: a terminal is not for strangers to write on.
    assert caplog.records == []
    assert len(report.source["rejected"]) < 12
    assert report.source["devices"]["head"]["received"] == 0


def test_what_the_osc_library_raises_is_refused() -> None:
    rng = np.random.default_rng(0)
    good = osc_messages.imu_message(packets.Packet("head", 1.0, np.eye(3), np.zeros(3), 4))
    [back] = osc_messages.from_osc(good)
    assert isinstance(back, packets.Packet)
    assert (back.device, back.time_s, back.seq) == ("head", 1.0, 4)
    taken = 0
    for _ in range(2000):
        bad = bytearray(good)
        for at in rng.integers(0, len(good), size=3):
            bad[at] = rng.integers(256)
        for found in osc_messages.from_osc(bytes(bad[: rng.integers(1, len(bad) + 1)])):
            assert isinstance(found, packets.Packet | packets.Rejected)
            taken += isinstance(found, packets.Packet)
    assert taken < 1500


def test_status_over_osc() -> None:
    from pythonosc.osc_message_builder import OscMessageBuilder

    message = OscMessageBuilder(osc_messages.STATE)
    for value, kind in (("phone", "s"), (2.0, "d"), (1, "i"), (0, "i"), ("watch", "s"), (0.5, "f")):
        message.add_arg(value, kind)
    [packet] = osc_messages.from_osc(message.build().dgram)
    assert isinstance(packet, packets.Packet)
    assert packet.R_world_sensor is None and packet.status is not None
    assert (packet.status.screen, packet.status.proximity) == (True, False)
    assert packet.status.distances == {"watch": 0.5}


def test_z_up_senders() -> None:
    up = json.dumps({"device": "a", "t": 0, "q": [1, 0, 0, 0], "a": [0, 0, 2]}).encode()
    [packet] = y_up(packets.from_json)(up)
    assert isinstance(packet, packets.Packet)
    assert packet.acc_world is not None and packet.R_world_sensor is not None
    np.testing.assert_allclose(packet.acc_world, [0, 2, 0])
    np.testing.assert_allclose(packet.R_world_sensor @ [0, 0, 1], [0, 1, 0])


def test_a_taken_port_is_one_sentence(free_port: int) -> None:
    first = Receiver(Address("127.0.0.1", free_port), packets.from_json)
    second = Receiver(Address("127.0.0.1", free_port), packets.from_json)
    first.open()
    with pytest.raises(PoserError, match=f"cannot listen on 127.0.0.1:{free_port}"):
        second.open()
    first.close()
    second.close()


def test_the_motion_file_keeps_time(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    sink, whole = MotionFile(path, 60.0, BODY), Collect()
    drive(RecordingSource(recording, None), [whole])
    kept = [p for k, p in enumerate(whole.poses) if k not in (5, 6, 40)]
    for pose in kept:
        sink.write(pose)
    assert not path.exists()  # what came so far lies beside it
    assert sink.close() == {"frames": len(recording), "held": 3}
    motion = read(path).content
    assert isinstance(motion, Motion)
    assert motion.rate_hz == 60.0 and len(motion) == len(recording)
    for k, pose in enumerate(whole.poses):
        source = whole.poses[k - 1] if k in (5, 40) else whole.poses[4] if k == 6 else pose
        off = ori.angle_between(motion.R_parent_joint[k], source.R_parent_joint)
        assert off.max() < 1e-3


def test_a_sink_that_cannot_close_does_not_keep_the_others(recording: Recording) -> None:
    class Broken(Collect):
        def close(self) -> dict[str, Any]:
            raise OSError(28, "No space left on device")

    good = Collect()
    with pytest.raises(OSError, match="No space"):
        drive(RecordingSource(recording, None), [Broken(), good])
    assert good.closed


def test_a_short_window_and_headings_that_were_turned_back_are_told(recording: Recording) -> None:
    heading = {"head": 0.4, "left_forearm": -5.2}
    facts = {"window_frames": 12, "window_frames_most": 24, "heading_deg": heading}
    line = telling.status(loop.Report(estimator=facts), RecordingSource(recording, None))
    assert "window of 12 of 24 frames" in line
    assert "turned back: left_forearm by -5 deg" in line and "head by" not in line
    whole = {"window_frames": 24, "window_frames_most": 24}
    assert "window" not in telling.status(
        loop.Report(estimator=whole), RecordingSource(recording, None)
    )
