"""A set of SlimeVR trackers that is not there: six boards that replay the built-in motion over UDP.

Once poser has met them all, they stand for twelve seconds, walk, then do the built-in motion, over and over.
Each board has its own mounting and heading. Start this; then in another terminal, with the map it prints:
poser quickstart --source slimevr --map MAP
Run: python examples/slimevr_set.py [--port 6969] [--seconds 600]
"""

import argparse
import socket
import struct
import time

import numpy as np

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.synthesis import motions

RATE = 100.0
parser = argparse.ArgumentParser()
parser.add_argument("--port", type=int, default=6969)
parser.add_argument("--seconds", type=float, default=600.0)
args = parser.parse_args()

parts = [motions.stand(12.0), motions.walk(15.0), motions.builtin()]
motion = synthesis.prepare(motions.joined(parts), RATE, 8.0)
raw = synthesis.raw_recording(motion, sensors.SIX, synthesis.NOISES["realistic"], rng=0)
own = ori.rot_y(np.random.default_rng(1).uniform(-np.pi, np.pi, len(raw.sensors)))
R = own @ raw.R_world_sensor
# Trackers send acceleration in their own axes with gravity removed.
felt = raw.acc - ori.GRAVITY * R[..., 1, :]
xyzw = ori.to_quat(ori.R_ZUP_YUP @ R, scalar_first=False)

macs = [bytes([0x02, 0, 0, 0, 0, s]) for s in range(len(raw.sensors))]
boards = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in macs]
for board in boards:
    board.setblocking(False)
    board.connect(("127.0.0.1", args.port))
numbers, met = [0] * len(boards), [False] * len(boards)
print(
    "--map " + ",".join(f"{m.hex(':')}/0={n}" for m, n in zip(macs, raw.sensors, strict=True)),
    flush=True,
)


def listen(s: int) -> None:
    """Take what poser says: the greeting, and pings, which are sent back."""
    try:
        while letter := boards[s].recv(256):
            met[s] |= letter.startswith(b"\x03Hey OVR")
            if letter[3] == 10:
                boards[s].send(letter)
    except OSError:
        return  # nothing more, or nobody there


def send(s: int, kind: int, body: bytes) -> None:
    numbers[s] += 1
    try:
        boards[s].send(struct.pack(">IQ", kind, numbers[s]) + body)
    except OSError:
        met[s] = False  # poser is not there


began, sent, t = time.monotonic(), 0, 0
for k in range(round(args.seconds * RATE)):
    t = (t + 1) % len(raw) if all(met) else 0
    for s, mac in enumerate(macs):
        listen(s)
        if not met[s]:
            if k % 50 == 0:
                hello = struct.pack(">IQ7i", 3, 0, 0, 0, 0, 0, 0, 0, 22)
                numbers[s] = 0
                try:
                    boards[s].send(hello + b"\x01s" + mac + b"\x01")
                except OSError:
                    continue
            continue
        if not np.isfinite(xyzw[t, s]).all() or not np.isfinite(felt[t, s]).all():
            continue
        turn = struct.pack(">IBB4fB", 17, 0, 1, *xyzw[t, s], 0)
        pull = struct.pack(">I3fB", 4, *felt[t, s], 0)
        send(s, 100, b"".join(struct.pack(">H", len(p)) + p for p in (turn, pull)))
        sent += 1
    time.sleep(max(0.0, began + (k + 1) / RATE - time.monotonic()))
print(f"sent {sent} measurements of {len(boards)} trackers to port {args.port}")
