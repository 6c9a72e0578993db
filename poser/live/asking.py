"""How the wearer asks for a reset: a button of the page, or a key and Enter in the terminal."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, runtime_checkable

from poser.console import complain
from poser.live.samples import Network, Source
from poser.live.sinks.protocol import Sink

WORDS: Mapping[str, str] = {
    "pose": "new headings: stand still",
    "walk": "calibrate anew: stand still, then walk",
}
KEYS: Mapping[str, str] = {"r": "pose", "w": "walk"}
Ask = Callable[[str], None]


@runtime_checkable
class Asker(Protocol):
    """A sink on which resets can be asked for, as the viewer."""

    def offer(self, words: Mapping[str, str], ask: Ask) -> None:
        """Offer these, {name: words}; `ask` takes a name, in any thread."""
        ...


def offer(source: Source, sinks: Sequence[Sink]) -> None:
    """Offer what the source can do, wherever one can ask."""
    if not isinstance(source, Network) or not source.resets:
        return
    words = {name: WORDS[name] for name in source.resets}
    for sink in sinks:
        if isinstance(sink, Asker):
            sink.offer(words, source.ask)
    keys = {key: name for key, name in KEYS.items() if name in words}
    if _at_terminal():
        told = "; ".join(f"{key} and Enter: {words[name]}" for key, name in keys.items())
        complain(f"{told} (buttons of the page do the same)", "live")
        threading.Thread(target=_listen, args=(keys, source.ask), daemon=True).start()


def _at_terminal() -> bool:
    """Whether somebody can type: not where the program runs in the background of a terminal."""
    try:
        if sys.stdin is None or not sys.stdin.isatty():
            return False
        if not hasattr(os, "tcgetpgrp"):
            return True
        if os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp():
            return False
    except (OSError, ValueError):
        return False
    # A program that is sent to the background later must not be stopped for its reading.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    return True


def _listen(keys: Mapping[str, str], ask: Ask) -> None:
    """Ask what the lines say, until none comes. Past Python's buffer: its lock would be held at exit."""
    try:
        while line := os.read(sys.stdin.fileno(), 256):
            if name := keys.get(line.decode("utf-8", "replace").strip().lower()):
                ask(name)
    except (OSError, ValueError):
        return
