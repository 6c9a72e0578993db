"""The record of one doubt, in a form that a program can act on: a code, a sensor, numbers; no sentence.

Sentences are made where they are printed, from the code and the details: `mocap.words`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Severity = Literal["error", "warning", "info"]
Words = str | Callable[[dict[str, Any]], str]
"""What makes a sentence of a finding's details: a template, or a function."""
ORDER: dict[Severity, int] = {"error": 0, "warning": 1, "info": 2}
"""The worst first."""


@dataclass(frozen=True)
class Finding:
    """One thing to know. severity: "error" (the result would be wrong), "warning" or "info".

    sensor: the place, or None for the whole body. code: a stable name for programs. value: the number that
    the finding rests on, where there is one. details: what else a sentence about it needs, JSON values by
    name, the unit in the name; "said" holds a whole sentence where somebody else made it.
    """

    severity: Severity
    sensor: str | None
    code: str
    value: float | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)


def doubt(code: str, sensor: str | None = None, **details: Any) -> Finding:
    """What a reader doubts: a warning."""
    return Finding("warning", sensor, code, None, details)


def assumption(code: str, **details: Any) -> Finding:
    """What a reader took for granted, since the file does not say it."""
    return Finding("info", None, code, None, details)


def distinct(findings: Iterable[Finding]) -> list[Finding]:
    """Each finding once, in order."""
    found: list[Finding] = []
    for one in findings:
        if one not in found:
            found.append(one)
    return found
