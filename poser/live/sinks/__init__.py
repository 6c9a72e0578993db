"""Kinds of sinks of `poser live`, one module each; see `protocol`."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path

from poser.live.sinks.protocol import SinkKind

NAMES: tuple[str, ...] = ("motion_file", "vmc", "vrchat", "lsl", "rerun", "viewer")
"""The kinds, in the order in which they are told."""


def kinds() -> Iterator[SinkKind]:
    """All of them."""
    for name in NAMES:
        found: SinkKind = importlib.import_module(f"poser.live.sinks.{name}").SINK
        yield found


def spellings() -> str:
    """What --sink takes, as a list in words."""
    *all_but_last, last = (k.spelling for k in kinds())
    return f"{', '.join(all_but_last)} or {last}"


def suffixes() -> tuple[str, ...]:
    """Of the files that sinks write."""
    return tuple(s for k in kinds() for s in k.suffixes)


def chosen(text: str) -> tuple[SinkKind, str]:
    """The kind that a word on the command line means, and what stands behind its name.

    Whatever is no kind's name is a file, whose suffix may turn out to be none of `suffixes`.
    """
    name, _, rest = text.partition(":")
    files = [k for k in kinds() if k.suffixes]
    for kind in kinds():
        if not kind.suffixes and kind.name == name:
            return kind, rest
    suffix = Path(text).suffix.lower()
    return next((k for k in files if suffix in k.suffixes), files[0]), text
