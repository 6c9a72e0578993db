"""What every reader of recordings checks as it parses: rotations, quaternions, time, gaps.

A violation raises FormatError naming file, frame, sensor and field; a doubt is a finding of
`Document.doubts`. What units and axes must fulfil is in `_physics`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.findings import Finding, doubt
from mocap.formats import Document, Options
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording, gaps

Names = tuple[str, ...]
ROTATION_TOLERANCE = 0.02  # text files round to 3 or 4 decimals
QUATERNION_TOLERANCE = 0.05


def quiet(
    read: Callable[[Path, Options], Document],
) -> Callable[[Path, Options], Document]:
    """A reader without numpy's warnings: what overflows or is not finite is for its checks to find."""

    @functools.wraps(read)
    def inner(path: Path, options: Options) -> Document:
        with np.errstate(all="ignore"):
            return read(path, options)

    return inner


def at(sensors: Names, t: int, s: int, what: str) -> str:
    """`frame 12, sensor head: orientation`."""
    return f"frame {t}, sensor {sensors[s]}: {what}"


def rotations(path: Path, R: Array, sensors: Names, what: str) -> Array:
    """R (T,S,3,3) projected onto SO(3), incomplete matrices set to NaN.

    Raises FormatError for a matrix that is left-handed or not orthonormal.
    """
    has = np.isfinite(R).all((-1, -2))
    bad = np.logical_and(has, ~ori.is_rotation(R, ROTATION_TOLERANCE))
    if bad.any():
        t, s = np.argwhere(bad)[0]
        det = float(np.linalg.det(R[t, s]))
        found = "left-handed" if det < -0.5 else "not orthonormal"
        raise FormatError(
            path, f"{found} (determinant {det:.3f}), expected a rotation", at(sensors, t, s, what)
        )
    out = np.full(R.shape, np.nan)
    out[has] = ori.project(R[has])
    return out


def quaternions(
    path: Path, q: Array, sensors: Names, what: str, scalar_first: bool = True
) -> tuple[Array, int]:
    """Rotations (T,S,3,3) of quaternions (T,S,4), and how many were all zero (a sample not measured).

    Raises FormatError for one whose norm is not 1 within `QUATERNION_TOLERANCE`.
    """
    norm = np.linalg.norm(q, axis=-1)
    zero = norm == 0
    bad = np.isfinite(norm) & ~zero & (np.abs(norm - 1) > QUATERNION_TOLERANCE)
    if bad.any():
        t, s = np.argwhere(bad)[0]
        raise FormatError(
            path, f"quaternion of norm {norm[t, s]:.3g}, expected 1", at(sensors, t, s, what)
        )
    return ori.from_quat(q, scalar_first), int(zero.sum())


def gap_report(valid: NDArray[np.bool_], sensors: Names) -> list[Finding]:
    """One warning for all samples that are missing, with counts by sensor."""
    if valid.all():
        return []
    longest = max(g["frames"] for g in gaps(valid))
    return [_missing(~valid, sensors, None, longest)]


def rotation_report(rec: RawRecording | Recording) -> list[Finding]:
    """One warning for the samples that are taken for missing since their orientation is no rotation."""
    counts = rec.no_rotation
    if counts is None or not counts.any():
        return []
    return [doubt("no-rotation", by_sensor=dict(zip(rec.sensors, counts.tolist(), strict=True)))]


def half_report(half: NDArray[np.bool_], sensors: Names, what: str) -> list[Finding]:
    """One warning for the samples (T,S) that lack `what` alone, and are used without it."""
    if not half.any():
        return []
    return [_missing(half, sensors, what)]


def _missing(
    lost: NDArray[np.bool_], sensors: Names, what: str | None, longest: int | None = None
) -> Finding:
    counts = dict(zip(sensors, lost.sum(axis=0).tolist(), strict=True))
    return doubt(
        "missing-samples", what=what, of=lost.size, by_sensor=counts, longest_frames=longest
    )


def rates(R_world_sensor: Array, rate_hz: float) -> Array:
    """Angular rate (T,S,3) rad/s in the sensor's frame: Log(R_{t-1}^T R_t) rate_hz.

    A sample without a predecessor takes the rate towards its successor; without both it is NaN.
    """
    gyr = np.full(R_world_sensor.shape[:-1], np.nan)
    gyr[1:] = ori.log(np.swapaxes(R_world_sensor[:-1], -1, -2) @ R_world_sensor[1:]) * rate_hz
    lone = np.isnan(gyr[:-1, :, 0]) & np.isfinite(R_world_sensor[:-1, :, 0, 0])
    gyr[:-1][lone] = gyr[1:][lone]
    return gyr
