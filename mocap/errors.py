"""The exceptions of the project. Each message is one sentence a user can act on."""

from __future__ import annotations

from pathlib import Path


class PoserError(Exception):
    """Base of every error that the project raises on purpose (exit status 1)."""


class ShapeError(PoserError):
    """An array does not have the shape or the numbers that a type demands."""


class SensorError(PoserError):
    """A sensor name, set or placement is unknown or does not fit the data."""


class CalibrationError(PoserError):
    """A calibration cannot be made from what was recorded."""


class SolveError(PoserError):
    """An optimisation cannot be set up, or ended without a usable answer."""


class FormatError(PoserError):
    """A file is not what it claims to be.

    `where` names the line, frame, sensor or field, as far as known.
    """

    def __init__(self, path: str | Path, problem: str, where: str = ""):
        self.path, self.problem, self.where = Path(path), problem, where
        super().__init__(f"{path}: {where + ': ' if where else ''}{problem}")
