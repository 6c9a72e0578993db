"""What devices tell of themselves beside their measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class Heard:
    """What one device told of itself. battery: 0 to 1. lost: packets, where they are numbered; ping_ms: half
    the way there and back. note: what its user should know, in words."""

    battery: float | None = None
    lost: int | None = None
    ping_ms: float | None = None
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        return {
            "battery": self.battery,
            "lost": self.lost,
            "ping_ms": self.ping_ms,
            "note": self.note,
        }
