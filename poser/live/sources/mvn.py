"""Xsens MVN's network streamer: segments of a whole suit, solved by MVN, over UDP, port 9763, big-endian.

A datagram is "MXTP02", u32 sample, u8 number and last flag, u8 items, u32 time in ms, u8 character, u8 body
segments, u8 props, u8 finger segments, u16, u16 size, then items of i32 segment, f32 x y z m, f32 w x y z.
The world is z-up with x forward, and segment frames are the world's in the T-pose with straight limbs: what
comes are orientations of bones, but for the constants of long bones (`mvnx.straightened`). The acceleration
of a sensor is the second difference of where its seat on the segment is; so a packet is sent on when the next
sample has come.

Devices are named by their places, those of a second character `1:pelvis`. All segments together are the pose
as MVN has it, which `--record` keeps as a reference to compare with.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap import sensors as places
from mocap.formats.mvnx import CARRIERS, PLACES, R_OURS_MVN, root, straightened
from mocap.orientation import Array
from mocap.skeleton import Skeleton
from poser.live.addresses import Address
from poser.live.packets import SEQUENCE_MODULUS, UNIT_TOLERANCE, Packet, Rejected
from poser.live.receiver import Now, Receiver
from poser.live.sources.protocol import MAX_DEVICES, Intake, Kind, Told

PORT = 9763
HEAD = 24  # bytes
ITEM = np.dtype([("segment", ">i4"), ("p", ">f4", 3), ("q", ">f4", 4)])
FAR_M = 1e4
SEGMENTS = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder", "RightUpperArm", "RightForeArm",
    "RightHand", "LeftShoulder", "LeftUpperArm", "LeftForeArm", "LeftHand", "RightUpperLeg",
    "RightLowerLeg", "RightFoot", "RightToe", "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe",
)  # fmt: skip
"""By segment numbers, which begin at 1."""
WINDOW = 240  # samples over which times, sent in whole ms, are smoothed
SAME = 1e-6  # of a sample: a time that is a sample's own
GONE_S = 1.0  # a sender silent for so long is gone: its characters may come from another
ENOUGH = 10  # of them before the time of a sample is known well enough for second differences

# Of each place: its segment, what turns the segment's frame to the bone's, the seat in the bone's axes.
_PLACED = [(place, SEGMENTS.index(segment)) for segment, place in PLACES.items()]
_SEGMENT = np.array([n for _, n in _PLACED])
_STRAIGHT = straightened(Skeleton.default())
_R_SEGMENT_BONE = np.array([_STRAIGHT.get(places.lookup(p).joint, np.eye(3)) for p, _ in _PLACED])
_SEAT = np.array([places.lookup(p).position for p, _ in _PLACED])
# The pelvis' origin is between the hips, not where our pelvis joint is.
_SEAT[_SEGMENT == 0] += root(np.zeros(3), np.eye(3), Skeleton.default())
# Of each joint of ours, the same.
_CARRIER = np.array([SEGMENTS.index(name) for name in CARRIERS])
_R_CARRIER_JOINT = np.array([_STRAIGHT.get(j, np.eye(3)) for j in range(len(CARRIERS))])


@dataclass(frozen=True, eq=False)
class _Row:
    """A sample in our axes: R (23,3,3) of the segments' frames and their origins p (23,3) m, NaN where none
    came."""

    R: Array = field(default_factory=lambda: np.full((len(SEGMENTS), 3, 3), np.nan))
    p: Array = field(default_factory=lambda: np.full((len(SEGMENTS), 3), np.nan))

    def seats(self) -> tuple[Array, Array]:
        """R_world_bone (17,3,3) and where the seats are (17,3) m, of all places."""
        R = self.R[_SEGMENT] @ _R_SEGMENT_BONE
        return R, self.p[_SEGMENT] + np.einsum("sij,sj->si", R, _SEAT)

    def whole(self) -> tuple[Array, Array]:
        """R_world_joint (24,3,3) and the pelvis segment's origin (3,) m."""
        return self.R[_CARRIER] @ _R_CARRIER_JOINT, self.p[0]


@dataclass
class _Character:
    """One wearer's stream: who sends it, and when he was heard last. recent: (sample, s) of the last samples.
    rows: what these hold, by sample."""

    sender: Any = None
    heard_s: float = -np.inf
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=WINDOW))
    rows: dict[int, _Row] = field(default_factory=dict)

    def restart(self) -> None:
        """MVN has begun anew."""
        self.recent.clear()
        self.rows.clear()

    def take(self, sample: int, time_s: float) -> _Row:
        """A row for the next sample."""
        self.recent.append((sample, time_s))
        while len(self.rows) >= WINDOW:
            del self.rows[next(iter(self.rows))]
        return self.rows.setdefault(sample, _Row())

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

    def pose(self, time_s: float) -> tuple[Array, Array] | None:
        """R_world_joint (24,3,3) and the pelvis segment's origin (3,) m at a device time."""
        period = self.period_s()
        if period is None:
            return None
        at = self.recent[-1][0] + (time_s - self.time_s(self.recent[-1][0], period)) / period
        before = round(at) if abs(at - round(at)) < SAME else int(np.floor(at))
        share = max(0.0, at - before)
        ends = [self.rows.get(k) for k in (before, before + (share > SAME))]
        if ends[0] is None or ends[1] is None:
            return None
        (R0, p0), (R1, p1) = ends[0].whole(), ends[1].whole()
        if not all(np.isfinite(x).all() for x in (R0, R1, p0, p1)):
            return None
        turn = ori.log(np.swapaxes(R0, -1, -2) @ R1)
        return R0 @ ori.exp(share * turn), (1 - share) * p0 + share * p1


class Mvn:
    """The decoder, which remembers the last samples of each character."""

    def __init__(self) -> None:
        self._characters: dict[int, _Character] = {}

    def __call__(
        self, datagram: bytes, sender: Any = None, now_s: float = 0.0
    ) -> Iterator[Packet | Rejected]:
        """The packets that a datagram completes. sender: who sent it, where that is known; now_s: when."""
        try:
            yield from self._decode(datagram, sender, now_s)
        except struct.error:
            yield Rejected("too short")
        except Rejected as e:
            yield e

    def _decode(self, datagram: bytes, sender: Any, now_s: float) -> Iterator[Packet]:
        if not datagram.startswith(b"MXTP"):
            raise Rejected("not MVN")
        if not datagram.startswith(b"MXTP02"):
            # Euler angles, points, joint angles, names: MVN sends several kinds side by side.
            raise Rejected("not orientations (MXTP02)")
        sample, _, items, ms, who = struct.unpack_from(">IBBIB", datagram, 6)
        if len(datagram) < HEAD + items * ITEM.itemsize:
            raise Rejected("too short")
        told = np.frombuffer(datagram, ITEM, items, HEAD)
        told = told[(told["segment"] >= 1) & (told["segment"] <= len(SEGMENTS))]
        R, p = _poses(told)
        c = self._character(who, sender, now_s)
        if c.recent and sample == c.recent[-1][0]:
            row, complete = c.rows[sample], False  # a suit with fingers comes in several datagrams
        else:
            row, complete = self._next(c, sample, ms / 1000.0), True
        row.R[told["segment"] - 1], row.p[told["segment"] - 1] = R, p
        if complete:
            yield from _packets(c, who)

    def _character(self, who: int, sender: Any, now_s: float) -> _Character:
        """Whose datagram it is. Raises Rejected where another sender's of this number is still heard."""
        if who not in self._characters and len(self._characters) >= MAX_DEVICES:
            raise Rejected("too many devices")
        c = self._characters.setdefault(who, _Character(sender))
        if c.sender != sender:
            if now_s - c.heard_s < GONE_S:
                raise Rejected("name taken by another device")
            c.restart()
            c.sender = sender
        c.heard_s = now_s
        return c

    def _next(self, c: _Character, sample: int, time_s: float) -> _Row:
        """A row for a sample. Raises Rejected for one that comes after a later one."""
        newest = c.recent[-1][0] if c.recent else None
        if newest is not None and 0 < newest - sample < WINDOW:
            raise Rejected("out of order")
        if newest is not None and not 0 < sample - newest < 10 * WINDOW:
            c.restart()
        return c.take(sample, time_s)

    def pose(self, device: str, time_s: float) -> tuple[Array, Array] | None:
        """Of the character that a device is of: see `_Character.pose`."""
        who, _, named = device.rpartition(":")
        c = self._characters.get(int(who) if named and who.isdecimal() else 0)
        return None if c is None else c.pose(time_s)


def _packets(c: _Character, who: int) -> Iterator[Packet]:
    """Those of the sample before the newest, now that its acceleration is known."""
    period = c.period_s()
    if period is None or len(c.rows) < 3:
        return
    k0, k, k1 = list(c.rows)[-3:]
    R, p = c.rows[k].seats()
    acc = np.full_like(p, np.nan)
    if (k0, k1) == (k - 1, k + 1):
        acc = (c.rows[k0].seats()[1] - 2.0 * p + c.rows[k1].seats()[1]) / period**2
    time_s = c.time_s(k, period)
    for s in np.flatnonzero(np.isfinite(R).all((-1, -2))):
        place = _PLACED[s][0]
        name = place if who == 0 else f"{who}:{place}"
        yield Packet(name, time_s, R[s], acc[s], k % SEQUENCE_MODULUS)


def _poses(told: NDArray[np.void]) -> tuple[Array, Array]:
    """R (N,3,3) and p (N,3) m of items, in our axes. Raises Rejected."""
    p, q = told["p"].astype(float), told["q"].astype(float)
    if not (np.isfinite(p).all() and np.isfinite(q).all()):
        raise Rejected("not finite")
    if (abs(p) > FAR_M).any() or (abs(q) > 2.0).any():
        raise Rejected("out of range")
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    if (abs(norm - 1.0) > UNIT_TOLERANCE).any():
        raise Rejected("not a unit quaternion")
    return R_OURS_MVN @ ori.from_quat(q / norm) @ R_OURS_MVN.T, p @ R_OURS_MVN.T


def _worn(sensors: Sequence[str]) -> dict[str, str]:
    """The segment for each place: its own, or the one on the same bone (left_wrist: the forearm)."""
    found = {}
    for place in sensors:
        joint = places.lookup(place).joint
        same = [p for p in PLACES.values() if places.lookup(p).joint == joint]
        found[place if place in same else next(iter(same), place)] = place
    return found


class Suit(Receiver):
    """The intake, which knows the whole pose besides (`poser.live.sources.protocol.Witness`)."""

    def __init__(self, address: Address, clock: Now):
        self._mvn = Mvn()
        super().__init__(address, self._mvn, clock)

    def _decoded(
        self, datagram: bytes, sender: Any, arrival_s: float
    ) -> Iterator[Packet | Rejected]:
        return self._mvn(datagram, sender, arrival_s)

    def pose(self, device: str, time_s: float) -> tuple[Array, Array] | None:
        return self._mvn.pose(device, time_s)


def _make(told: Told) -> Intake:
    return Suit(told.addresses[0], told.clock)


SOURCE = Kind(
    "mvn", "Xsens MVN's network stream (quaternions)", _make, PORT, bones=True, far=True, worn=_worn
)
