"""What the optimizer, the networks and the hybrid share: body, motion, recordings, sensors, formats."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mocap.errors import PoserError
from mocap.lazy_names import lazy

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import RawRecording, Recording
    from mocap.skeleton import Skeleton

__all__ = ["Motion", "PoserError", "RawRecording", "Recording", "Skeleton"]

# `poser --help` needs neither numpy nor scipy.
__getattr__ = lazy(
    __name__,
    {
        "Motion": "motion",
        "RawRecording": "recording",
        "Recording": "recording",
        "Skeleton": "skeleton",
    },
)
