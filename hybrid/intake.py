"""What comes in is checked once here: samples and proposals that later code may trust."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.estimator import Pose, Sample
from mocap.orientation import Array

_EYE = np.eye(3)
LARGEST_ACC = 400.0  # m/s^2; the range of body-worn sensors ends at 16 to 40 g


def clean(sample: Any, sensors: int, expected_s: float) -> tuple[Sample, dict[str, int]]:
    """The sample with what cannot be used marked invalid, and counts of what was marked.

    Rotations that are not orthonormal and right-handed within 1e-3: NaN; the others are projected.
    Accelerations that are not finite or past LARGEST_ACC: NaN. A sensor with neither is not valid. A
    time that is not finite becomes expected_s. A sample of another shape counts as one in which
    nothing was measured.
    """
    events: dict[str, int] = {}
    time_s = _number(getattr(sample, "time_s", None))
    if time_s is None:
        events["clock not finite"] = 1
        time_s = expected_s
    R = _array(getattr(sample, "R_world_bone", None), (sensors, 3, 3))
    acc = _array(getattr(sample, "acc_world", None), (sensors, 3))
    valid = _array(getattr(sample, "valid", None), (sensors,))
    if R is None or acc is None or valid is None:
        events["sample malformed"] = 1
        R, acc = np.full((sensors, 3, 3), np.nan), np.full((sensors, 3), np.nan)
        valid = np.zeros(sensors)
    said = valid > 0
    # Past 2 no entry belongs to a rotation; clipped first, huge numbers cannot overflow in the check.
    turns = np.asarray((np.abs(R) < 2).all((-1, -2)))
    if not _exact(R[turns]):
        turns[turns] = ori.is_rotation(R[turns])
        R[turns] = ori.project(R[turns])
    if not turns.all():
        broken = int((said & ~turns & np.isfinite(R).all((-1, -2))).sum())
        if broken:
            events["not a rotation"] = broken
    moves = (np.abs(acc) <= LARGEST_ACC).all(-1)
    valid_now = said & (turns | moves)
    if not valid_now.all():
        events["sensor lost"] = int((~valid_now).sum())
    R[~(valid_now & turns)] = np.nan
    acc[~(valid_now & moves)] = np.nan
    return Sample(time_s, R, acc, valid_now), events


def proposal(pose: Any) -> Pose | None:
    """The network's pose with rotations made orthonormal, or None where it cannot be used."""
    time_s = _number(getattr(pose, "time_s", None))
    R = _array(getattr(pose, "R_parent_joint", None), (24, 3, 3))
    p = _array(getattr(pose, "p_world_root", None), (3,))
    if time_s is None or R is None or not (np.abs(R) < 10).all():
        return None
    if not _exact(R):
        # A matrix that is far from any rotation has no nearest one worth the name.
        if not (np.linalg.det(R) > 0.1).all():
            return None
        R = ori.project(R)
    if p is None or not np.isfinite(p).all():
        p = np.zeros(3)
    std = _array(getattr(pose, "std_rad", None), (24, 3))
    return Pose(time_s, R, p, std, str(getattr(pose, "note", "")), _covariance(pose))


def sample_at(samples: Sequence[Sample], time_s: float, tolerance_s: float) -> Sample | None:
    """The newest of the samples whose time is nearest to time_s, within tolerance_s; else None."""
    best = None
    for sample in reversed(samples):
        off = abs(sample.time_s - time_s)
        if off <= tolerance_s and (best is None or off < abs(best.time_s - time_s)):
            best = sample
    return best


def _exact(R: Array) -> bool:
    """Whether all matrices (N,3,3) of bounded entries are rotations but for rounding."""
    off = np.abs(R.mT @ R - _EYE).max(initial=0.0)
    return bool(off <= 1e-9 and (np.linalg.det(R) > 0).all())


def _covariance(pose: Any) -> Array | None:
    """The stated covariance itself (its identity tells that it has not changed), or None where it is none."""
    C = getattr(pose, "covariance", None)
    if not isinstance(C, np.ndarray) or C.shape != (72, 72) or C.dtype != np.float64:
        return None
    return C if np.isfinite(C).all() else None


def _number(x: Any) -> float | None:
    """x as a finite float, or None."""
    try:
        value = float(x)
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def _array(x: Any, shape: tuple[int, ...]) -> Array | None:
    """x as a float array of that shape, or None."""
    try:
        out = np.array(x, float)
    except (TypeError, ValueError, RuntimeError):
        return None
    return out if out.shape == shape else None
