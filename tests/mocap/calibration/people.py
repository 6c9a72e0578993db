"""Clips of other people for tests of alarms, and what is known of recordings as checks look at it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap.calibration.evidence import Evidence, HeldPose, gather
from mocap.calibration.static_pose import average, find_static
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, prepare, raw_recording
from mocap.synthesis.staging import with_static_pose

FOLDER = Path.home() / ".cache/poser/cmu-daz-bvh"


def clip(name: str, pose: str = "n", seconds: float = 20.0) -> Motion:
    """3 s of the pose and then `seconds` of the clip at 60 Hz; a skip where the file is not there."""
    path = next(FOLDER.rglob(f"{name}.bvh"), None)
    if path is None:
        pytest.skip(f"no {name}.bvh under {FOLDER}, where the data set cmu-daz-bvh is unpacked")
    motion = formats.read(path).content
    assert isinstance(motion, Motion)
    motion = motion.slice(0, min(len(motion), int(seconds * motion.rate_hz)))
    return prepare(with_static_pose(motion.turned(0.6), pose, 3.0), 60.0, 8.0)


def worn(
    motion: Motion, sensors: tuple[str, ...], noise: str = "none", seed: int = 5
) -> RawRecording:
    """What sensors without magnetometers read of a motion."""
    return replace(raw_recording(motion, sensors, NOISES[noise], seed), mag=None)


def posed(
    raw: RawRecording, name: str = "n", at: float = 1.5, facing: float = 0.0, sigma: float = 0.1
) -> Evidence:
    """With the static pose at a time in s, and a facing and its sigma in rad that are the same for all."""
    window, S = find_static(raw, at), len(raw.sensors)
    static = average(raw, window)
    held = HeldPose(window, static, name, 80.0, np.full(S, facing), np.full(S, sigma))
    return replace(gather(raw), held=held)
