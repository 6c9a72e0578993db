"""Kinds of devices that `poser live` takes, one module each; see `protocol`."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

from poser.live.sources.protocol import Kind

NAMES: tuple[str, ...] = (
    "slimevr", "sensorlogger", "phyphox", "text", "mvn", "dot", "udp", "osc", "demo",
)  # fmt: skip
"""The kinds, in the order in which they are told."""


def kind(name: str) -> Kind:
    """The kind of this name, which is one of NAMES."""
    found: Kind = importlib.import_module(f"poser.live.sources.{name}").SOURCE
    return found


def kinds() -> Iterator[Kind]:
    """All of them."""
    return map(kind, NAMES)
