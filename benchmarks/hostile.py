"""Live under hostile packets: 100,000 random, wrong and forged ones beside a true sender, on the loopback.

Run: .venv/bin/python benchmarks/hostile.py [-o FILE]. A quiet run first, then one as long with the flood; the
estimator is a stand-in of 1 ms, since what is measured is the way from the socket to the pose. Fails where
fewer than 59 poses a second come, a sensor falls silent, memory grows by more than 32 MB, or the 99th
percentile of the latency is more than 1.5 times the quiet run's.
"""

from __future__ import annotations

import argparse
import json
import random
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import resident_mb

from mocap import sensors as places
from mocap.estimator import Pose, Sample
from mocap.skeleton import Skeleton
from poser.live import loop, packets
from poser.live.addresses import Address
from poser.live.assembler import Assembler
from poser.live.receiver import Receiver
from poser.live.samples import Network

RATE_HZ, DATAGRAMS, LARGEST_MB = 60.0, 100_000, 32.0
ATTACKED = 0.95  # of the time: the attacker's process has to start first
TAKEN = 0.9  # of the datagrams: the rest found the socket full


class StandIn:
    """Gives the rest pose after a millisecond of work."""

    look_ahead_frames = 0

    def init(self) -> None:
        return None

    def step(self, state: None, sample: Sample) -> tuple[None, Pose]:
        until = time.perf_counter() + 1e-3
        while time.perf_counter() < until:
            pass
        R = np.tile(np.eye(3), (24, 1, 1))
        return None, Pose(sample.time_s, R, np.zeros(3))


def line(name: str, t: float, k: int, **more: Any) -> bytes:
    fields = {"device": name, "t": t, "q": [1, 0, 0, 0], "a": [0, 0, 0], "seq": k % 65536}
    return json.dumps(fields | more).encode()


def true_sender(port: int, stop: threading.Event) -> None:
    began = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for k in range(1 << 30):
            wait = began + k / RATE_HZ - time.monotonic()
            if stop.wait(max(0.0, wait)):
                return
            t = time.monotonic() - began
            s.sendto(b"\n".join(line(n, t, k) for n in places.SIX), ("127.0.0.1", port))


def attacker(port: int, seconds: float) -> None:
    """In a process of its own: an equal share of each kind, evenly over the time. Prints how many it sent."""
    rng = random.Random(1)
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(20)]
    began, sent = time.monotonic(), 0
    for k in range(DATAGRAMS):
        if k % 50 == 0:
            time.sleep(max(0.0, began + seconds * k / DATAGRAMS - time.monotonic()))
        name, t = rng.choice(places.SIX), time.monotonic() - began
        data = (
            rng.randbytes(rng.randrange(600)),
            line(name, rng.uniform(-1e12, 1e12), rng.randrange(65536)),
            line(name, t, rng.randrange(65536), q=[0, 1, 0, 0], a=[9, 9, 9]),
            line(name, t, rng.randrange(65536), q=[2, 1, 0, rng.random()]),
            line(rng.randbytes(8).hex(), t, k),
        )[k % 5]
        try:
            rng.choice(sockets).sendto(data, ("127.0.0.1", port))
            sent += 1
        except OSError:
            continue
    print(sent)


def run(seconds: float, hostile: bool) -> dict[str, Any]:
    receiver = Receiver(Address("127.0.0.1", 0), packets.from_json)
    where = {n: n for n in places.SIX}
    source = Network(receiver, Assembler(places.SIX, RATE_HZ), places.SIX, where, seconds=seconds)
    source.open()
    stop, report = threading.Event(), loop.Report()
    sender = threading.Thread(target=true_sender, args=(receiver.port, stop), daemon=True)
    sender.start()
    child = None
    if hostile:
        time.sleep(0.2)  # the true sender came first
        words = ["--attack", str(receiver.port), "--seconds", str(ATTACKED * seconds)]
        child = subprocess.Popen([sys.executable, __file__, *words], stdout=subprocess.PIPE)
    before, began = resident_mb(), time.monotonic()
    loop.run(source, StandIn(), [], Skeleton.default(), report)  # type: ignore[arg-type]
    passed = time.monotonic() - began
    after = resident_mb()
    stop.set()
    sender.join()
    loop.close(source, [], report)
    sent = int(child.communicate()[0] or 0) if child else 0
    counts = report.source["devices"]
    return {
        "poses_per_s": report.frames / passed,
        "p50_ms": report.lag.quantile_ms(0.5), "p99_ms": report.lag.quantile_ms(0.99),
        "silent_rows": sum(c["silent_rows"] for c in counts.values()),
        "lost": sum(c["lost"] for c in counts.values()),
        "attacked_with": sent,
        "others": sum(c["others"] for c in counts.values()),
        "rejected": sum(report.source["rejected"].values()), "grown_mb": after - before,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--attack", type=int, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE")
    args = parser.parse_args()
    if args.attack:
        attacker(args.attack, args.seconds)
        return
    quiet, found = run(args.seconds, False), run(args.seconds, True)
    record = {"seconds": args.seconds, "datagrams": DATAGRAMS, "quiet": quiet, "hostile": found}
    print(json.dumps(record, indent=1))
    if args.output:
        args.output.write_text(json.dumps(record, indent=1) + "\n")
    refused = found["others"] + found["rejected"]
    if found["attacked_with"] < DATAGRAMS or refused < TAKEN * DATAGRAMS:
        sys.exit(
            f"no attack: {found['attacked_with']} datagrams were sent, {refused} messages refused"
        )
    held = (
        found["poses_per_s"] >= 59.0 and found["silent_rows"] <= quiet["silent_rows"]
        and found["grown_mb"] < LARGEST_MB and found["p99_ms"] <= 1.5 * quiet["p99_ms"]
    )  # fmt: skip
    sys.exit(0 if held else 1)


if __name__ == "__main__":
    main()
