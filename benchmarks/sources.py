"""How long a measurement takes from a device to a sample, by kind of source: the simulated devices of the
tests, an ideal network, a look every 2 ms, no computing. What is left is what protocol and buffer cost.

python benchmarks/sources.py
"""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mocap import sensors, synthesis
from mocap.recording import Recording
from mocap.synthesis import motions
from poser.live import sources
from poser.live.addresses import Address
from poser.live.assembler import Assembler
from poser.live.receiver import Receiver
from poser.live.samples import Network
from poser.live.sources import mvn, phyphox
from poser.live.sources.conversation import Conversation
from poser.live.sources.mvn import Mvn
from poser.live.sources.protocol import Intake
from poser.live.sources.slimevr import SlimeVR
from tests.poser.live.sources.conftest import RATE, Time
from tests.poser.live.sources.sets import SETS, at
from tests.poser.live.sources.test_mvn import suit
from tests.poser.live.sources.test_slimevr import Trackers

TICK_S = 0.002
SECONDS = 6.0


def main() -> None:
    worn = synthesis.recording(motions.builtin(seconds=SECONDS + 0.1)).slice(1, 361)
    print(f"{'source':<34} {'p50 ms':>7} {'p99 ms':>7}")
    for way in ("single", "bundle", "compact"):
        show(f"slimevr, {way} packets", *slimevr(worn, way))
    show("slimevr, bundles, 2 % lost", *slimevr(worn, "bundle", 0.02))
    show("mvn", *mvn_suit(worn))
    for kind in ("text", "dot"):
        show(kind, *by_frames(worn, kind))
    for batch_s in (0.1, 0.2):
        show(f"sensorlogger, batches of {batch_s:g} s", *by_batches(worn, "sensorlogger", batch_s))
    show("phyphox, asked every 0.05 s", *by_batches(worn, "phyphox", phyphox.EVERY_S))


def show(name: str, p50: float, p99: float) -> None:
    print(f"{name:<34} {p50:7.1f} {p99:7.1f}")


def lags(
    intake: Intake,
    time: Time,
    recording: Recording,
    send: Callable[[int], None],
    where: dict[str, str],
    buffer_s: float,
) -> tuple[float, float]:
    """p50 and p99 in ms of the time from a sample's moment to when it is there."""
    box = Assembler(tuple(where), RATE, buffer_s)
    source = Network(intake, box, recording.sensors, where, clock=time)
    found, sent, began = [], 0, time.now
    with closing(source):
        source.open()
        while sent < len(recording):
            time.now += TICK_S
            while sent < len(recording) and time.now >= began + sent / RATE:
                send(sent)
                sent += 1
            for sample in source.poll():
                lag = source.lag_s(sample.time_s)
                if lag is not None and sample.valid.any():
                    found.append(lag * 1e3)
    p50, p99 = np.percentile(found, (50, 99))
    return float(p50), float(p99)


def slimevr(worn: Recording, way: str, lose: float = 0.0) -> tuple[float, float]:
    time = Time()
    intake = Conversation(Address("127.0.0.1", free_port()), SlimeVR(), time)
    trackers = Trackers(worn, intake._to[1], way, lose)
    with closing(trackers):
        return lags(intake, time, worn, trackers.send, trackers.where(), 0.05)


def mvn_suit(worn: Recording) -> tuple[float, float]:
    assert worn.reference is not None and mvn.SOURCE.worn is not None
    time, motion, port = Time(), worn.reference, free_port()
    intake = Receiver(Address("127.0.0.1", port), Mvn(), time)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        return lags(
            intake, time, worn, lambda k: sender.sendto(suit(motion, k), ("127.0.0.1", port)),  # type: ignore[arg-type,return-value]
            mvn.SOURCE.worn(sensors.SIX), mvn.SOURCE.buffer_s,
        )  # fmt: skip


def by_frames(worn: Recording, kind: str) -> tuple[float, float]:
    """Of the sets of the tests whose devices send each frame as it is measured."""
    time = Time()
    made = SETS[kind](worn, time)

    def send(k: int) -> None:
        for s in range(len(worn.sensors)):
            made.bring(s, made.frame(s, k, at(k)))

    with closing(made), closing(made.intake):
        buffer_s = sources.kind(kind).buffer_s
        return lags(made.intake, time, worn, send, made.where(), buffer_s)


def by_batches(worn: Recording, kind: str, batch_s: float) -> tuple[float, float]:
    """Of the sets of the tests whose devices send what they measured in batch_s at once, each at its turn."""
    time = Time()
    made = SETS[kind](worn, time)
    waiting: list[list[tuple[int, float]]] = [[] for _ in worn.sensors]
    every = round(batch_s * RATE)

    def send(k: int) -> None:
        for s, rows in enumerate(waiting):
            rows.append((k, at(k)))
            if (k + 3 * s) % every == every - 1:
                made.bring(s, made.batch(s, rows))
                rows.clear()

    with closing(made), closing(made.intake):
        buffer_s = sources.kind(kind).buffer_s
        return lags(made.intake, time, worn, send, made.where(), buffer_s)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


if __name__ == "__main__":
    main()
