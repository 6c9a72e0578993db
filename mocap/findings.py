"""The record of one doubt, in a form a person and a program can act on."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One thing to know. severity: "error" (the result would be wrong), "warning" or "info".

    sensor: the place, or None for the whole body. code: a stable name for programs. sentence: for
    people, with the number and its unit and what to do. value: the number alone.
    """

    severity: Severity
    sensor: str | None
    code: str
    sentence: str
    value: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)
