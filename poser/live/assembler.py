"""From packets as they arrive to rows on a regular clock: the jitter buffer.

Row k describes the local time start + k / rate_hz. It is made once every device that is not silent has
consecutive packets around it, or at the latest `delay_s` after its time; what comes later is too late.
Between two packets that lie no more than `max_gap_s` apart the orientation is slerped, the acceleration
linear; at an end the nearest packet within one period of the row stands for it; otherwise the device is
invalid in that row. Times come in with the packets: nothing here reads a clock or a socket.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.motion import check_rate
from mocap.orientation import Array
from poser.live.device_clock import DeviceClock, Pace, PacketNumbers
from poser.live.packets import Packet

SILENT_S = 0.5  # a device unheard for so long is not waited for
STALL_S = 2.0  # the loop itself stood still for longer: rows that nothing came for are left out
MAX_BUFFER = 2048  # packets of one device; 2 s at 1000 Hz
SAME_S = 1e-9
REMEMBER_S = 0.5  # packets are kept for so long after their row, to know their doubles


@dataclass(frozen=True, eq=False)
class Row:
    """All devices at one time: R_world_sensor (D,3,3), acc_world (D,3) m/s^2, valid (D,).

    time_s: since the first row. Where `valid` is False both are NaN.
    """

    time_s: float
    R_world_sensor: Array
    acc_world: Array
    valid: NDArray[np.bool_]


@dataclass
class Counts:
    """What happened to one device's packets.

    received: all that were well formed. duplicates, clock (device time doubtful): not used. late: after
    the row they were for. reordered: not in order, but in time. lost: missing packet numbers. jumps:
    changes of the device's clock. silent_rows: rows in which the device is invalid. others: of another sender
    that gives itself this name, not used; among them no other count is taken.
    """

    received: int = 0
    duplicates: int = 0
    reordered: int = 0
    late: int = 0
    clock: int = 0
    jumps: int = 0
    lost: int = 0
    silent_rows: int = 0
    others: int = 0

    def to_dict(self) -> dict[str, int]:
        return asdict(self)


@dataclass(frozen=True, eq=False)
class _Kept:
    """A packet in the buffer, ordered by device time. number: without wraparound, or None."""

    time_s: float
    R: Array
    acc: Array
    number: int | None


def _time(kept: _Kept) -> float:
    return kept.time_s


class _Sender:
    """Whose packets are a device's: the first who gives himself its name, until nothing of his is heard.

    A sender that opens a socket for each packet comes from another port each time: one that has sent a single
    packet is followed to any port of its machine.
    """

    def __init__(self) -> None:
        self._address: tuple[str, int] | None = None
        self._sent = 0

    def is_heard(
        self, address: tuple[str, int] | None, silent: bool
    ) -> Literal["him", "new", "other"]:
        """Whether a packet from an address is his. silent: nothing of his was heard for long."""
        if address == self._address:
            self._sent += 1
            return "him"
        if address is None or self._address is None or silent:
            self._address, self._sent = address, 1
            return "new"
        if self._sent == 1 and address[0] == self._address[0]:
            self._address = address
            return "him"
        return "other"


class _Stream:
    """The recent packets of one device."""

    def __init__(self) -> None:
        self.sender = _Sender()
        self.clock = DeviceClock()
        self.pace = Pace()
        self.numbers = PacketNumbers()
        self.kept: list[_Kept] = []
        self.heard_s = -np.inf
        self.counts = Counts()

    def push(
        self, packet: Packet, arrival_s: float, last_row_s: float, since_s: float | None
    ) -> None:
        assert packet.R_world_sensor is not None and packet.acc_world is not None
        counts = self.counts
        heard = self.sender.is_heard(packet.sender, arrival_s - self.heard_s > SILENT_S)
        if heard == "other":
            counts.others += 1
            return
        if heard == "new":
            # His clock and his numbers are his own.
            self.clock, self.pace, lost = DeviceClock(), Pace(), self.numbers.lost
            self.numbers = PacketNumbers(lost)
            self.kept.clear()
        counts.received += 1
        self.pace.hear(packet.time_s, arrival_s)
        # Of a packet whose time is refused, forged or wrong, nothing may stay: else its number would pass for
        # heard, and the real one that has it for its double.
        word = self.clock.hear(packet.time_s, arrival_s, since_s)
        if word == "doubtful":
            counts.clock += 1
            return
        number, order = None, "next"
        if word == "jumped":
            counts.jumps += 1
            self.kept.clear()
        if packet.seq is not None and word == "jumped":
            # What was refused before the clock was believed was not lost on its way.
            number = self.numbers.restart(packet.seq)
        elif packet.seq is not None:
            number, order = self.numbers.hear(packet.seq)
        counts.lost = self.numbers.lost
        self.heard_s = arrival_s
        i = bisect_right(self.kept, packet.time_s, key=_time)
        if order == "duplicate" or (i and packet.time_s - self.kept[i - 1].time_s < SAME_S):
            counts.duplicates += 1
            return
        if packet.time_s + self.clock.offset < last_row_s:
            counts.late += 1
        elif order == "reordered" or (packet.seq is None and i < len(self.kept)):
            counts.reordered += 1
        row = _Kept(packet.time_s, packet.R_world_sensor, packet.acc_world, number)
        insort(self.kept, row, key=_time)
        if len(self.kept) > MAX_BUFFER:
            del self.kept[0]

    def around(self, local_s: float) -> tuple[_Kept | None, _Kept | None, float]:
        """The packets before (or at) and after a local time, and that time on the device's clock."""
        if not self.kept:
            return None, None, 0.0
        t = local_s - self.clock.offset
        i = bisect_right(self.kept, t + SAME_S, key=_time)
        before = self.kept[i - 1] if i else None
        return before, self.kept[i] if i < len(self.kept) else None, t

    def next_after(self, local_s: float) -> float | None:
        """The local time of the first packet at or after a local time."""
        _, after, _ = self.around(local_s - 2 * SAME_S)
        return None if after is None else after.time_s + self.clock.offset

    def complete(self, local_s: float) -> bool:
        """Whether nothing that may still arrive can change the row at this time."""
        before, after, t = self.around(local_s)
        if before is None:
            return False
        if abs(before.time_s - t) < SAME_S:
            return True
        if after is None or before.number is None or after.number is None:
            return False
        return after.number == before.number + 1

    def forget_before(self, local_s: float) -> None:
        """Drop packets before this time, but for the last one, which the next row may need."""
        if self.kept:
            i = bisect_right(self.kept, local_s - self.clock.offset, key=_time)
            del self.kept[: max(0, i - 1)]


class Assembler:
    """Rows of `devices` at `rate_hz`. push(packet, arrival) what comes, pull(now) what is ready.

    delay_s: how long a row waits for packets. max_gap_s: how far packets may lie apart to be
    interpolated. Both times are on the same local clock, any origin, never running backwards.
    skipped: rows left out because nothing came for them while the loop stood still for more than STALL_S.
    """

    def __init__(
        self,
        devices: tuple[str, ...],
        rate_hz: float,
        delay_s: float = 0.05,
        max_gap_s: float = 0.1,
    ):
        self.devices = devices
        self.rate_hz = check_rate(rate_hz, "Assembler")
        self.delay_s, self.max_gap_s = delay_s, max_gap_s
        self.skipped = 0
        self.start_s: float | None = None
        self._streams = {name: _Stream() for name in devices}
        self._next = 0

    def push(self, packet: Packet, arrival_s: float, since_s: float | None = None) -> None:
        """Take a packet of one of `devices` that carries an orientation; since_s: see `DeviceClock.hear`."""
        stream = self._streams[packet.device]
        stream.push(packet, arrival_s, self._time(self._next - 1), since_s)
        if self.start_s is None and stream.kept:
            self.start_s = packet.time_s + stream.clock.offset

    def pull(self, now_s: float) -> list[Row]:
        """The rows that are ready at `now_s`, in order."""
        rows: list[Row] = []
        if self.start_s is None:
            return rows
        self._skip(now_s - self.delay_s)
        while self._ready(now_s):
            rows.append(self._row())
            if not rows[-1].valid.any():
                self._skip(now_s - self.delay_s)
        return rows

    def _skip(self, until_s: float) -> None:
        """Leave out the rows to this time, or to the first packet, where that is for more than STALL_S."""
        begin_s = self._time(self._next)
        if until_s - begin_s <= STALL_S:
            return
        came = [t for s in self._streams.values() if (t := s.next_after(begin_s)) is not None]
        skip = max(0, int((min([until_s, *came]) - begin_s) * self.rate_hz))
        self._next += skip
        self.skipped += skip

    @property
    def counts(self) -> dict[str, Counts]:
        """What happened to each device's packets so far."""
        return {name: stream.counts for name, stream in self._streams.items()}

    @property
    def paces(self) -> dict[str, float | None]:
        """How many s of each device's clock pass in one of ours, as far as known."""
        return {name: stream.pace.value for name, stream in self._streams.items()}

    def silent(self, now_s: float) -> tuple[str, ...]:
        """Devices unheard for SILENT_S."""
        return tuple(n for n, s in self._streams.items() if now_s - s.heard_s > SILENT_S)

    def device_time(self, name: str, time_s: float) -> float | None:
        """A row's time on a device's own clock; None before its first packet."""
        stream = self._streams[name]
        if self.start_s is None or not stream.kept:
            return None
        return self.start_s + time_s - stream.clock.offset

    def _time(self, k: int) -> float:
        return -np.inf if self.start_s is None or k < 0 else self.start_s + k / self.rate_hz

    def _ready(self, now_s: float) -> bool:
        t = self._time(self._next)
        if now_s >= t + self.delay_s:
            return True
        heard = [s for s in self._streams.values() if now_s - s.heard_s <= SILENT_S]
        # A device not heard at all yet may be about to start: the full delay is due to it.
        return len(heard) == len(self._streams) and all(s.complete(t) for s in heard)

    def _row(self) -> Row:
        k, D = self._next, len(self.devices)
        t = self._time(k)
        R, acc = np.full((D, 3, 3), np.nan), np.full((D, 3), np.nan)
        valid = np.zeros(D, bool)
        between: list[tuple[int, _Kept, _Kept, float]] = []
        for d, stream in enumerate(self._streams.values()):
            before, after, at = stream.around(t)
            pair = self._pair(before, after, at)
            if pair is None:
                stream.counts.silent_rows += 1
            else:
                between.append((d, *pair))
            stream.forget_before(t - REMEMBER_S)
        if between:
            used = [d for d, *_ in between]
            R[used], acc[used] = _interpolated(between)
            valid[used] = True
        self._next += 1
        return Row(k / self.rate_hz, R, acc, valid)

    def _pair(
        self, before: _Kept | None, after: _Kept | None, at: float
    ) -> tuple[_Kept, _Kept, float] | None:
        """Two packets and the share of the second one at the device's time `at`; None: invalid."""
        if before is not None and abs(before.time_s - at) < SAME_S:
            return before, before, 0.0
        if before is not None and after is not None:
            gap = after.time_s - before.time_s
            if gap <= self.max_gap_s:
                return before, after, (at - before.time_s) / gap
        near = [p for p in (before, after) if p is not None]
        nearest = min(near, key=lambda p: abs(p.time_s - at), default=None)
        if nearest is None or abs(nearest.time_s - at) > 1.0 / self.rate_hz:
            return None
        return nearest, nearest, 0.0


def _interpolated(between: list[tuple[int, _Kept, _Kept, float]]) -> tuple[Array, Array]:
    """R (N,3,3) and acc (N,3) at the shares of N pairs of packets."""
    R0, a0 = np.array([p.R for _, p, _, _ in between]), np.array([p.acc for _, p, _, _ in between])
    R1, a1 = np.array([p.R for _, _, p, _ in between]), np.array([p.acc for _, _, p, _ in between])
    share = np.array([pair[3] for pair in between])[:, None]
    R = np.array(R0)
    moved = share[:, 0] > 0
    if moved.any():
        turn = ori.log(np.swapaxes(R0[moved], -1, -2) @ R1[moved])
        R[moved] = R0[moved] @ ori.exp(share[moved] * turn)
    return R, np.where(moved[:, None], (1 - share) * a0 + share * a1, a0)
