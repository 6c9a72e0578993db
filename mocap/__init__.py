"""What the optimizer, the networks and the hybrid share: body, motion, recordings, sensors, formats."""

from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.skeleton import Skeleton

__all__ = ["Motion", "PoserError", "RawRecording", "Recording", "Skeleton"]
