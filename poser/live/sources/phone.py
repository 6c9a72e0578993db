"""Phones and watches: orientation, acceleration and gravity come separately; here they become packets.

Systems differ. Android reads specific force (gravity points up when the phone lies still), iOS its
opposite, in g or in m/s^2 by app; and some send the rotation from the world to the device. Gravity tells:
turned into the world it must be vertical, whatever the phone does. With R of the quaternion,

    direction:  R or R^T, whichever keeps gravity vertical
    sign, unit: those that make it +9.81 m/s^2 upwards

The world is z-up; R_world_sensor of a packet is y-up. Where gravity does not come, there is no acceleration
unless the app's convention is known.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from poser.live.packets import Packet
from poser.live.sources.order import InOrder

NEAR_S = 0.1  # an acceleration further from an orientation is not of it
MEMORY = 256  # samples of each kind
SURE = 0.95  # of gravity's vertical part, mean over the samples so far
SEEN = 10  # samples of gravity before it is believed
FADE = 0.98  # of what earlier samples count
G_OR_METRES = 3.0  # gravity below is in g


@dataclass(frozen=True)
class Convention:
    """How a system writes: world_to_device: the quaternion turns that way. factor: from what it calls
    acceleration to specific force in m/s^2 (its sign and unit)."""

    world_to_device: bool
    factor: float

    def words(self) -> str:
        """For people."""
        unit = "g" if abs(self.factor) > 2 else "m/s^2"
        way = ", rotations from world to device" if self.world_to_device else ""
        return f"acceleration in {unit}{', sign reversed' if self.factor < 0 else ''}{way}"


class Gravity:
    """Learns the convention from samples of gravity."""

    def __init__(self) -> None:
        self._up = np.zeros(2)  # mean vertical part, for device to world and the other way
        self._size = 0.0
        self._weight = 0.0
        self._seen = 0

    def see(self, R: Array, gravity: Array) -> None:
        """Gravity (3,) as the device calls it, at an orientation R of its quaternion."""
        size = float(np.linalg.norm(gravity))
        if size < 0.1:
            return
        g = gravity / size
        self._up = FADE * self._up + np.array([R[2] @ g, R[:, 2] @ g])
        self._size = FADE * self._size + size
        self._weight = FADE * self._weight + 1.0
        self._seen += 1

    def convention(self) -> Convention | None:
        """None while it is not clear."""
        if self._seen < SEEN:
            return None
        up, size = self._up / self._weight, self._size / self._weight
        other = bool(abs(up[1]) > abs(up[0]) + 0.02)  # lying flat, both fit: then the usual one
        if abs(up[int(other)]) < SURE:
            return None
        unit = ori.GRAVITY if size < G_OR_METRES else 1.0
        return Convention(other, float(np.sign(up[int(other)]) * unit))


class Phone:
    """One device's samples, and the packets they make. order: numbers them. known: the app's convention where
    gravity does not come. sent_s: the time of the last packet."""

    def __init__(self, name: str, order: InOrder, known: Convention | None = None):
        self.name, self._order = name, order
        self._known = known
        self._gravity = Gravity()
        self._turns: deque[tuple[float, Array]] = deque(maxlen=MEMORY)
        self._acc: deque[tuple[float, Array]] = deque(maxlen=MEMORY)
        self._down: deque[tuple[float, Array]] = deque(maxlen=MEMORY)
        self.sent_s = -np.inf
        self.late = 0

    @property
    def convention(self) -> Convention | None:
        """What gravity told, else what is known of the app."""
        return self._gravity.convention() or self._known

    def turn(self, time_s: float, R: Array) -> None:
        """An orientation, as the device's quaternion says."""
        if time_s <= self.sent_s or (self._turns and time_s <= self._turns[-1][0]):
            self.late += 1
            return
        self._turns.append((time_s, R))

    def feel(self, time_s: float, acc: Array) -> None:
        """An acceleration without gravity, in the device's axes and its own convention."""
        _keep(self._acc, time_s, acc)

    def weigh(self, time_s: float, gravity: Array) -> None:
        """Gravity, in the device's axes and its own convention."""
        _keep(self._down, time_s, gravity)

    def packets(self) -> Iterator[Packet]:
        """Orientations that have an acceleration on both sides, or will get none."""
        while self._turns:
            time_s, R = self._turns[0]
            newest = self._turns[-1][0]
            if self._acc and self._acc[-1][0] < time_s and newest - time_s < NEAR_S:
                return
            self._turns.popleft()
            down = _at(self._down, time_s)
            if down is not None:
                self._gravity.see(R, down)
            self.sent_s = time_s
            yield self._packet(time_s, R, _at(self._acc, time_s))

    def _packet(self, time_s: float, R: Array, acc: Array | None) -> Packet:
        how = self.convention
        R_zup = R.T if how is not None and how.world_to_device else R
        R_world = ori.R_YUP_ZUP @ R_zup
        world = np.full(3, np.nan)
        if acc is not None and how is not None:
            world = R_world @ (how.factor * acc)
        return Packet(self.name, time_s, R_world, world, self._order.number(self.name))


def _keep(samples: deque[tuple[float, Array]], time_s: float, value: Array) -> None:
    """What comes out of order is left out: its neighbours stand for it."""
    if not samples or time_s > samples[-1][0]:
        samples.append((time_s, value))


def _at(samples: deque[tuple[float, Array]], time_s: float) -> Array | None:
    """Linear between samples; the nearest at an end; None where none is within NEAR_S."""
    times = [t for t, _ in samples]
    i = bisect_right(times, time_s)
    around = [samples[k] for k in (i - 1, i) if 0 <= k < len(samples)]
    near = [(t, v) for t, v in around if abs(t - time_s) <= NEAR_S]
    if len(near) < 2:
        return near[0][1] if near else None
    (t0, v0), (t1, v1) = near
    share = (time_s - t0) / (t1 - t0)
    return np.asarray((1 - share) * v0 + share * v1)
