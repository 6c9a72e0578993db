"""JSON lines over UDP: the project's own messages, for senders of one's own (docs/live.md)."""

from __future__ import annotations

from poser.live import packets
from poser.live.receiver import Receiver, y_up
from poser.live.sources.protocol import Intake, Kind, Told


def _make(told: Told) -> Intake:
    decode = y_up(packets.from_json) if told.up == "z" else packets.from_json
    return Receiver(told.addresses[0], decode, told.clock)


SOURCE = Kind("udp", "JSON lines over UDP, for a sender of your own", _make, turns=True)
