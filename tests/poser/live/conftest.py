"""An estimator that learns nothing, and packets that virtual sensors would send."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mocap import sensors as places
from mocap import synthesis
from mocap.estimator import Pose, Sample
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.live.packets import Packet


@dataclass
class Hold:
    """Instrumented joints take the measured rotation (the last one, while there is none), all others
    follow their parents. The pose of `look_ahead_frames` samples ago."""

    rate_hz: float
    sensors: tuple[str, ...]
    look_ahead_frames: int = 0

    def init(self) -> tuple[tuple[float, np.ndarray], ...]:
        return ()

    def step(self, state: tuple, sample: Sample) -> tuple[tuple, Pose | None]:
        joints, _ = places.joints_and_seats(self.sensors)
        last = state[-1][1] if state else np.tile(np.eye(3), (len(self.sensors), 1, 1))
        R = np.where(sample.valid[:, None, None], sample.R_world_bone, last)
        state = (*state[-self.look_ahead_frames :], (sample.time_s, R))
        if len(state) <= self.look_ahead_frames:
            return state, None
        time_s, R = state[-1 - self.look_ahead_frames]
        body = Skeleton.default()
        R_world = np.tile(np.eye(3), (24, 1, 1))
        for j, parent in enumerate(body.parents):
            if parent >= 0:
                R_world[j] = R_world[parent]
            if j in joints:
                R_world[j] = R[list(joints).index(j)]
        note = "" if sample.valid.all() else "a sensor is silent"
        return state, Pose(time_s, body.local_rotations(R_world), np.zeros(3), note=note)


@pytest.fixture(scope="session")
def recording() -> Recording:
    """Two seconds of walking, six clean sensors."""
    return synthesis.recording(motions.walk(3.0)).slice(1, 121)


def packets_of(recording: Recording, start_s: float = 0.0) -> list[tuple[float, Packet]]:
    """Every sample as a packet, with the time it is sent at; the device's clock starts at `start_s`."""
    out = []
    for t in range(len(recording)):
        for s, name in enumerate(recording.sensors):
            at = t / recording.rate_hz
            R, acc = recording.R_world_bone[t, s], recording.acc_world[t, s]
            out.append((at, Packet(name, at + start_s, R, acc, t)))
    return out


@pytest.fixture
def estimators(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, float, tuple[str, ...]]]:
    """`poser.estimators.make` gives `Hold`; the list fills with what it was asked for."""
    asked: list[tuple[str, float, tuple[str, ...]]] = []

    def make(method: str, rate_hz: float, sensors: tuple[str, ...], **_: object) -> Hold:
        asked.append((method, rate_hz, sensors))
        # Reads all but the last, in another order, as an estimator may.
        return Hold(rate_hz, tuple(reversed(sensors[:-1])) if len(sensors) > 1 else sensors)

    monkeypatch.setattr("poser.estimators.make", make)
    return asked
