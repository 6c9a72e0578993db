"""What of a file can be shown: a body in motion, and the sensors on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Options, native
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.seats import sensor_positions
from mocap.skeleton import Skeleton
from mocap.stances import pose_bones
from mocap.synthesis.staging import on_the_floor
from poser import files


@dataclass(frozen=True, eq=False)
class Sensors:
    """S sensors on a track of T frames: R_world_bone (T,S,3,3), p_world (T,S,3) m, valid (T,S)."""

    names: tuple[str, ...]
    R_world_bone: Array
    p_world: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Track:
    """One file: label, motion, the sensors where it has any, its start on a clock where it states one."""

    label: str
    motion: Motion
    sensors: Sensors | None = None
    start_s: float | None = None

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (len(self.motion) - 1) / self.motion.rate_hz

    def named(self, label: str) -> Track:
        """The same under another name."""
        return replace(self, label=label)

    def frame(self, time_s: float) -> int:
        """The frame so long after the first; the ends hold."""
        return min(len(self.motion) - 1, max(0, round(time_s * self.motion.rate_hz)))


@dataclass(frozen=True)
class Clock:
    """One time for several tracks: those that state theirs are shown by one clock, the others begin with it.

    starts: where each begins. begin, end: of all. first: from where all of them have begun, if they ever all
    last.
    """

    starts: tuple[float, ...]
    begin: float
    end: float
    first: float


def clock(tracks: Sequence[Track]) -> Clock:
    """The clock of some tracks, in s."""
    begin = min((t.start_s for t in tracks if t.start_s is not None), default=0.0)
    starts = tuple(begin if t.start_s is None else t.start_s for t in tracks)
    ends = [a + t.seconds for a, t in zip(starts, tracks, strict=True)]
    latest = max(starts)
    return Clock(starts, begin, max(ends), latest if latest < min(ends) else begin)


def read(path: Path, options: Options | None = None) -> Track:
    """The track of a motion or a calibrated recording. Raises FormatError for a raw recording."""
    content = files.read(path, options).content
    start_s = content.start_s if native.states_start(path) else None
    if isinstance(content, Motion):
        return Track(path.name, content, start_s=start_s)
    if not isinstance(content, Recording):
        raise FormatError(
            path, "holds a raw recording, whose axes are not the body's; poser calibrate it first"
        )
    if content.reference is not None:
        label, motion = f"{path.name} (reference)", content.reference
    else:
        label, motion = f"{path.name} (as measured)", as_measured(content)
    return Track(label, motion, sensors_on(content, motion), start_s)


def as_measured(recording: Recording) -> Motion:
    """A body in the N-pose whose instrumented joints are turned as measured, all others with their parents.

    Not an estimate: it shows what the sensors say. A lost sample keeps the rotation before it, or after
    it at the start.
    """
    body = Skeleton.default()
    T = len(recording)
    R_world = np.tile(np.eye(3), (T, 24, 1, 1))
    ok = recording.ori_valid
    standing = body.local_rotations(pose_bones(np.arange(24), "n"))
    for j, parent in enumerate(body.parents):
        if parent >= 0:
            R_world[:, j] = R_world[:, parent] @ standing[j]
        for s in np.flatnonzero(recording.joint == j)[:1]:
            if ok[:, s].any():
                first = int(np.argmax(ok[:, s]))
                last = np.maximum.accumulate(np.where(ok[:, s], np.arange(T), first))
                R_world[:, j] = recording.R_world_bone[last, s]
    local = body.local_rotations(R_world)
    p = np.tile(body.offsets[0], (T, 1))
    return on_the_floor(Motion(recording.rate_hz, local, p, body))


def sensors_on(recording: Recording, motion: Motion) -> Sensors:
    """The sensors at their seats on the moving body, turned as measured."""
    p = sensor_positions(motion, recording.joint, recording.placement)
    ok = recording.ori_valid
    R = np.where(ok[..., None, None], recording.R_world_bone, np.eye(3))
    return Sensors(recording.sensors, ori.project(R), p, ok)
