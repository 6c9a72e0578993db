"""Numbers for packets of devices that number none, or whose order is known anyway."""

from __future__ import annotations

from poser.live.packets import SEQUENCE_MODULUS

MOST = 1024  # names that are remembered: whoever sends chooses them


class InOrder:
    """Counts each device's packets, which come in the order of their times. Nothing that may still come is of
    an earlier time: so no sample has to wait for it. The count goes on where a device starts again.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def number(self, device: str) -> int:
        """Of the next packet of a device."""
        count = self._counts.pop(device, 0) + 1
        if len(self._counts) >= MOST:
            del self._counts[next(iter(self._counts))]  # the one that was heard longest ago
        self._counts[device] = count
        return count % SEQUENCE_MODULUS
