"""What the pickled data sets share: fields of a dictionary as checked arrays, poses without a path."""

from __future__ import annotations

import mmap
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import FormatError
from mocap.findings import Finding, doubt
from mocap.formats import Options, _unpickle
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import Skeleton

LARGEST_ANGLE = 30.0  # rad: accumulated turns reach some 4 pi, degrees reach 90


def mentions(path: Path, key: bytes) -> bool:
    """Whether the file's bytes hold `key`: enough to tell one data set from another."""
    if not path.stat().st_size:
        return False
    with path.open("rb") as f, mmap.mmap(f.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return data.find(key) >= 0


def fields(path: Path) -> dict[str, Any]:
    """The dictionary a pickle holds, read without running anything in it."""
    data = _unpickle.load(path)
    if not isinstance(data, dict):
        raise FormatError(path, f"holds a {type(data).__name__}, expected a dictionary")
    return {k.decode("latin1") if isinstance(k, bytes) else str(k): v for k, v in data.items()}


def array(path: Path, data: dict[str, Any], name: str) -> Array:
    """One field as a float array; raises FormatError where it is missing or not numbers."""
    if name not in data:
        known = ", ".join(list(data)[:12])
        raise FormatError(path, f"field {name!r} is missing (there is: {known[:200]})")
    return numbers(path, data[name], f"field {name}")


def numbers(path: Path, value: Any, where: str) -> Array:
    """An array of real numbers as float64.

    Lists are refused: a few nested ones that share their parts may stand for a billion numbers.
    """
    if not isinstance(value, np.ndarray):
        raise FormatError(path, f"is a {type(value).__name__}, expected an array", where)
    if value.dtype.kind not in "fiu" or value.ndim == 0:
        raise FormatError(path, f"is {value.dtype} {value.shape}, expected real numbers", where)
    return value.astype(float)


def plain(path: Path, value: Any, name: str) -> np.ndarray:
    """A field as an array of numbers or a single number; raises FormatError for anything else."""
    if isinstance(value, bool | int | float):
        return np.array(value, float)
    if isinstance(value, np.ndarray | np.generic) and np.asarray(value).dtype.kind in "fiub":
        return np.asarray(value)
    raise FormatError(path, f"is a {type(value).__name__}, expected numbers", f"field {name!r}")


def body(options: Options) -> Skeleton:
    """The body that the user told: an SMPL file, a height, or the table's."""
    if options.smpl is not None:
        return Skeleton.from_smpl_file(options.smpl)
    return Skeleton.default(options.height)


def reference(
    path: Path, rate_hz: float, poses: Array, skeleton: Skeleton, start_s: float = 0.0
) -> tuple[Motion | None, list[Finding]]:
    """Motion of SMPL axis-angle (T,72) rad in our world, the pelvis staying at its rest place.

    start_s: time of the first pose, s. None, with a doubt, where some pose is not finite: a reference
    cannot have holes.
    """
    bad = ~np.isfinite(poses).all(axis=1)
    if bad.any():
        return None, [doubt("no-reference", poses=int(bad.sum()), of=len(poses))]
    if np.abs(poses).max() > LARGEST_ANGLE:
        t, j = np.unravel_index(int(np.abs(poses).argmax()), poses.shape)
        raise FormatError(
            path, f"is {poses[t, j]:.1f}, expected radians", f"frame {t}, gt column {j}"
        )
    motion = Motion.from_smpl(rate_hz, poses, np.zeros((len(poses), 3)), skeleton)
    return replace(motion, start_s=start_s), []
