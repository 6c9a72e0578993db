"""The protocol of online estimators: two functions over explicit state.

`init() -> state` and `step(state, sample) -> (state, pose)`. Replaying a recording through `step`
equals the batch form of the same estimator; a state can be saved and resumed.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton


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
    covariance: (72,72) rad^2 of the errors of all joints together, joint by joint, each the vector
    Log(R_estimated^T R_true); where known. It may be the same for many poses (then the same array).
    note: why this pose is a fallback; empty when it is not.
    """

    time_s: float
    R_parent_joint: Array
    p_world_root: Array
    std_rad: Array | None = None
    note: str = ""
    covariance: Array | None = None


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


def tracker_hints(estimator: Estimator) -> Mapping[str, Any]:
    """What a tracker around an estimator should set other than by default: names and values of its settings
    (`hybrid.TrackerSettings`), from the estimator's attribute `tracker_hints`, where it has one.

    Networks differ in how fast their errors change and in what their sensors tell; who trained one
    measured it.
    """
    found: Mapping[str, Any] = getattr(estimator, "tracker_hints", {})
    return found


def facts(estimator: Estimator, state: Any) -> Mapping[str, Any]:
    """What an estimator tells of its run so far beyond its poses: figures by name, from its method
    `facts(state)`, where it has one."""
    tell = getattr(estimator, "facts", None)
    found: Mapping[str, Any] = {} if tell is None else tell(state)
    return found


def told_late(estimator: Estimator, state: Any, late_s: float) -> Any:
    """The estimator's state, told that its next sample is taken so many s too late (0: in time), where it has
    a method `told_late(state, late_s)`: one that can do with less time then does."""
    tell = getattr(estimator, "told_late", None)
    return state if tell is None else tell(state, late_s)


def samples(recording: Recording) -> Iterator[Sample]:
    """The rows of a recording, first to last."""
    for t in range(len(recording)):
        yield Sample(
            recording.start_s + t / recording.rate_hz,
            recording.R_world_bone[t],
            recording.acc_world[t],
            recording.valid[t],
        )


NO_MEASUREMENT = "no sensor measured"  # note of a pose that rests on none


@dataclass(frozen=True, eq=False)
class Replay:
    """A recording run through an estimator.

    motion: as many frames as the recording has, aligned in time whatever the look-ahead. frame_s (N,):
    seconds of the step of each sample that the estimator was shown. std_rad (T,24,3), where every pose has
    it. notes: why poses are fallbacks, counted. covariance (72,72), or (T,72,72) where poses differ, rad^2:
    as in `Pose`, where every pose has it. state: the estimator's after the last sample.
    """

    motion: Motion
    frame_s: Array
    std_rad: Array | None
    notes: Counter[str]
    covariance: Array | None = None
    state: Any = None

    @property
    def fallbacks(self) -> int:
        """Poses that are a fallback."""
        return self.notes.total()


def replay(
    estimator: Estimator,
    recording: Recording,
    progress: Callable[[float], None] | None = None,
    skeleton: Skeleton | None = None,
) -> Replay:
    """Every row of a recording through `estimator`; at the end samples in which nothing is valid follow,
    as many as the look-ahead, so that the last frames get their poses.

    Rows before the first in which any orientation is valid are not shown to it: they tell nothing, and an
    estimator without look-ahead could only answer with a pose of its own making. They get the first pose, as
    a fallback.

    The recording runs at the estimator's rate and holds its sensors (others are left out). skeleton: the
    body of the motion (default: the table's). progress: is told the share that is done. Raises SensorError
    for a sensor that is missing, PoserError where the rates differ or a pose does not come.
    """
    if abs(recording.rate_hz - estimator.rate_hz) > 1e-6 * recording.rate_hz:
        raise PoserError(
            f"the recording runs at {recording.rate_hz:g} Hz, the estimator at {estimator.rate_hz:g} Hz"
        )
    recording = recording.select(estimator.sensors)
    first = int(recording.ori_valid.any(1).argmax())
    shown = recording.slice(first, len(recording))
    T = len(shown)
    poses: list[Pose] = []
    frame_s = []
    state = estimator.init()
    for k, sample in enumerate(_and_then_nothing(shown, estimator.look_ahead_frames)):
        began = time.perf_counter()
        state, pose = estimator.step(state, sample)
        frame_s.append(time.perf_counter() - began)
        if pose is not None:
            poses.append(pose)
        if progress:
            progress(min(1.0, (k + 1) / T))
    if len(poses) != T:
        raise PoserError(f"{len(poses)} poses came of {T} frames")
    poses = [replace(poses[0], note=NO_MEASUREMENT)] * first + poses
    motion = Motion(
        recording.rate_hz,
        np.stack([p.R_parent_joint for p in poses]),
        np.stack([p.p_world_root for p in poses]),
        skeleton or Skeleton.default(),
        recording.start_s,
    )
    std = [p.std_rad for p in poses if p.std_rad is not None]
    return Replay(
        motion,
        np.array(frame_s[:T]),
        np.stack(std) if len(std) == len(poses) else None,
        Counter(p.note for p in poses if p.note),
        _covariance(poses),
        state,
    )


def _covariance(poses: list[Pose]) -> Array | None:
    """That of all poses where it is one array, else theirs one after the other; None where one has none."""
    every = [p.covariance for p in poses if p.covariance is not None]
    if len(every) < len(poses):
        return None
    return every[0] if all(C is every[0] for C in every) else np.stack(every)


def _and_then_nothing(recording: Recording, count: int) -> Iterator[Sample]:
    """The rows, then `count` samples in which nothing is valid."""
    sample = None
    for sample in samples(recording):
        yield sample
    assert sample is not None
    for k in range(count):
        yield Sample(
            sample.time_s + (k + 1) / recording.rate_hz,
            np.full_like(sample.R_world_bone, np.nan),
            np.full_like(sample.acc_world, np.nan),
            np.zeros_like(sample.valid),
        )
