"""Errors of this package."""

from __future__ import annotations

from mocap.errors import PoserError


class CheckpointError(PoserError):
    """Weights or their description do not fit or cannot be read."""


class TrainingError(PoserError):
    """Training cannot go on."""
