"""A motion file, written at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mocap.estimator import Pose
from mocap.motion import Motion
from mocap.skeleton import Skeleton
from poser import files
from poser.live.sinks.protocol import Kind, Sink, Told

SUFFIXES = (".npz", ".bvh")


class MotionFile:
    """Keeps poses and writes them on `close`, aside and then renamed: the file is whole or not there.

    A frame left out (the estimator lagged, the network stalled) is filled with the pose before it, so
    that frame k stays at k / rate_hz; `held` counts these.
    """

    def __init__(self, path: Path, rate_hz: float, skeleton: Skeleton):
        self.name = str(path)
        self._path, self._rate_hz, self._skeleton = path, rate_hz, skeleton
        self._first_s = 0.0
        self._R: list[np.ndarray] = []
        self._p: list[np.ndarray] = []
        self.held = 0

    def write(self, pose: Pose) -> None:
        if not self._R:
            self._first_s = pose.time_s
        k = round((pose.time_s - self._first_s) * self._rate_hz)
        while len(self._R) < k:
            self._R.append(self._R[-1])
            self._p.append(self._p[-1])
            self.held += 1
        # float32 halves the memory of a day; the file's rotations are projected anyway.
        self._R.append(pose.R_parent_joint.astype(np.float32))
        self._p.append(pose.p_world_root.astype(float))

    def close(self) -> dict[str, Any]:
        if self._R:
            R, p = np.array(self._R, float), np.array(self._p)
            files.write(self._path, Motion(self._rate_hz, R, p, self._skeleton))
        return {"frames": len(self._R), "held": self.held}


def _make(told: Told) -> Sink:
    path = Path(told.text)
    files.check_output(path, [], SUFFIXES)
    return MotionFile(path, told.rate_hz, told.skeleton)


SINK = Kind("file", "FILE.npz, FILE.bvh", "a motion file, written at the end", _make, SUFFIXES)
