"""The protocol of online estimators: two functions over explicit state.

`init() -> state` and `step(state, sample) -> (state, pose)`. Replaying a recording through `step`
equals the batch form of the same estimator; a state can be saved and resumed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array
from mocap.recording import Recording


@dataclass(frozen=True, eq=False)
class Sample:
    """One row of a Recording: time s, R_world_bone (S,3,3), acc_world (S,3) m/s^2, valid (S,)."""

    time_s: float
    R_world_bone: Array
    acc_world: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Pose:
    """One row of a Motion: time s of the frame it describes, R_parent_joint (24,3,3), p_world_root (3,) m.

    std_rad: (24,3) posterior standard deviation of each joint's rotation vector in rad, where known.
    note: why this pose is a fallback; empty when it is not.
    """

    time_s: float
    R_parent_joint: Array
    p_world_root: Array
    std_rad: Array | None = None
    note: str = ""


class Estimator(Protocol):
    """What `learned` and `hybrid` provide and `poser` drives."""

    rate_hz: float
    sensors: tuple[str, ...]
    look_ahead_frames: int

    def init(self) -> Any:
        """A fresh state."""
        ...

    def step(self, state: Any, sample: Sample) -> tuple[Any, Pose | None]:
        """Feed one sample; the pose of `look_ahead_frames` ago, or None before the first."""
        ...


def samples(recording: Recording) -> Iterator[Sample]:
    """The rows of a recording, first to last."""
    for t in range(len(recording)):
        yield Sample(
            recording.start_s + t / recording.rate_hz,
            recording.R_world_bone[t],
            recording.acc_world[t],
            recording.valid[t],
        )
