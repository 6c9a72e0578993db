"""The project's own messages over Open Sound Control (docs/live.md)."""

from __future__ import annotations

from poser.live import osc_messages
from poser.live.receiver import Receiver, y_up
from poser.live.sources.protocol import Intake, Kind, Told


def _make(told: Told) -> Intake:
    osc_messages.library()
    decode = y_up(osc_messages.from_osc) if told.up == "z" else osc_messages.from_osc
    return Receiver(told.addresses[0], decode, told.clock)


SOURCE = Kind("osc", "Open Sound Control over UDP", _make, turns=True)
