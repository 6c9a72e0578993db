"""Senders with a fault each: JSON lines over the wire, a wearer who stands, then turns about and walks."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.errors import CalibrationError
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import motions
from poser.live import packets, sender_words
from poser.live.aligner import Aligner
from poser.live.alignment import PoseWatch
from poser.live.assembler import Assembler
from poser.live.heard import Heard
from poser.live.packets import Packet, Rejected
from poser.live.receiver import y_up
from poser.live.samples import Network

RATE = 60.0
G = ori.GRAVITY
Y, Z = np.array([0, G, 0]), np.array([0, 0, G])


class Wire:
    """Datagrams at their times, decoded as the receiver does."""

    ended = False
    read_s = np.inf  # nothing waits

    def __init__(self, sent: list[tuple[float, bytes]], up: str):
        self._sent, self.now = sent, 0.0
        self._decode = y_up(packets.from_json) if up == "z" else packets.from_json
        self.rejected: Counter[str] = Counter()

    def open(self) -> None: ...

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        self.now += 0.004
        while self._sent and self._sent[0][0] <= self.now:
            at, data = self._sent.pop(0)
            for found in self._decode(data):
                if isinstance(found, Rejected):
                    self.rejected[found.reason] += 1
                else:
                    yield found, at, None

    def heard(self) -> dict[str, Heard]:
        return {}

    def close(self) -> None: ...


def _time(motion: Motion) -> np.ndarray:
    return np.arange(len(motion)) / motion.rate_hz


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    """Six sensors strapped on anyhow: standing for 4.5 s, a turn about in 3 s, standing turned for 3 s."""
    stands = motions.stand(11.0)
    yaw = np.pi * np.clip((_time(stands) - 4.5) / 3.0, 0, 1)
    R = np.array(stands.R_parent_joint)
    R[:, 0] = ori.rot_y(yaw) @ R[:, 0]
    turning = Motion(stands.rate_hz, R, stands.p_world_root, stands.skeleton)
    noise = synthesis.Noise(loss=0.0)
    return synthesis.raw_recording(turning, sensors.SIX, noise, rng=5)


Sender = Callable[[np.ndarray, np.ndarray, float], dict[str, Any]]
"""The fields of a message: of R_world_sensor, specific force f of the sensor, and time."""


def wxyz(R: np.ndarray) -> list[float]:
    return [float(x) for x in ori.to_quat(R)]


def xyzw(R: np.ndarray) -> list[float]:
    return [float(x) for x in ori.to_quat(R, scalar_first=False)]


def sends(
    a: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda R, f: R @ f - Y,
    q: Callable[[np.ndarray], list[float]] = wxyz,
    t: Callable[[float], float] = lambda t: t,
) -> Sender:
    return lambda R, f, at: {"q": q(R), "a": [float(x) for x in a(R, f)], "t": t(at)}


def run(
    raw: RawRecording, sender: Sender, seconds: float, *, up: str = "y", waits: bool = True
) -> tuple[Network, str]:
    """The source after so long, and the sentence with which it ended."""
    assert raw.R_world_sensor is not None
    sent = []
    for k in range(len(raw)):
        for s, name in enumerate(raw.sensors):
            fields = sender(raw.R_world_sensor[k, s], raw.acc[k, s], 50 + k / RATE)
            sent.append(
                (k / RATE, json.dumps({"device": name, "seq": k % 65536} | fields).encode())
            )
    wire = Wire(sent, up)
    watch = PoseWatch(raw.sensors, RATE, "n", begin_s=2.0, give_up_s=4.0) if waits else None
    box, where = Assembler(raw.sensors, RATE), {n: n for n in raw.sensors}
    source = Network(
        wire, box, raw.sensors, where, Aligner(watch=watch), clock=lambda: wire.now, up=up
    )  # fmt: skip
    source.open()
    try:
        while wire.now < seconds:
            source.poll()
    except CalibrationError as e:
        return source, str(e)
    return source, ""


def own_r(R: np.ndarray) -> np.ndarray:
    """The rotation as a receiver takes a quaternion that is sent x, y, z, w."""
    return ori.from_quat(xyzw(R))


ZUP = ori.R_YUP_ZUP.T  # of a sender whose world is z-up
AT_REST: dict[str, tuple[Sender, str]] = {
    "gravity left in": (sends(lambda R, f: R @ f), "m/s^2, not 0: gravity is left in"),
    "g, gravity left in": (sends(lambda R, f: R @ f / G), "in g, and gravity is left in"),
    "gravity twice": (sends(lambda R, f: R @ f - 2 * Y), "taken off twice, or the sign"),
    "sensor axes": (sends(lambda R, f: f), "in the sensor's own axes, with gravity"),
    "sensor axes in g": (sends(lambda R, f: f / G), "in g, in the sensor's own axes"),
    "z-up, gravity left in": (
        sends(lambda R, f: ZUP @ R @ f, lambda R: wxyz(ZUP @ R)),
        "gravity is left in, and y and z are exchanged: the senders' world is z-up (--up z)",
    ),
    "z-up, gravity taken off y": (
        sends(lambda R, f: ZUP @ R @ f - Y, lambda R: wxyz(ZUP @ R)),
        "y and z are exchanged: the senders' world is z-up (--up z)",
    ),
    "x y z w, also used for a": (
        sends(lambda R, f: own_r(R) @ f - Y, xyzw),
        "quaternions seem to be x, y, z, w; w, x, y, z is expected",
    ),
    "inverse, also used for a": (
        sends(lambda R, f: R.T @ f - Y, lambda R: wxyz(R.T)),
        "quaternions seem to be inverse",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", AT_REST)
def test_an_acceleration_at_rest_names_its_cause(raw: RawRecording, fault: str) -> None:
    """In the countdown, before the pose; where no pose is waited for it is told, and the session goes on."""
    sender, sentence = AT_REST[fault]
    source, error = run(raw, sender, 4.2)
    assert sentence in error and "acceleration at rest is " in error
    # Where the sensors' axes matter, some are by chance nearly right.
    assert error.startswith("all sensors") or "used for a" in fault
    assert source.calibration is None
    source, error = run(raw, sender, 4.2, waits=False)
    assert error == ""
    assert any(sentence in sender_words.sentence(f) for f in source.doubts)


TURNED: dict[str, tuple[Sender, str, str]] = {
    "x y z w": (sends(q=xyzw), "y", "quaternions seem to be x, y, z, w; w, x, y, z is expected"),
    "inverse": (sends(q=lambda R: wxyz(R.T)), "y", "quaternions seem to be inverse"),
    "z-up": (
        sends(lambda R, f: ZUP @ R @ f - Z, lambda R: wxyz(ZUP @ R)), "y", "is z-up (--up z)",
    ),
    "z-up told, x y z w": (
        sends(lambda R, f: ZUP @ R @ f - Z, lambda R: xyzw(ZUP @ R)), "z", "be x, y, z, w",
    ),
    "y-up where z-up was told": (sends(), "z", "is y-up (leave --up z out)"),
}  # fmt: skip


@pytest.mark.parametrize("fault", TURNED)
def test_an_orientation_names_its_cause_once_the_wearer_turns_about(
    raw: RawRecording, fault: str
) -> None:
    """Their accelerations are zero at rest, so standing alone shows nothing."""
    sender, up, sentence = TURNED[fault]
    source, error = run(raw, sender, 4.2, up=up)
    assert error == "" and source.doubts == [] and source.calibration is not None
    source, _ = run(raw, sender, 10.5, up=up)
    [finding] = source.doubts
    assert sentence in sender_words.sentence(finding)


@pytest.mark.parametrize(
    ("factor", "sentence"),
    [
        (1e3, "its time t is in ms, seconds are expected: divide by 1000"),
        (1e6, "its time t is in us"),
        (0.0, "runs 0 times as fast"),
        (1 / 60, "runs 0.017 times as fast"),
    ],
)
def test_a_clock_in_another_unit_is_told(raw: RawRecording, factor: float, sentence: str) -> None:
    source, error = run(raw, sends(t=lambda t: factor * t), 10.5)
    [finding] = source.doubts  # one sentence, however many sensors
    said = sender_words.sentence(finding)
    assert finding.details["sensors"] == list(raw.sensors)
    assert said.startswith("all sensors: ") and sentence in said
    if factor > 1:  # nothing of these packets is used, and the end says why
        assert sentence in error and "no N-pose within 4 s" in error


def test_a_time_since_1970_in_ms_is_told(raw: RawRecording) -> None:
    source, _ = run(raw, sends(t=lambda t: 1.7e12 + 1e3 * t), 3.0)
    [finding] = source.doubts
    assert "ms, us or ns since 1970" in sender_words.sentence(finding)
    assert source.facts()["rejected"]["time out of range"] > 100


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_sound_sender_is_not_doubted(raw: RawRecording, up: str) -> None:
    """Biased by 0.5 m/s^2 upwards, with time in s since 1970."""
    own, down = (np.eye(3), Y) if up == "y" else (ZUP, Z)
    sender = sends(
        lambda R, f: own @ R @ f - down + 0.05 * down, lambda R: wxyz(own @ R), lambda t: 1.7e9 + t
    )
    source, error = run(raw, sender, 10.5, up=up)
    assert error == "" and source.doubts == [] and source.calibration is not None


def test_one_sensor_alone_is_named(raw: RawRecording) -> None:
    sound, wrong = sends(), sends(lambda R, f: R @ f)
    assert raw.R_world_sensor is not None
    head = raw.R_world_sensor[:, raw.sensors.index("head")]

    def sender(R: np.ndarray, f: np.ndarray, t: float) -> dict[str, Any]:
        return (wrong if (head == R).all((-1, -2)).any() else sound)(R, f, t)

    _, error = run(raw, sender, 4.2)
    assert error.startswith("sensor head: acceleration at rest is ") and "left in" in error


def test_bending_and_lying_down_are_no_turned_quaternions() -> None:
    """Sensors all mounted alike, so that one axis of theirs is where another reading would have up."""
    still = motions.stand(9.0)
    R = np.array(still.R_parent_joint)
    R[:, 0] = ori.rot_x(np.radians(95) * np.clip((_time(still) - 4.5) / 2, 0, 1)) @ R[:, 0]
    bending = Motion(still.rate_hz, R, still.p_world_root, still.skeleton)
    noise = synthesis.Noise(loss=0.0, mounting_deg=0.0)
    lying = synthesis.raw_recording(bending, sensors.SIX, noise, rng=1)
    source, error = run(lying, sends(), 8.9)
    assert error == "" and source.doubts == []
