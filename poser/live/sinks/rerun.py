"""A recording for the Rerun viewer (`FILE.rrd`), by the library rerun-sdk (extra `rerun`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import PoserError
from mocap.estimator import Pose
from mocap.formats._files import write_aside
from mocap.skeleton import JOINTS, PARENTS, Skeleton
from poser import files
from poser.live.sinks.protocol import Sink, SinkKind, SinkOrder

SUFFIXES = (".rrd",)


def library() -> Any:
    """The package `rerun`; raises PoserError where it is not installed."""
    try:
        import rerun
    except ImportError as e:
        raise PoserError(
            "Rerun needs the package 'rerun-sdk': pip install 'poser-imu[rerun]'"
        ) from e
    return rerun


class RerunFile:
    """Joints and bones of every pose on the time line `time`; the file appears on `close`, whole."""

    def __init__(self, path: Path, skeleton: Skeleton, rerun: Any):
        self.name, self._path = str(path), path
        self._skeleton, self._rr = skeleton, rerun
        self._stream = rerun.RecordingStream("poser")
        # Kept in memory and drained at the end: the library would leave half a file behind a crash.
        self._memory = self._stream.memory_recording()
        self._stream.log("body", rerun.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        self._bones = [(p, j) for j, p in enumerate(PARENTS) if p >= 0]
        self.frames = 0

    def write(self, pose: Pose) -> None:
        _, p = self._skeleton.forward(pose.R_parent_joint, pose.p_world_root)
        p = p.astype(np.float32)
        rr = self._rr
        self._stream.set_time("time", duration=pose.time_s)
        self._stream.log("body/joints", rr.Points3D(p, labels=list(JOINTS), show_labels=False))
        self._stream.log("body/bones", rr.LineStrips3D([p[list(pair)] for pair in self._bones]))
        self.frames += 1

    def close(self) -> dict[str, Any]:
        content = self._memory.drain_as_bytes()
        if self.frames:
            with write_aside(self._path) as aside:
                aside.write_bytes(content)
        self._stream.disconnect()
        return {"frames": self.frames}


def _make(told: SinkOrder) -> Sink:
    path = Path(told.text)
    files.check_output(path, [], SUFFIXES)
    return RerunFile(path, told.skeleton, library())


SINK = SinkKind("rerun", "FILE.rrd", "a recording for the Rerun viewer", _make, SUFFIXES)
