"""Which device is which: the one that is turned in the hand moves, the others lie still."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from poser.live.sources.protocol import Intake

LOOK_S = 0.05
LONGEST_S = 20.0
TURN_DEG = 60.0  # how far a device has to turn to be the one
RIVAL = 0.5  # another that turned by so much of it makes it unclear


class Turns:
    """How far each device has turned from where it was when it was seen first, at most, in deg."""

    def __init__(self) -> None:
        self._first: dict[str, Array] = {}
        self.deg: dict[str, float] = {}

    def see(self, device: str, R_world_sensor: Array) -> None:
        """Take note of an orientation."""
        first = self._first.setdefault(device, R_world_sensor)
        turned = float(np.rad2deg(ori.angle_between(first, R_world_sensor)))
        self.deg[device] = max(turned, self.deg.get(device, 0.0))

    def found(self, but: Collection[str]) -> str | None:
        """The device that turned, where one did and no other one nearly as far; not those in `but`."""
        order = sorted((d for d in self.deg if d not in but), key=lambda d: -self.deg[d])
        if not order or self.deg[order[0]] < TURN_DEG:
            return None
        if len(order) > 1 and self.deg[order[1]] > RIVAL * self.deg[order[0]]:
            return None
        return order[0]


def turned(
    intake: Intake,
    but: Collection[str],
    seconds: float = LONGEST_S,
    clock: Callable[[], float] = time.monotonic,
) -> str | None:
    """Waits until one device of an open intake is turned; None where none was in time."""
    turns, until = Turns(), clock() + seconds
    while clock() < until:
        for packet, _, _ in intake.receive(LOOK_S):
            if packet.R_world_sensor is not None:
                turns.see(packet.device, packet.R_world_sensor)
        found = turns.found(but)
        if found is not None:
            return found
    return None
