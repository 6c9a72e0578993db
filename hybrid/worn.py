"""The sensors that are worn, and the joints that they let move."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap.orientation import Array
from mocap.skeleton import Skeleton

TRUNK = (0, 3, 6, 9)


@dataclass(frozen=True, eq=False)
class Worn:
    """What stays the same from frame to frame.

    skeleton: the body. joint (S,), seat (S,3) m: the bone that each sensor sits on, and where in its frame.
    free (F,): the joints that may move, 0 being the root.
    """

    skeleton: Skeleton
    joint: np.ndarray
    seat: Array
    free: tuple[int, ...]

    @cached_property
    def pelvis(self) -> int | None:
        """The sensor at the pelvis, where one is."""
        found = np.flatnonzero(self.joint == 0)
        return int(found[0]) if len(found) else None

    @cached_property
    def limbs(self) -> np.ndarray:
        """(S,): the sensors that are not at the pelvis."""
        out: np.ndarray = self.joint != 0
        return out


def free_joints(skeleton: Skeleton, joint: np.ndarray, spine: bool) -> tuple[int, ...]:
    """The joints from each sensor's bone up to the trunk; with `spine` on through the trunk.

    The root is among them where no sensor sits on it. A sensor on the trunk frees what is below it.
    """
    free: set[int] = set()
    for j in joint:
        above = skeleton.ancestors(int(j))
        keep = spine or int(j) in TRUNK
        free.update(k for k in above if k and (keep or k not in TRUNK))
    if 0 not in joint:
        free.add(0)
    return tuple(sorted(free))
