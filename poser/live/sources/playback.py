"""Raw recordings as if their sensors were there: what `--record` wrote, and the demonstration."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.recording import Bool, RawRecording
from poser.live.heard import Heard
from poser.live.packets import SEQUENCE_MODULUS, Packet
from poser.live.receiver import Now
from poser.live.sources.protocol import Intake, Kind, Told

UP_G = np.array([0.0, ori.GRAVITY, 0.0])


class Playback:
    """The intake of a raw recording, at its own pace. again: from the beginning, without end.

    Raises PoserError where the recording holds no orientations.
    """

    def __init__(
        self,
        raw: RawRecording,
        clock: Now = time.monotonic,
        again: bool = False,
        sleep: Callable[[float], None] = time.sleep,
    ):
        if raw.R_world_sensor is None:
            raise PoserError(
                "the recording holds no orientations, which live needs; poser calibrate fuses them"
            )
        self._R = raw.R_world_sensor
        self._acc = np.einsum("tsij,tsj->tsi", self._R, raw.acc) - UP_G
        self._has: Bool = np.asarray(np.isfinite(self._R).all((-1, -2)))
        self._raw, self._clock, self._again, self._sleep = raw, clock, again, sleep
        self._began_s = 0.0
        self._next = 0
        self.rejected: Counter[str] = Counter()

    def open(self) -> None:
        self._began_s = self._clock()

    @property
    def ended(self) -> bool:
        """All has been played."""
        return not self._again and self._next >= len(self._raw)

    read_s = np.inf  # nothing waits

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        due_s = self._began_s + self._next / self._raw.rate_hz
        if (early := due_s - self._clock()) > 0:
            self._sleep(min(wait_s, early))
        while not self.ended:
            due_s = self._began_s + self._next / self._raw.rate_hz
            if due_s > self._clock() + 1e-6:
                return
            k = self._next
            self._next += 1
            for packet in self._row(k):
                yield packet, due_s, None

    def _row(self, k: int) -> Iterator[Packet]:
        t = k % len(self._raw)
        for s, name in enumerate(self._raw.sensors):
            if self._has[t, s]:
                yield Packet(
                    name,
                    k / self._raw.rate_hz,
                    self._R[t, s],
                    self._acc[t, s],
                    k % SEQUENCE_MODULUS,
                )

    def heard(self) -> Mapping[str, Heard]:
        return {}

    def close(self) -> None: ...


def kind(raw: RawRecording) -> Kind:
    """The kind of a raw recording."""

    def make(told: Told) -> Intake:
        return Playback(raw, told.clock)

    return Kind(
        "recording", "a raw recording", make, None, own_headings=not raw.common_heading,
        starts_anew=False,
    )  # fmt: skip
