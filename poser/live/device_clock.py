"""A device's clock in the receiver's time, and its packet numbers.

    local = device + offset,    offset = min over the last WINDOW_S of (arrival - device time)

The quickest packet of a window is the one that waited least (as in NTP's filter), so jitter of the
network does not become jitter of the motion. What is left is that least delay, a few ms on a local
network, and the drift of the clocks within the window, below 1 ms.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

from poser.live.packets import SEQUENCE_MODULUS

WINDOW_S = 10.0
JUMP_S = 0.25  # an arrival further from its expected time is late, or the clock has jumped
CONFIRM_S = 0.5  # a clock has jumped once its packets agree about it for this long
PACE_S = 1.0  # over which a clock's pace is taken
MAX_DROPOUT, MAX_MISORDER = 3000, 1000  # packet numbers; beyond, the device has started again


class DeviceClock:
    """The offset of one device's clock; see `hear`."""

    def __init__(self) -> None:
        # Sliding minimum: (arrival, offset), offsets rising from the left, the least one first.
        self._window: deque[tuple[float, float]] = deque()
        # Offset, arrival and time at its start.
        self._doubt: tuple[float, float, float] | None = None

    @property
    def offset(self) -> float:
        """Local minus device time in s."""
        return self._window[0][1]

    def hear(
        self, time_s: float, arrival_s: float, since_s: float | None = None
    ) -> Literal["in time", "doubtful", "jumped"]:
        """Take note of a packet of device time `time_s` that was found at `arrival_s`.

        since_s: when nobody had found it yet. It came in between; where that may have been in time, it
        is: a loop that stood still finds all that the socket kept for it at once.
        "doubtful": it lies JUMP_S off; a single late or false packet must not move the clock, so the
        offset stays and the packet should be dropped. "jumped": packets have agreed about another
        offset for CONFIRM_S, with time passing on both clocks (after a stall of the network the
        packets of seconds come at once: that is no jump), and it is now the offset.
        """
        offset = arrival_s - time_s
        if not self._window or abs(offset - self.offset) <= JUMP_S:
            self._doubt = None
            self._take(offset, arrival_s)
            return "in time"
        if since_s is not None and since_s - time_s <= self.offset + JUMP_S < offset:
            return "in time"
        if self._doubt is None or abs(offset - self._doubt[0]) > JUMP_S / 2:
            self._doubt = (offset, arrival_s, time_s)
            return "doubtful"
        _, since, at = self._doubt
        if arrival_s - since < CONFIRM_S or time_s - at < CONFIRM_S / 2:
            return "doubtful"
        self._window.clear()
        self._doubt = None
        self._take(offset, arrival_s)
        return "jumped"

    def _take(self, offset: float, arrival_s: float) -> None:
        while self._window and self._window[-1][1] >= offset:
            self._window.pop()
        self._window.append((arrival_s, offset))
        while self._window[0][0] < arrival_s - WINDOW_S:
            self._window.popleft()


class Pace:
    """How many s of a device's clock pass in one of ours: its unit shows, and whether it stands."""

    def __init__(self) -> None:
        self._from: tuple[float, float] | None = None
        self._last: float | None = None
        self.value: float | None = None
        """None until two spans of PACE_S agree; a device that starts again, or batches, makes none."""

    def hear(self, time_s: float, arrival_s: float) -> None:
        """Take note of a packet, whether or not its time is believed."""
        if self._from is None:
            self._from = (time_s, arrival_s)
        passed = arrival_s - self._from[1]
        if passed < PACE_S:
            return
        pace = (time_s - self._from[0]) / passed
        last, self._last, self._from = self._last, pace, (time_s, arrival_s)
        agree = last is not None and abs(pace - last) <= max(abs(pace), abs(last)) / 2
        self.value = pace if agree else None


class PacketNumbers:
    """Counts what is lost, doubled and reordered by the packets' numbers modulo 65536 (as RFC 3550).

    lost: numbers never heard so far; it counts on from where it is told to.
    """

    def __init__(self, lost: int = 0) -> None:
        self._base = self._highest = 0
        self._heard = 0
        self._recent: set[int] = set()
        self._order: deque[int] = deque(maxlen=2 * MAX_MISORDER)
        self._lost_before = lost

    @property
    def lost(self) -> int:
        if not self._heard:
            return self._lost_before
        return self._lost_before + self._highest - self._base + 1 - self._heard

    def hear(self, seq: int) -> tuple[int, Literal["next", "reordered", "duplicate"]]:
        """The packet's number without wraparound, and what it is."""
        step = (seq - self._highest) % SEQUENCE_MODULUS
        if step > SEQUENCE_MODULUS // 2:
            step -= SEQUENCE_MODULUS
        if not self._heard or not -MAX_MISORDER < step < MAX_DROPOUT:
            return self.restart(seq), "next"
        number = self._highest + step
        if number in self._recent:
            return number, "duplicate"
        # What was sent before the first packet heard is not counted against the rest.
        self._base = min(self._base, number)
        self._note(number)
        if step < 0:
            return number, "reordered"
        self._highest = number
        return number, "next"

    def restart(self, seq: int) -> int:
        """The number of a packet with which the device has begun to count again."""
        self._lost_before = self.lost
        # Counts on from above all earlier numbers, so that no number stands for two packets.
        number = self._highest + SEQUENCE_MODULUS
        number += (seq - number) % SEQUENCE_MODULUS
        self._base = self._highest = number
        self._heard = 0
        self._recent.clear()
        self._order.clear()
        self._note(number)
        return number

    def _note(self, number: int) -> None:
        self._heard += 1
        if len(self._order) == self._order.maxlen:
            self._recent.discard(self._order[0])
        self._order.append(number)
        self._recent.add(number)
