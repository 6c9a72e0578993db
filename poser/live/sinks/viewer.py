"""Poses in the browser."""

from __future__ import annotations

from poser.console import UsageError
from poser.live.sinks.protocol import Sink, SinkKind, SinkOrder


def _make(told: SinkOrder) -> Sink:
    from poser.viewer.live import ViewerSink

    if told.text:
        raise UsageError("argument --sink: viewer has no address; --port says where it is served")
    return ViewerSink(told.skeleton, told.port)


SINK = SinkKind("viewer", "viewer", "in the browser", _make)
