"""The gate: what a plausible sample is. Every online path asks here, and nowhere else.

An orientation counts when its sensor says it is valid, its nine entries are finite and it is a
right-handed rotation within `ROTATION_TOLERANCE`. An acceleration (gravity removed) counts when its
sensor says it is valid and its three entries are finite and at most `MAX_ACC`. What does not count is
missing, never a value: the networks hold the last one for a while (`learned.online`), the tracker does
without (`hybrid`), and live receivers refuse the packet that carried it (`poser.live.packets`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.orientation import Array

MAX_ACC = 400.0
"""m/s^2 per axis: the ranges of body-worn sensors end at 16 to 40 g, and no limb is quicker."""
ROTATION_TOLERANCE = 1e-3
"""Of R^T R - I, entry by entry: what single precision and rounded quaternions leave is far below."""
_ROUNDING = 1e-9
_EYE = np.eye(3)


class Verdict(NamedTuple):
    """turned, moved (S,): the sensors whose orientation and whose acceleration count.

    exact: the orientations that count are rotations but for rounding, so that none needs to be projected.
    """

    turned: NDArray[np.bool_]
    moved: NDArray[np.bool_]
    exact: bool


def judge(R_world_bone: Array, acc_world: Array, valid: NDArray[np.bool_]) -> Verdict:
    """A sample's R_world_bone (S,3,3), acc_world (S,3) m/s^2 and valid (S,)."""
    turned, exact = _rotations(R_world_bone)
    moved = np.asarray((np.abs(acc_world) <= MAX_ACC).all(-1))
    return Verdict(valid & turned, valid & moved, exact)


def is_rotation(R: Array) -> NDArray[np.bool_]:
    """(S,) of matrices (S,3,3), whatever is in them."""
    return _rotations(R)[0]


def exact(R: Array) -> bool:
    """Whether all matrices (S,3,3), whose entries are finite and not huge, are rotations but for rounding."""
    off = np.abs(R.mT @ R - _EYE).max(initial=0.0)
    return bool(off <= _ROUNDING and (np.linalg.det(R) > 0).all())


def _rotations(R: Array) -> tuple[NDArray[np.bool_], bool]:
    # Past 2 no entry belongs to a rotation; left out first, huge numbers cannot overflow in the check.
    found = np.asarray((np.abs(R) < 2).all((-1, -2)))
    if exact(R[found]):
        return found, True
    found[found] = ori.is_rotation(R[found], ROTATION_TOLERANCE)
    return found, False
