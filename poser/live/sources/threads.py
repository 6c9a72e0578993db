"""Intakes whose devices are waited for in a thread of their own: HTTP and Bluetooth, which may be slow.

The thread puts what came into a queue of bounded length; the loop takes it out, and is never kept waiting.
"""

from __future__ import annotations

import queue
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

from poser.live.heard import Heard
from poser.live.packets import Packet, Rejected
from poser.live.receiver import CATCH_UP, POLL_S, Now, Reading

LENGTH = 256  # letters that wait: seconds of batches


@dataclass(frozen=True)
class Letter:
    """What came from a device at one time. sender: who, as the thread knows it."""

    body: bytes
    sender: str
    arrival_s: float


class Reader(Protocol):
    """Makes packets of letters, in the loop's own thread. batched: the packets of a letter were measured
    one after another, and sent together when the last one was."""

    batched: bool

    def read(self, letter: Letter) -> Iterator[Packet | Rejected]: ...

    def heard(self) -> Mapping[str, Heard]: ...


class Worker(Protocol):
    """The thread. `start` raises PoserError where it cannot; `stop` ends it within seconds."""

    def start(self, post: Mailbox) -> None: ...

    def stop(self) -> None: ...


class Mailbox:
    """Where a thread leaves letters, and counts what it could not take."""

    def __init__(self, clock: Now):
        self._queue: queue.Queue[Letter] = queue.Queue(LENGTH)
        self._faults: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._clock = clock

    def put(self, body: bytes, sender: str) -> bool:
        """False where the queue is full: the letter is lost."""
        try:
            self._queue.put_nowait(Letter(body, sender, self._clock()))
        except queue.Full:
            self.fault("too much at once")
            return False
        return True

    def fault(self, reason: str) -> None:
        """Count something that went wrong, by few fixed words."""
        if self._faults.qsize() < 10_000:
            self._faults.put(reason)

    def take(self, wait_s: float) -> Letter | None:
        try:
            return self._queue.get(timeout=wait_s) if wait_s > 0 else self._queue.get_nowait()
        except queue.Empty:
            return None

    def faults(self) -> Iterator[str]:
        """What went wrong since the last look."""
        while not self._faults.empty():
            yield self._faults.get()


class Threaded:
    """The intake of a reader whose letters a worker brings."""

    ended = False

    def __init__(self, reader: Reader, worker: Worker, clock: Now = time.monotonic):
        self._reader, self._worker, self._clock = reader, worker, clock
        self._box = Mailbox(clock)
        self._reading = Reading(clock())
        self.rejected: Counter[str] = Counter()

    @property
    def read_s(self) -> float:
        """See `Intake`."""
        return self._reading.read_s

    def open(self) -> None:
        self._worker.start(self._box)

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        looked = self._clock()
        letter = self._box.take(wait_s)
        until = self._clock() + POLL_S + CATCH_UP * wait_s
        while letter is not None:
            yield from self._opened(letter)
            looked = self._clock()
            if looked >= until:
                self._reading.broken_off(looked, letter.arrival_s)
                break
            letter = self._box.take(0.0)
        else:
            self._reading.emptied(looked)
        self.rejected.update(self._box.faults())

    def _opened(self, letter: Letter) -> Iterator[tuple[Packet, float, float | None]]:
        """The packets of a letter. In a batch each is as old as the newest one, more its age: it would have
        come then, had it been sent alone."""
        packets = []
        for found in self._reader.read(letter):
            if isinstance(found, Rejected):
                self.rejected[found.reason] += 1
            else:
                packets.append(found)
        newest: dict[str, float] = {}
        for p in packets:
            newest[p.device] = max(p.time_s, newest.get(p.device, p.time_s))
        for p in packets:
            age = newest[p.device] - p.time_s if self._reader.batched else 0.0
            yield p, letter.arrival_s - age, None

    def heard(self) -> Mapping[str, Heard]:
        return self._reader.heard()

    def close(self) -> None:
        self._worker.stop()
