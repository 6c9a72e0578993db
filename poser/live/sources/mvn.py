"""Xsens MVN's network streamer: segments of a whole suit, solved by MVN, over UDP, port 9763, big-endian.

A datagram is "MXTP02", u32 sample, u8 number and last flag, u8 items, u32 time in ms, u8 character, u8 body
segments, u8 props, u8 finger segments, u16, u16 size, then items of i32 segment, f32 x y z m, f32 w x y z.
The world is z-up with x forward, and segment frames are the world's in the T-pose with straight limbs: what
comes are orientations of bones, but for the constants of long bones (`mvnx.straightened`). The acceleration
of a sensor is the second difference of where its seat on the segment is; so a packet is sent on when the next
sample has come.

Devices are named by their places, those of a second character `1:pelvis`.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from mocap import sensors as places
from mocap.formats.mvnx import PLACES, R_OURS_MVN, straightened
from mocap.orientation import Array
from mocap.skeleton import Skeleton
from poser.live.packets import SEQUENCE_MODULUS, Packet, Rejected, number, rotation
from poser.live.receiver import Receiver
from poser.live.sources.protocol import MAX_DEVICES, Intake, Kind, Told

PORT = 9763
HEAD, ITEM = 24, 32  # bytes
FAR_M = 1e4
SEGMENTS = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder", "RightUpperArm", "RightForeArm",
    "RightHand", "LeftShoulder", "LeftUpperArm", "LeftForeArm", "LeftHand", "RightUpperLeg",
    "RightLowerLeg", "RightFoot", "RightToe", "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe",
)  # fmt: skip
"""By segment numbers, which begin at 1."""
WINDOW = 240  # samples over which times, sent in whole ms, are smoothed
ENOUGH = 10  # of them before the time of a sample is known well enough for second differences

_STRAIGHT = straightened(Skeleton.default())


@dataclass
class _Character:
    """One wearer's stream. recent: (sample, s) of the last samples."""

    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=WINDOW))
    rows: deque[tuple[int, dict[str, tuple[Array, Array]]]] = field(
        default_factory=lambda: deque(maxlen=3)
    )

    def period_s(self) -> float | None:
        """Seconds from one sample to the next; None while too few are known."""
        if len(self.recent) < ENOUGH:
            return None
        (first, begin), (last, end) = self.recent[0], self.recent[-1]
        return (end - begin) / (last - first) if last > first and end > begin else None

    def time_s(self, sample: int, period_s: float) -> float:
        """Of a sample, by all recent ones: to a fraction of a ms."""
        k, t = np.mean(self.recent, axis=0)
        return float(t + (sample - k) * period_s)


class Mvn:
    """The decoder, which remembers the last samples of each character."""

    def __init__(self) -> None:
        self._characters: dict[int, _Character] = {}

    def __call__(self, datagram: bytes) -> Iterator[Packet | Rejected]:
        try:
            yield from self._decode(datagram)
        except struct.error:
            yield Rejected("too short")
        except Rejected as e:
            yield e

    def _decode(self, datagram: bytes) -> Iterator[Packet]:
        if not datagram.startswith(b"MXTP"):
            raise Rejected("not MVN")
        if not datagram.startswith(b"MXTP02"):
            # Euler angles, points, joint angles, names: MVN sends several kinds side by side.
            raise Rejected("not orientations (MXTP02)")
        sample, _, items, ms, who = struct.unpack_from(">IBBIB", datagram, 6)
        if len(datagram) < HEAD + items * ITEM:
            raise Rejected("too short")
        row = {}
        for k in range(items):
            segment, *values = struct.unpack_from(">i7f", datagram, HEAD + k * ITEM)
            place = PLACES.get(SEGMENTS[segment - 1]) if 1 <= segment <= len(SEGMENTS) else None
            if place is not None:
                row[place] = _seat(place, *_pose(values))
        yield from self._next(self._character(who), who, sample, ms / 1000.0, row)

    def _character(self, who: int) -> _Character:
        if who not in self._characters and len(self._characters) >= MAX_DEVICES:
            raise Rejected("too many devices")
        return self._characters.setdefault(who, _Character())

    def _next(
        self,
        c: _Character,
        who: int,
        sample: int,
        time_s: float,
        row: dict[str, tuple[Array, Array]],
    ) -> Iterator[Packet]:
        """The packets of the sample before this one, now that its acceleration is known."""
        newest = c.recent[-1][0] if c.recent else None
        if newest is not None and sample == newest and c.rows and c.rows[-1][0] == sample:
            c.rows[-1][1].update(row)  # a suit with fingers comes in several datagrams
            return
        if newest is not None and 0 < newest - sample < WINDOW:
            raise Rejected("out of order")
        if newest is not None and not 0 < sample - newest < 10 * WINDOW:
            c.recent.clear()  # MVN has begun anew
            c.rows.clear()
        c.recent.append((sample, time_s))
        c.rows.append((sample, row))
        period = c.period_s()
        if period is None or len(c.rows) < 3:
            return
        (k0, before), (k, now), (k1, after) = c.rows
        for place, (R, p) in now.items():
            acc = np.full(3, np.nan)
            if k0 == k - 1 and k1 == k + 1 and place in before and place in after:
                acc = (before[place][1] - 2.0 * p + after[place][1]) / period**2
            name = place if who == 0 else f"{who}:{place}"
            yield Packet(name, c.time_s(k, period), R, acc, k % SEQUENCE_MODULUS)


def _pose(values: Sequence[float]) -> tuple[Array, Array]:
    """R_world_bone (3,3) and the segment's origin (3,) m, in our axes. Raises Rejected."""
    p = np.array([number(v, FAR_M) for v in values[:3]])
    R = rotation(np.array([number(v, 2.0) for v in values[3:]]))
    return R_OURS_MVN @ R @ R_OURS_MVN.T, R_OURS_MVN @ p


def _seat(place: str, R: Array, p: Array) -> tuple[Array, Array]:
    """R of our bone, and where the sensor's seat on it is."""
    where = places.lookup(place)
    R = R @ _STRAIGHT.get(where.joint, np.eye(3))
    return R, p + R @ np.array(where.position)


def _worn(sensors: Sequence[str]) -> dict[str, str]:
    """The segment for each place: its own, or the one on the same bone (left_wrist: the forearm)."""
    found = {}
    for place in sensors:
        joint = places.lookup(place).joint
        same = [p for p in PLACES.values() if places.lookup(p).joint == joint]
        found[place if place in same else next(iter(same), place)] = place
    return found


def _make(told: Told) -> Intake:
    return Receiver(told.addresses[0], Mvn(), told.clock)


SOURCE = Kind(
    "mvn", "Xsens MVN's network stream (quaternions)", _make, PORT, bones=True, far=True, worn=_worn
)
