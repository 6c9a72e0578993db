"""The built-in motion as simulated devices wear it, a clock of the test's own, and the way of samples to
poses: what a device's stream must come to is what the same measurements come to as a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.estimator import Sample, samples
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.synthesis import motions
from poser.live.assembler import Assembler
from poser.live.packets import Packet
from poser.live.recorder import Recorder
from poser.live.samples import Network
from poser.live.sources.protocol import Intake
from tests.poser.live.conftest import Hold

SIX = sensors.SIX
RATE = 60.0
SECONDS = 6.0


@pytest.fixture(scope="session")
def worn() -> Recording:
    """Six seconds of the built-in motion (standing, then walking), six clean sensors."""
    return synthesis.recording(motions.builtin(seconds=SECONDS + 0.1)).slice(
        1, 1 + round(SECONDS * RATE)
    )


@dataclass
class Time:
    """A clock that the test moves."""

    now: float = 100.0

    def __call__(self) -> float:
        return self.now


Send = Callable[[int], None]
"""Sends what a device has to say at frame k."""


def heard(
    intake: Intake,
    time: Time,
    recording: Recording,
    send: Send,
    where: dict[str, str] | None = None,
    delay_s: float = 0.05,
    frames: int | None = None,
    settle: Callable[[], None] = lambda: None,
    recorder: Recorder | None = None,
) -> tuple[Network, list[Sample]]:
    """The samples that come of frames sent at their times, and the source. settle: waits until what was
    sent is there."""
    names = where or {n: n for n in recording.sensors}
    box = Assembler(tuple(names), RATE, delay_s)
    source = Network(intake, box, recording.sensors, names, clock=time, recorder=recorder)
    source.open()
    got: list[Sample] = []
    count = len(recording) if frames is None else frames
    began = time.now
    for k in range(count + round((delay_s + 0.02) * RATE)):
        time.now = began + k / RATE
        if k < count:
            send(k)
        settle()
        got += source.poll()
    return source, got


def poses_of(found: Iterator[Sample] | list[Sample], recording: Recording) -> Array:
    """R_parent_joint (N,24,3,3) of samples."""
    estimator, state = Hold(RATE, recording.sensors), ()
    out = []
    for sample in found:
        state, pose = estimator.step(state, sample)
        assert pose is not None
        out.append(pose.R_parent_joint)
    return np.array(out)


def same_poses(
    got: list[Sample], recording: Recording, skip: int = 0, within_deg: float = 1e-3
) -> None:
    """The poses of a stream are those of the recording, from its frame `skip` on."""
    expected = poses_of(samples(recording), recording)
    found = poses_of(got, recording)
    shift = [round(s.time_s * RATE) + skip for s in got]
    pairs = [(i, k) for i, k in enumerate(shift) if k < len(expected) and got[i].valid.all()]
    assert len(pairs) > 0.9 * (len(expected) - skip)
    a, b = np.array([i for i, _ in pairs]), np.array([k for _, k in pairs])
    off = np.rad2deg(ori.angle_between(found[a], expected[b])).max()
    assert off < within_deg, f"{off:.4f} deg"


def accelerations(got: list[Sample], recording: Recording, skip: int = 0) -> tuple[Array, Array]:
    """(N,S,3) of a stream and of the recording at the same frames."""
    k = np.array([round(s.time_s * RATE) + skip for s in got])
    keep = k < len(recording)
    return np.array([s.acc_world for s in got])[keep], recording.acc_world[k[keep]]


def zup(R_world_sensor: Array) -> Array:
    """R of a sensor in the z-up world that devices use."""
    return ori.R_ZUP_YUP @ R_world_sensor


def wxyz(R: Array) -> list[float]:
    return [float(x) for x in ori.to_quat(R)]


def only(packets: list[object]) -> Packet:
    """The one packet among what was decoded."""
    [packet] = packets
    assert isinstance(packet, Packet), packet
    return packet
