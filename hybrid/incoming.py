"""Samples (by `mocap.gate`) and the network's poses are checked once here; later code may trust them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap import gate
from mocap import orientation as ori
from mocap.estimator import Pose, Sample
from mocap.orientation import Array


def clean(sample: Any, sensors: int, expected_s: float) -> tuple[Sample, dict[str, int]]:
    """The sample with what cannot be used marked invalid, and counts of what was marked.

    Orientations and accelerations that do not pass `mocap.gate` become NaN; orientations that do are
    projected onto the rotations. A sensor with neither is not valid. A time that is not finite becomes
    expected_s. A sample of another shape counts as one in which nothing was measured.
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
    turned, moved, exact = gate.judge(R, acc, said)
    if not turned.all():
        broken = int((said & ~turned & np.isfinite(R).all((-1, -2))).sum())
        if broken:
            events["not a rotation"] = broken
    if not exact:
        R[turned] = ori.project(R[turned])
    valid_now = turned | moved
    if not valid_now.all():
        events["sensor lost"] = int((~valid_now).sum())
    R[~turned] = np.nan
    acc[~moved] = np.nan
    return Sample(time_s, R, acc, valid_now), events


def proposal(pose: Any) -> Pose | None:
    """The network's pose with rotations made orthonormal, or None where it cannot be used."""
    time_s = _number(getattr(pose, "time_s", None))
    R = _array(getattr(pose, "R_parent_joint", None), (24, 3, 3))
    p = _array(getattr(pose, "p_world_root", None), (3,))
    if time_s is None or R is None or not (np.abs(R) < 10).all():
        return None
    if not gate.exact(R):
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
