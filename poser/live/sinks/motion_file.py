"""A motion file, written down as it goes and made whole at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mocap.estimator import Pose
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, Skeleton
from poser import files
from poser.exports import SUFFIXES
from poser.live.sinks.protocol import Sink, SinkKind, SinkOrder
from poser.live.spool import Spool


class MotionFile:
    """Writes poses down (`poser.live.spool`) and makes the file of them on `close`: it is whole or not there.

    A frame left out (the estimator lagged, the network stalled) is filled with the pose before it, so
    that frame k stays at k / rate_hz; `held` counts these. `lost`: for want of room, where any.
    """

    def __init__(self, path: Path, rate_hz: float, skeleton: Skeleton):
        self.name = str(path)
        self._rate_hz, self._first_s = rate_hz, 0.0
        self._last: np.ndarray | None = None
        self._taken = self.held = 0
        head = {"rate_hz": rate_hz, "offsets": skeleton.offsets.tolist()}
        self._spool = Spool(path, 9 * len(JOINTS) + 3, head, _write)

    def write(self, pose: Pose) -> None:
        if self._last is None:
            self._first_s = pose.time_s
        k = round((pose.time_s - self._first_s) * self._rate_hz)
        while self._last is not None and self._taken < k:
            self._take(self._last)
            self.held += 1
        self._last = np.concatenate([pose.R_parent_joint.ravel(), pose.p_world_root])
        self._take(self._last)

    def _take(self, row: np.ndarray) -> None:
        # Single precision: a day takes 4.5 GB, and the file's rotations are projected anyway.
        self._spool.append(row)
        self._taken += 1

    def close(self) -> dict[str, Any]:
        self._spool.finish()
        lost = {"lost": self._spool.lost} if self._spool.lost else {}
        return {"frames": self._spool.count, "held": self.held} | lost


def _write(path: Path, head: Mapping[str, Any], rows: Array) -> None:
    skeleton = Skeleton(JOINTS, PARENTS, np.array(head["offsets"]))
    R = rows[:, :-3].astype(float).reshape(len(rows), len(JOINTS), 3, 3)
    files.write(path, Motion(head["rate_hz"], R, rows[:, -3:].astype(float), skeleton))


def _make(told: SinkOrder) -> Sink:
    path = Path(told.text)
    files.check_output(path, [], SUFFIXES)
    return MotionFile(path, told.rate_hz, told.skeleton)


_SPELLING = ", ".join(f"FILE{suffix}" for suffix in SUFFIXES)
SINK = SinkKind("file", _SPELLING, "a motion file, written at the end", _make, SUFFIXES)
