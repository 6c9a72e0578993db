"""How long things take: quantiles over everything measured."""

from __future__ import annotations

from array import array

import numpy as np


class Latency:
    """Seconds, added one by one; told in ms."""

    def __init__(self) -> None:
        self._seconds = array("d")

    def add(self, seconds: float) -> None:
        self._seconds.append(seconds)

    def __len__(self) -> int:
        return len(self._seconds)

    def quantile_ms(self, q: float, last: int | None = None) -> float | None:
        """The q-quantile in ms, over all or the `last` measurements; None before the first."""
        values = self._seconds[-last:] if last else self._seconds
        return float(np.quantile(values, q) * 1e3) if len(values) else None

    def to_dict(self, name: str) -> dict[str, float | None]:
        """{"NAME_p50": ms, "NAME_p99": ms}."""
        return {f"{name}_p50": self.quantile_ms(0.5), f"{name}_p99": self.quantile_ms(0.99)}
