"""Virtual sensors on motion, their noise, and motion made by formula."""

from mocap.synthesis.virtual import NOISES, Noise, draw, prepare, raw_recording, recording

__all__ = ["NOISES", "Noise", "draw", "prepare", "raw_recording", "recording"]
