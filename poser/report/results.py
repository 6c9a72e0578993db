"""What several methods made of one or more recordings: the record behind tables, pictures, reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mocap.evaluation.metrics import Metrics, mean_over
from mocap.motion import Motion

SCHEMA = "poser-compare/1"
NAMES = {
    "sop": "SOP", "sip": "SIP", "dip": "DIP", "imuposer": "IMUPoser", "imuposer-adam": "IMUPoser + Adam",
    "hybrid-dip": "hybrid (DIP)", "hybrid-imuposer": "hybrid (IMUPoser)",
    "frame-dip": "single frame (DIP)", "frame-imuposer": "single frame (IMUPoser)", "mean-pose": "mean pose",
    "nearest-pose": "nearest pose",
}  # fmt: skip
COLOURS = {
    "sip": "#1b7837", "sop": "#762a83", "dip": "#2166ac", "imuposer": "#b35806",
    "imuposer-adam": "#e08214", "hybrid-dip": "#053061", "hybrid-imuposer": "#7f3b08",
    "frame-dip": "#67a9cf", "frame-imuposer": "#fdb863",
    "mean-pose": "#bbbbbb", "nearest-pose": "#888888",
}  # fmt: skip
LEFT, RIGHT, MIDDLE = "#1f77b4", "#d95f02", "#444444"
NO_SKILL = ("mean-pose", "nearest-pose")
"""Methods that need no skill: the rows that every table is read against."""


def joint_colour(joint: str) -> str:
    """The colour of a body part by its joint's name: left, right or neither."""
    return LEFT if "left" in joint else RIGHT if "right" in joint else MIDDLE


@dataclass(frozen=True, eq=False)
class MethodResult:
    """One method on one recording. figures: what the method reports of itself (see `poser solve`)."""

    motion: Motion
    metrics: Metrics
    figures: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """All of evaluate and of what the method reports."""
        return {**self.figures, **self.metrics.to_json()}


@dataclass(frozen=True, eq=False)
class Compared:
    """Methods on one recording. reference: where the truth comes from, in words; truth: that motion.

    failed: method -> why it could not be measured.
    """

    name: str
    reference: str
    methods: Mapping[str, MethodResult]
    truth: Motion
    failed: Mapping[str, str] = field(default_factory=dict)

    @property
    def start_s(self) -> float:
        """Time of the first frame on the recording's clock, s.

        The methods' motions have it; a reference from another file may not state it.
        """
        first = next(iter(self.methods.values()), None)
        return self.truth.start_s if first is None else first.motion.start_s

    def to_json(self) -> dict[str, Any]:
        methods = {name: m.to_json() for name, m in self.methods.items()}
        return {
            "name": self.name, "reference": self.reference, "methods": methods,
            "failed": dict(self.failed),
        }  # fmt: skip


@dataclass(frozen=True)
class Lost:
    """A recording of which nothing could be measured. failed: method, or "reference" -> why."""

    name: str
    failed: Mapping[str, str]

    @property
    def sentence(self) -> str:
        return "; ".join(failures([self]))

    def to_json(self) -> dict[str, Any]:
        return {"name": self.name, "reference": None, "methods": {}, "failed": dict(self.failed)}


def failures(recordings: Sequence[Compared | Lost]) -> list[str]:
    """What could not be measured and why, a sentence for each recording and cause."""
    out = []
    for r in recordings:
        causes: dict[str, list[str]] = {}
        for what, why in r.failed.items():
            causes.setdefault(why, []).append(what)
        out += [f"{r.name}, {', '.join(whats)}: {why}" for why, whats in causes.items()]
    return out


def measured(recordings: Sequence[Compared | Lost]) -> list[Compared]:
    """Those of which something could be measured."""
    return [r for r in recordings if isinstance(r, Compared)]


def to_json(recordings: Sequence[Compared | Lost]) -> dict[str, Any]:
    """The content of `results.json`: per recording, and the mean of per-recording means."""
    found = measured(recordings)
    return {
        "schema": SCHEMA,
        "recordings": [r.to_json() for r in recordings],
        "mean": {name: _mean(name, found) for name in _methods(found)},
    }


def _methods(recordings: Sequence[Compared]) -> list[str]:
    """Every method that ran anywhere, in order of appearance."""
    return list(dict.fromkeys(name for r in recordings for name in r.methods))


def _mean(name: str, recordings: Sequence[Compared]) -> dict[str, Any]:
    found = [r.methods[name] for r in recordings if name in r.methods]
    out = {"recordings": len(found)} | mean_over([m.metrics for m in found]).to_json()
    for key in AVERAGED:
        known = [m.figures[key] for m in found if key in m.figures]
        if known:
            out[key] = sum(known) / len(known)
    return out


AVERAGED = (
    "seconds", "iterations", "frame_ms_mean", "frame_ms_p50", "frame_ms_p99", "look_ahead_frames",
    "fallbacks",
)  # fmt: skip
"""What methods report of themselves that has a mean over recordings."""

COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("sip_deg", "SIP deg", 1),
    ("angular_deg", "angular deg", 1),
    ("position_cm", "position cm", 1),
    ("global_deg", "global deg", 1),
    ("instrumented_deg", "instr. deg", 1),
    ("jitter", "jitter 100 m/s^3", 2),
    ("translation_m_per_m", "drift m/m", 2),
    ("left_out_deg", "left out deg", 1),
    ("frame_ms_mean", "ms/frame", 1),
    ("frame_ms_p50", "p50 ms", 1),
    ("frame_ms_p99", "p99 ms", 1),
    ("look_ahead_frames", "latency frames", 0),
)
"""JSON name, heading with its unit, decimals: the columns of a comparison."""


def rows(mean: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Heading and rows of a comparison, one row a method, of the "mean" of `results.json`.

    A column that no method has a figure for is left out. A method that was measured on fewer recordings than
    others says on how many: its mean is over other motion than theirs.
    """
    out = []
    most = max((v.get("recordings", 1) for v in mean.values()), default=1)
    columns = [c for c in COLUMNS if any(v.get(c[0]) is not None for v in mean.values())]
    for name, values in mean.items():
        count = values.get("recordings", most)
        cells = [NAMES.get(name, name) + (f" ({count} of {most})" if count < most else "")]
        for key, _, digits in columns:
            value = values.get(key)
            cells.append("-" if value is None else f"{value:.{digits}f}")
        out.append(cells)
    return ["method", *(heading for _, heading, _ in columns)], out
