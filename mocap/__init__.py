"""What the optimizer, the networks and the hybrid share: body, motion, recordings, sensors, formats."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mocap.errors import PoserError

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import RawRecording, Recording
    from mocap.skeleton import Skeleton

__all__ = ["Motion", "PoserError", "RawRecording", "Recording", "Skeleton"]

_WHERE = {
    "Motion": "motion",
    "RawRecording": "recording",
    "Recording": "recording",
    "Skeleton": "skeleton",
}


def __getattr__(name: str) -> Any:
    """The types, imported when first asked for: `poser --help` needs neither numpy nor scipy."""
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"mocap.{_WHERE[name]}"), name)
