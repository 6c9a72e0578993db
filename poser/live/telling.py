"""What `poser live` says: a line while it runs, tables at the end."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from poser.console import say, table
from poser.live.loop import Report
from poser.live.sinks import Sink
from poser.live.sources import Source

STATUS_S = 1.0
RECENT = 300  # poses that the line's latency is of
BEHIND_S = 0.2  # a loop that is later than this has fallen behind; a slow frame is caught up sooner


@runtime_checkable
class Listener(Protocol):
    """A sink that shows the line, as the viewer does."""

    def tell(self, text: str) -> None: ...


class Teller:
    """Once a second a line: on stderr where it is a terminal, and to the sinks that listen."""

    def __init__(self, source: Source, sinks: Sequence[Sink]):
        self._source, self._told = source, 0.0
        self._listeners = [s for s in sinks if isinstance(s, Listener)]
        self._terminal = sys.stderr is not None and sys.stderr.isatty()

    def tell(self, report: Report) -> None:
        now = time.monotonic()
        if now - self._told < STATUS_S or not (self._terminal or self._listeners):
            return
        self._told = now
        text = status(report, self._source)
        for listener in self._listeners:
            listener.tell(text)
        if self._terminal:
            sys.stderr.write(f"\r{text}\x1b[K")
            sys.stderr.flush()


def status(report: Report, source: Source) -> str:
    """How it goes, in a line."""
    if getattr(source, "waiting", False):
        return "waiting for the pose"
    p50, p99 = (report.lag.quantile_ms(q, last=RECENT) for q in (0.5, 0.99))
    words = [f"{report.frames} poses"]
    if p50 is not None and p99 is not None:
        words.append(f"latency {p50:.1f} ms (99 %: {p99:.1f})")
    if report.behind_s > BEHIND_S:
        words.append(f"{report.behind_s:.1f} s behind the source")
    facts = source.facts()
    if facts.get("rejected"):
        words.append(f"{sum(facts['rejected'].values())} messages refused")
    if facts.get("silent"):
        words.append(f"silent: {', '.join(facts['silent'])}")
    if facts.get("places"):
        words.append(", ".join(f"{d}: {p}" for d, p in facts["places"].items()))
    lost = sum(d["lost"] for d in facts.get("devices", {}).values())
    return ", ".join(words + ([f"{lost} packets lost"] if lost else []))


def summary(report: Report) -> None:
    """The answer for people."""
    if sys.stderr is not None and sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    facts = report.to_dict()
    devices = facts.get("devices", {})
    if devices:
        columns = list(next(iter(devices.values())))
        table(
            ("device", *(c.replace("_", " ") for c in columns)),
            [(name, *(str(d[c]) for c in columns)) for name, d in devices.items()],
        )
    for reason, count in facts.get("rejected", {}).items():
        say(f"refused: {reason}: {count}")
    for text, count in report.notes.items():
        say(f"fallback: {text}: {count}")
    for name, done in report.sinks.items():
        say(f"{name}: " + ", ".join(f"{k} {v}" for k, v in done.items()))
    for words, latency in (("latency", report.lag), ("per sample", report.step)):
        p50, p99 = latency.quantile_ms(0.5), latency.quantile_ms(0.99)
        if p50 is not None and p99 is not None:
            say(f"{words}: {p50:.1f} ms in the middle, {p99:.1f} ms for 99 of 100")
    if report.most_behind_s > BEHIND_S:
        say(f"fell {report.most_behind_s:.1f} s behind the source, at most")
    say(f"{report.frames} poses of {report.samples} samples")
