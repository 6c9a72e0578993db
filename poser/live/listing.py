"""What is heard before anything is worn: devices, rates, batteries, losses."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mocap.sensors import PLACES
from poser.console import say, table
from poser.live.heard import Heard
from poser.live.packets import Packet
from poser.live.sources.protocol import MAX_DEVICES, Intake

SECONDS = 5.0
LOOK_S = 0.05


@dataclass
class PacketCount:
    """One device's packets: how many, the first and the last, of how many the acceleration came with them."""

    packets: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    felt: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Packets a second between the first and the last."""
        spent = self.last_s - self.first_s
        return (self.packets - 1) / spent if self.packets > 1 and spent > 0 else None


class Listing:
    """Listens and keeps what is heard. Names are bounded: who sends chooses them."""

    def __init__(self, intake: Intake, clock: Callable[[], float] = time.monotonic):
        self._intake, self._clock = intake, clock
        self.devices: dict[str, PacketCount] = {}

    def open(self) -> None:
        """Begin. Raises PoserError where the intake cannot be opened."""
        self._intake.open()

    def listen(self, seconds: float) -> None:
        """Take what comes for so long."""
        until = self._clock() + seconds
        while self._clock() < until and not self._intake.ended:
            for packet, arrival, _ in self._intake.receive(LOOK_S):
                self._note(packet, arrival)

    def _note(self, packet: Packet, arrival_s: float) -> None:
        if packet.device not in self.devices and len(self.devices) >= MAX_DEVICES:
            self._intake.rejected["too many devices"] += 1
            return
        seen = self.devices.setdefault(packet.device, PacketCount(first_s=arrival_s))
        seen.packets += 1
        seen.last_s = arrival_s
        seen.felt += packet.acc_world is not None and bool(
            packet.acc_world[0] == packet.acc_world[0]
        )

    def to_dict(self, places: Mapping[str, str]) -> dict[str, Any]:
        """places: of the devices that have one."""
        told = self._intake.heard()
        names = [*self.devices, *(n for n in told if n not in self.devices)]
        rows = {}
        for name in names:
            seen = self.devices.get(name, PacketCount())
            rows[name] = {
                "place": places.get(name, name if name in PLACES else None),
                "packets": seen.packets, "rate_hz": seen.rate_hz,
                "acceleration": seen.felt > 0, **told.get(name, Heard()).to_dict(),
            }  # fmt: skip
        return {"devices": rows, "rejected": dict(sorted(self._intake.rejected.items()))}


def show(found: Mapping[str, Any]) -> None:
    """A table for people."""
    rows = [
        (
            name, d["place"] or "-", _number(d["rate_hz"], "{:.1f}"), "yes" if d["acceleration"] else "no",
            _number(d["battery"], "{:.0%}"), _number(d["lost"], "{}"), _number(d["ping_ms"], "{:.0f}"),
            d["note"] or "-",
        )
        for name, d in found["devices"].items()
    ]  # fmt: skip
    if rows:
        table(("device", "worn at", "Hz", "acceleration", "battery", "lost", "ms", "note"), rows)
    else:
        say("nothing heard")
    for reason, count in found["rejected"].items():
        say(f"refused: {reason}: {count}")


def _number(value: Any, form: str) -> str:
    return "-" if value is None else form.format(value)
