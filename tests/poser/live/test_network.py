"""The source of the network with its parts together, on a clock of the test's own: the pose at the start,
devices that change places, mapped names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.estimator import Sample
from mocap.synthesis import motions
from poser.live import alignment, telling
from poser.live.aligner import Aligner
from poser.live.alignment import PoseWatch
from poser.live.assembler import Assembler
from poser.live.devices import DeviceTracker, Preferences
from poser.live.heard import Heard
from poser.live.loop import Report
from poser.live.packets import Packet, Status
from poser.live.samples import Network

RATE = 60.0


class Script:
    """Packets at their times in place of a socket."""

    ended = False
    read_s = np.inf

    def __init__(self, packets: list[tuple[float, Packet]]):
        self._packets = sorted(packets, key=lambda p: p[0])
        self.now = 0.0
        self.rejected: Counter[str] = Counter()
        self.closed = False

    def open(self) -> None: ...

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        self.now += wait_s
        while self._packets and self._packets[0][0] <= self.now:
            at, packet = self._packets.pop(0)
            yield packet, at, None

    def heard(self) -> dict[str, Heard]:
        return {}

    def close(self) -> None:
        self.closed = True


def samples_of(script: Script, source: Network, seconds: float) -> list[Sample]:
    source.open()
    out: list[Sample] = []
    while script.now < seconds:
        out += source.poll()
    return out


def test_the_pose_then_the_motion() -> None:
    """Sensors strapped on anyhow: after standing still, samples are of bones, to a few degrees."""
    motion = motions.joined([motions.stand(3.0), motions.walk(3.0)])
    quiet = synthesis.Noise(loss=0.0, tissue_deg=0.5, heading_deg=0.0, heading_walk_deg=0.0)
    raw = synthesis.raw_recording(motion, sensors.SIX, quiet, rng=2)
    assert raw.R_world_sensor is not None
    packets = []
    for t in range(len(raw)):
        for s in range(6):
            R = raw.R_world_sensor[t, s]
            acc = R @ raw.acc[t, s] - alignment.UP_G
            packets.append((t / RATE, Packet(f"imu-{s}", 7.0 + t / RATE, R, acc, t)))
    script = Script(packets)
    devices = tuple(f"imu-{s}" for s in range(6))
    where = dict(zip(devices, raw.sensors, strict=True))
    watch = PoseWatch(raw.sensors, RATE, "n", begin_s=0.5)
    box = Assembler(devices, RATE)
    source = Network(
        script, box, raw.sensors, where, aligner=Aligner(watch=watch), clock=lambda: script.now
    )
    got = samples_of(script, source, 5.9)
    assert source.calibration is not None and not source.waiting
    assert 1.9 < got[0].time_s < 2.3
    joints, _ = sensors.joints_and_seats(raw.sensors)
    off = [
        ori.angle_between(s.R_world_bone, motion.R_world_joint[round(s.time_s * RATE), joints])
        for s in got
    ]
    assert np.rad2deg(np.mean(off)) < 2.0
    assert all(s.valid.all() for s in got)


def test_a_phone_that_changes_places_moves_to_another_sensor() -> None:
    """From the pocket into the hand: the samples' validity follows, the source goes on as it is."""
    pocket, hand = Status(False, True), Status(True, False)
    packets = []
    for k in range(360):
        t = k / RATE
        R = ori.rot_x(0.3 * np.sin(2 * t))
        packets.append((t, Packet("phone", t, R, np.zeros(3), k)))
        if k % 20 == 0:
            packets.append((t, Packet("phone", t, None, None, None, pocket if t < 3 else hand)))
            packets.append((t, Packet("stranger", t, R, np.zeros(3), k)))
    script = Script(packets)
    devices = ("watch", "phone", "earbuds")
    source = Network(
        script, Assembler(devices, RATE), sensors.FIVE, {}, clock=lambda: script.now,
        tracker=DeviceTracker(Preferences("right", "left", "left"), RATE),
    )  # fmt: skip
    got = samples_of(script, source, 5.9)
    valid = np.array([s.valid for s in got])
    t = np.array([s.time_s for s in got])
    by_name = dict(zip(sensors.FIVE, valid.T, strict=True))
    assert by_name["right_pocket"][(t > 1.5) & (t < 3)].all()
    assert by_name["left_wrist"][t > 4].all() and not by_name["right_pocket"][t > 4].any()
    assert not by_name["head"].any() and not by_name["right_wrist"].any()
    facts = source.facts()
    assert facts["places"] == {"phone": "left_wrist"}
    assert facts["place_changes"] == 2
    assert facts["rejected"] == {"device unknown": 18}
    assert facts["silent"] == ["watch", "earbuds"]
    line = telling.status(Report(), source)
    assert "phone: left_wrist" in line and "18 messages refused" in line
    source.close()
    assert script.closed


@pytest.mark.parametrize("rate", [25.0, 60.0, 100.0])
def test_the_time_of_samples_is_the_time_they_were_measured(rate: float) -> None:
    """lag_s counts from when the packet of that time arrived."""
    packets = [
        (2.0 + k / rate, Packet("head", k / rate, np.eye(3), np.zeros(3), k)) for k in range(100)
    ]
    script = Script(packets)
    box = Assembler(("head",), rate)
    source = Network(script, box, ("head",), {"head": "head"}, clock=lambda: script.now)
    source.open()
    lags = []
    while script.now < 2.0 + 100 / rate:
        for sample in source.poll():
            lag = source.lag_s(sample.time_s)
            assert lag is not None
            lags.append(lag)
    assert len(lags) in (99, 100)
    # Asked every 2 ms; a row with its packet there leaves at once.
    assert np.max(lags[:99]) < 0.0025


def test_a_loop_that_stands_still_is_behind_by_so_much() -> None:
    """Beyond the time that a row waits for packets anyway, which is nobody's fault."""
    packets = [
        (2.0 + k / RATE, Packet("head", k / RATE, np.eye(3), np.zeros(3), k)) for k in range(120)
    ]
    script = Script(packets)
    box = Assembler(("head",), RATE, delay_s=0.1)
    source = Network(script, box, ("head",), {"head": "head"}, clock=lambda: script.now)
    assert source.behind_s(0.0) == 0.0  # nothing heard yet
    source.open()
    samples = []
    while script.now < 3.0:
        samples += source.poll()
        assert all(source.behind_s(s.time_s) == 0.0 for s in samples[-1:])
    script.now += 0.7
    late = source.poll()
    assert source.behind_s(late[0].time_s) == pytest.approx(0.6, abs=0.02)
    assert source.behind_s(late[-1].time_s) == pytest.approx(0.0, abs=0.02)


def listening(packets: list[tuple[float, Packet]], tracker: DeviceTracker | None = None) -> Network:
    """A network source that waits for the N-pose of six sensors, or for tracked devices."""
    script = Script(packets)
    devices = sensors.SIX if tracker is None else ("watch", "phone", "earbuds")
    watch = PoseWatch(sensors.SIX, RATE, "n") if tracker is None else None
    return Network(
        script, Assembler(devices, RATE), sensors.SIX, {n: n for n in devices}, aligner=Aligner(watch=watch),
        tracker=tracker, clock=lambda: script.now,
    )  # fmt: skip


def sent(names: list[str], seconds: float = 8.0) -> list[tuple[float, Packet]]:
    return [
        (k / RATE, Packet(name, k / RATE, np.eye(3), np.zeros(3), k))
        for k in range(round(seconds * RATE))
        for name in names
    ]


def told(source: Network, seconds: float, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The lines on stderr, which is no terminal."""
    teller, report = telling.Teller(source, [], source._clock), Report()
    source.open()
    while source._clock() < seconds:
        source.poll()
        teller.tell(report)
    return capsys.readouterr().err.splitlines()


def test_what_the_pose_waits_for_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """One of six speaks, and a stranger: in the line, and once each where there is no terminal."""
    source = listening(sent(["head", "imu-7"]))
    assert told(source, telling.PATIENCE_S - 0.1, capsys) == []
    rest = ", ".join(n for n in sensors.SIX if n != "head")
    assert telling.status(Report(), source) == (
        f"waiting for the pose; nothing yet from {rest}; unknown devices (imu-7)"
    )
    assert told(source, telling.PATIENCE_S + 7.0, capsys) == [
        f"live: nothing came yet from {rest}",
        "live: refused: unknown devices (imu-7); --map NAME=PLACE says where a device is worn, "
        "--sensors which places are used",
    ]


def test_who_sends_all_is_led_through_the_pose(capsys: pytest.CaptureFixture[str]) -> None:
    source = listening(sent(list(sensors.SIX), seconds=6.0))
    assert told(source, 6.0, capsys) == ["live: stand still in the N-pose"]
    line = "waiting for the pose: stand still in the N-pose"
    assert telling.status(Report(), source) == line


def test_tracked_devices_come_and_go(capsys: pytest.CaptureFixture[str]) -> None:
    """A watch alone is no fault; a device under another name is told the three that there are."""
    tracker = DeviceTracker(Preferences("right", "left", "left"), RATE)
    source = listening(sent(["watch", "pixel"]), tracker)
    assert told(source, 8.0, capsys) == [
        "live: refused: unknown devices (pixel); with --devices they are named watch, phone, earbuds"
    ]
    tracker = DeviceTracker(Preferences("right", "left", "left"), RATE)
    assert told(listening([], tracker), 8.0, capsys) == [
        "live: nothing came yet from watch, phone, earbuds"
    ]


def test_names_of_strangers_are_bounded(capsys: pytest.CaptureFixture[str]) -> None:
    """A thousand names, three are kept; the answer at the end has them, too."""
    source = listening(sent([f"x{k}" for k in range(1000)], seconds=0.1))
    samples_of(source._intake, source, 0.5)
    facts = source.facts()
    assert facts["unknown_devices"] == ["x0", "x1", "x2"]
    assert facts["rejected"] == {"device unknown": 6000}
    telling.summary(Report(source=facts))
    said = capsys.readouterr().out
    assert "refused: device unknown: 6000 (the first of them: x0, x1, x2)\n" in said
    # As wide as they look: a line of these would wrap otherwise.
    source = listening(sent(["\u4e16" * 2], seconds=0.1))
    samples_of(source._intake, source, 0.5)
    assert source.facts()["unknown_devices"] == ["\\u4e16\\u4e16"]


def test_the_line_fits_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that wraps could not be written over, and would fill the screen line by line."""
    size = telling.os.terminal_size((40, 24))
    monkeypatch.setattr(telling.os, "get_terminal_size", lambda _: size)
    monkeypatch.setattr(telling.sys.stderr, "fileno", lambda: 2, raising=False)
    assert telling._fitted("x" * 39) == "x" * 39
    assert telling._fitted("x" * 40) == "x" * 36 + "..."
