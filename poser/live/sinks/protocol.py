"""What takes poses. A new kind is one module in this folder with `SINK = SinkKind(...)`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from mocap.estimator import Pose
from mocap.skeleton import Skeleton


class Sink(Protocol):
    """name: as the user wrote it. `write` must not raise for what may pass; `close` tells what was done."""

    name: str

    def write(self, pose: Pose) -> None: ...

    def close(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class SinkOrder:
    """What a sink is made from: text is what stands behind the kind's name, or the path of a file.

    rate_hz: of the poses. port: where a viewer is served.
    """

    text: str
    rate_hz: float
    skeleton: Skeleton
    port: int


@dataclass(frozen=True)
class SinkKind:
    """A kind of sink. spelling: as it is written; words: what it is, in a line; suffixes: of a kind that
    writes files, which is chosen by them and has no name on the command line."""

    name: str
    spelling: str
    words: str
    make: Callable[[SinkOrder], Sink]
    suffixes: tuple[str, ...] = ()
