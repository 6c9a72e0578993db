"""The sentences: what each finding says to a person, with its numbers, and what to do.

A table for each room, code -> template or function of the finding's details; nothing else words findings,
and nothing reads a sentence again. A finding of a package of your own carries its sentence in
details["said"].
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from mocap.findings import ORDER, Finding, Words


@cache
def _tables() -> dict[str, Words]:
    from mocap.words import checks, readers, references

    rooms = (checks.WORDS, readers.WORDS, references.WORDS)
    return {code: words for room in rooms for code, words in room.items()}


def sentence(finding: Finding) -> str:
    """One sentence for a person; it begins with `sensor NAME: ` where it is about one sensor."""
    told = clause(finding)
    return f"sensor {finding.sensor}: {told}" if _of_one(finding) else told


def _of_one(finding: Finding) -> bool:
    """Whether its sentence begins with its sensor; exchanged ones are named together."""
    return finding.sensor is not None and finding.code != "swapped"


def clause(finding: Finding) -> str:
    """The sentence without the sensor's name at its beginning."""
    if "said" in finding.details:
        return str(finding.details["said"]).removeprefix(f"sensor {finding.sensor}: ")
    words = _tables()[finding.code]
    if isinstance(words, str):
        return words.format(**finding.details)
    of_sensor = finding.sensor is not None
    return words(dict(finding.details) | {"code": finding.code, "single": of_sensor})


def summary(findings: Sequence[Finding]) -> str:
    """One line: the findings of the worst severity, sensors with the same code named together."""
    if not findings:
        return "nothing doubtful"
    worst = min(findings, key=lambda f: ORDER[f.severity]).severity
    codes: dict[str, list[Finding]] = {}
    for f in findings:
        if f.severity == worst:
            codes.setdefault(f.code, []).append(f)
    parts = []
    for group in codes.values():
        if len(group) > 1 and _of_one(group[0]):
            names = ", ".join(f.sensor or "" for f in group)
            parts.append(f"sensors {names}: {clause(group[0])}")
        else:
            parts.append(sentence(group[0]))
    return "; ".join(dict.fromkeys(parts))
