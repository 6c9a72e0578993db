"""Clips of other people for tests of alarms, from the cache of BVH files where they lie there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mocap import formats
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, prepare, raw_recording
from mocap.synthesis.staging import with_static_pose

FOLDER = Path.home() / ".cache/poser/cmu-daz-bvh"


def clip(name: str, pose: str = "n", seconds: float = 20.0) -> Motion:
    """3 s of the pose and then `seconds` of the clip at 60 Hz; a skip where the file is not there."""
    path = FOLDER / f"{name}.bvh"
    if not path.is_file():
        pytest.skip(f"{path} is not there: poser train dip fetches the clips")
    motion = formats.read(path).content
    assert isinstance(motion, Motion)
    motion = motion.slice(0, min(len(motion), int(seconds * motion.rate_hz)))
    return prepare(with_static_pose(motion.turned(0.6), pose, 3.0), 60.0, 8.0)


def worn(
    motion: Motion, sensors: tuple[str, ...], noise: str = "none", seed: int = 5
) -> RawRecording:
    """What sensors without magnetometers read of a motion."""
    return replace(raw_recording(motion, sensors, NOISES[noise], seed), mag=None)
