"""What `poser live` says: a line while it runs, tables at the end."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from mocap.calibration import Calibration
from poser.console import complain, say, table
from poser.live import sender_words
from poser.live.loop import Report
from poser.live.samples import MOST_UNKNOWN, Network, Source
from poser.live.sinks.protocol import Sink

STATUS_S = 1.0
RECENT = 300  # poses that the line's latency is of
PATIENCE_S = 5.0  # for sensors that nothing comes from, before a sentence says so
TURNED_DEG = 2.0  # a heading that is taken out and shown
BEHIND_S = (
    0.2  # a loop that is later than this is said to be behind; a slow frame is caught up sooner
)


@runtime_checkable
class StatusListener(Protocol):
    """A sink that shows the line, as the viewer does."""

    def tell(self, text: str) -> None: ...


class Teller:
    """Once a second a line: on stderr where it is a terminal, and to the sinks that listen.

    After PATIENCE_S, once each and terminal or not: which sensors nothing came from, and which devices are
    unknown.
    """

    def __init__(
        self, source: Source, sinks: Sequence[Sink], clock: Callable[[], float] = time.monotonic
    ):
        self._source, self._clock = source, clock
        self._told, self._began = -STATUS_S, clock()
        self._listeners = [s for s in sinks if isinstance(s, StatusListener)]
        self._terminal = sys.stderr is not None and sys.stderr.isatty()
        self._asked_missing = self._asked_unknown = not isinstance(source, Network)
        self._led: str | None = None
        self._checked: Calibration | None = None
        self._trouble = ""
        self._doubled: set[str] = set()
        self._doubts = 0

    def tell(self, report: Report) -> None:
        now = self._clock()
        if now - self._told < STATUS_S:
            return
        self._told = now
        if isinstance(self._source, Network):
            self._lead(self._source)
            self._check(self._source)
            self._double(self._source)
            self._doubt(self._source)
            if now - self._began >= PATIENCE_S:
                self._ask(self._source)
        if not (self._terminal or self._listeners):
            return
        text = status(report, self._source)
        for listener in self._listeners:
            listener.tell(text)
        if self._terminal:
            sys.stderr.write(f"\r{_fitted(text)}\x1b[K")
            sys.stderr.flush()

    def _check(self, source: Network) -> None:
        """Whenever the pose was found: what the calibration rests on, and what is doubtful about it. Where it
        was not found anew, why."""
        if source.trouble != self._trouble:
            self._trouble = source.trouble
            if self._trouble:
                self._complain(f"not reset: {self._trouble}")
        if source.calibration is None or source.calibration is self._checked:
            return
        from mocap import words

        self._checked = found = source.calibration
        self._complain(f"calibrated; where you face: {found.method}")
        for finding in found.diagnostics:
            if finding.severity != "info":
                self._complain(f"{finding.severity}: {words.sentence(finding)}")

    def _double(self, source: Network) -> None:
        """Which names two senders give themselves, each once."""
        for name in source.doubled:
            if name not in self._doubled:
                self._doubled.add(name)
                self._complain(
                    f"a second sender calls itself {name}: the first one is heard, until it falls silent"
                )

    def _doubt(self, source: Network) -> None:
        """What the senders do wrong, each once."""
        for finding in source.doubts[self._doubts :]:
            self._complain(f"{finding.severity}: {sender_words.sentence(finding)}")
        self._doubts = len(source.doubts)

    def _lead(self, source: Network) -> None:
        """Where no line counts the seconds down: a sentence for each thing that the wearer is to do, behind
        the first, which was told at the start."""
        if source.missing or not source.prompt:
            return
        what = re.sub(r"\d+", "", source.prompt)
        if self._led not in (None, what) and not self._terminal:
            self._complain(source.prompt)
        self._led = what

    def _ask(self, source: Network) -> None:
        """Say what the wearer has to see to, once."""
        if not self._asked_missing:
            self._asked_missing = True  # what has come once can only fall silent
            if source.missing:
                self._complain(f"nothing came yet from {', '.join(source.missing)}")
        if not self._asked_unknown and source.unknown:
            self._asked_unknown = True
            self._complain(f"refused: unknown devices ({_names(source.unknown)}); {_hint(source)}")

    def _complain(self, sentence: str) -> None:
        if self._terminal:
            sys.stderr.write("\r\x1b[K")  # the line that is there
        complain(sentence, "live")


def _hint(source: Network) -> str:
    """How an unknown device becomes one of ours."""
    facts = source.facts()
    if "places" in facts:
        return f"with --devices they are named {', '.join(facts['devices'])}"
    return "--map NAME=PLACE says where a device is worn, --sensors which places are used"


def _fitted(text: str) -> str:
    """As much of a line as the terminal is wide: a wrapped one could not be written over."""
    try:
        width = os.get_terminal_size(sys.stderr.fileno()).columns
    except (OSError, ValueError):
        return text
    return text if len(text) < width or width < 4 else text[: width - 4] + "..."


def _names(names: Sequence[str]) -> str:
    """Unknown devices; where as many are named as are kept there may be others."""
    first = "the first of them: " if len(names) == MOST_UNKNOWN else ""
    return first + ", ".join(names)


def status(report: Report, source: Source) -> str:
    """How it goes, in a line."""
    if isinstance(source, Network) and source.waiting:
        return _waiting(source)
    p50, p99 = (report.lag.quantile_ms(q, last=RECENT) for q in (0.5, 0.99))
    words = [f"{report.frames} poses"]
    if p50 is not None and p99 is not None:
        words.append(f"latency {p50:.1f} ms (99 %: {p99:.1f})")
    if report.behind_s > BEHIND_S:
        words.append(f"{report.behind_s:.1f} s behind the source")
    if report.left_out:
        words.append(f"{report.left_out} samples left out")
    if isinstance(source, Network) and (told := source.prompt or source.trouble):
        words.insert(0, told if source.prompt else f"not reset: {told}")
    facts = source.facts()
    if facts.get("rejected"):
        words.append(f"{sum(facts['rejected'].values())} messages refused")
    if facts.get("silent"):
        words.append(f"silent: {', '.join(facts['silent'])}")
    if facts.get("places"):
        words.append(", ".join(f"{d}: {p}" for d, p in facts["places"].items()))
    words += _window(report.estimator)
    lost = sum(d["lost"] for d in facts.get("devices", {}).values())
    return ", ".join(words + ([f"{lost} packets lost"] if lost else []))


def _window(told: Mapping[str, Any]) -> list[str]:
    """What the hybrid's window says of itself: that it is short, and which headings have drifted."""
    words = []
    if told.get("window_frames", 0) < told.get("window_frames_most", 0):
        words.append(f"window of {told['window_frames']} of {told['window_frames_most']} frames")
    turned = {n: d for n, d in told.get("heading_deg", {}).items() if abs(d) >= TURNED_DEG}
    if turned:
        words.append("turned back: " + ", ".join(f"{n} by {d:+.0f} deg" for n, d in turned.items()))
    return words


def _waiting(source: Network) -> str:
    """What the pose still wants: sensors that have come at all, and then what the wearer should do."""
    words = ["waiting for the pose"]
    if source.prompt and not source.missing:
        words[0] += f": {source.prompt}"
    if source.missing:
        words.append(f"nothing yet from {', '.join(source.missing)}")
    if source.unknown:
        words.append(f"unknown devices ({_names(source.unknown)})")
    return "; ".join(words)


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
        named = facts["unknown_devices"] if reason == "device unknown" else []
        say(f"refused: {reason}: {count}" + (f" ({_names(named)})" if named else ""))
    for text, count in report.notes.items():
        say(f"fallback: {text}: {count}")
    for name, done in report.sinks.items():
        say(f"{name}: {_done(done)}")
    for words, latency in (("latency", report.lag), ("per sample", report.step)):
        p50, p99 = latency.quantile_ms(0.5), latency.quantile_ms(0.99)
        if p50 is not None and p99 is not None:
            say(f"{words}: {p50:.1f} ms in the middle, {p99:.1f} ms for 99 of 100")
    if report.most_behind_s > BEHIND_S:
        say(f"fell {report.most_behind_s:.1f} s behind the source, at most")
    if report.left_out:
        say(f"{report.left_out} samples were left out: this machine is too slow for all of them")
    say(f"{report.frames} poses of {report.samples} samples")


def _done(done: Mapping[str, object]) -> str:
    """What a sink did; a motion file that no pose reached is not there."""
    if done.get("frames") == 0:
        return "nothing written"
    return ", ".join(f"{k} {v}" for k, v in done.items())
