"""What the commands say: JSON on stdout, tables on stdout, sentences and progress on stderr."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from mocap.errors import PoserError

DONE, FAILED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130
Progress = Callable[[float, str], None]


class UsageError(PoserError):
    """The arguments contradict each other (exit status 2)."""


def shown(text: str) -> str:
    """`text` with what is not printable escaped: names of others may hold a terminal's commands."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


def complain(sentence: str, name: str = "poser") -> None:
    """One line on stderr."""
    if sys.stderr is None:
        return
    try:
        print(f"{name}: {shown(' '.join(sentence.split()))}", file=sys.stderr, flush=True)
    except OSError:
        return  # stderr is closed: the exit status has to do


_notes: list[str] = []


def note(sentence: str) -> None:
    """A warning or an assumption, told on stderr at the end: an error stands alone there."""
    _notes.append(sentence)


def tell_notes(keep: bool = True) -> None:
    """Print the notes so far, or forget them (`keep` False)."""
    for sentence in dict.fromkeys(_notes if keep else ()):
        complain(sentence, "note")
    _notes.clear()


def milestone(sentence: str, name: str) -> None:
    """A line on stderr while a command runs for long, where no terminal shows a bar."""
    if sys.stderr is not None and not sys.stderr.isatty():
        complain(sentence, name)


def say(text: str = "") -> None:
    """A line for people on stdout."""
    print(shown(text))


def emit(value: Mapping[str, Any]) -> None:
    """The answer for programs: strict JSON on stdout."""
    print(json_text(value))


def json_text(value: Any) -> str:
    """Strict JSON: numpy as plain values, what is not finite as null."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def plain(value: Any) -> Any:
    """`value` in JSON's own types; NaN and infinities become None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return plain(value.tolist())
    return str(value)


@contextmanager
def progress(words: str) -> Iterator[Progress]:
    """A bar on stderr while the block runs, gone afterwards; silent where stderr is no terminal.

    Yields `tell(fraction, words)`. A fraction below an earlier one does not move the bar back.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), "{task.percentage:>3.0f}%")
    with Bar(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(words, total=1.0)
        reached = 0.0

        def tell(fraction: float, text: str) -> None:
            nonlocal reached
            reached = max(reached, min(1.0, float(fraction)))
            bar.update(task, completed=reached, description=shown(text).replace("[", "\\["))

        yield tell


def part(tell: Progress, start: float, stop: float, words: str = "") -> Progress:
    """Progress of a part as progress of the whole."""

    def report(fraction: float, text: str) -> None:
        tell(start + (stop - start) * fraction, f"{words}: {text}" if words else text)

    return report


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A plain table on stdout: the first column left, the others right."""
    widths = [max(len(str(r[i])) for r in (header, *rows)) for i in range(len(header))]
    for row in (header, ["-" * w for w in widths], *rows):
        cells = [
            str(c).ljust(w) if i == 0 else str(c).rjust(w)
            for i, (c, w) in enumerate(zip(row, widths, strict=True))
        ]
        print(shown("  ".join(cells).rstrip()))
