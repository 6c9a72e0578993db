"""Faults of captured motion: limbs that flip by half a turn, found, turned back where that is certain.

Optical systems solve each frame for itself. Where markers are hidden a limb of two bones has a second
solution, the knee or elbow on the other side of the line from hip to ankle or shoulder to wrist, and a foot,
a forearm or a hand one that is rolled by half a turn about its length. Between two flips the limb is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, Skeleton

_INDEX = {name: j for j, name in enumerate(JOINTS)}
JUMP_DEG_S = 60.0 * 120.0
"""A joint that turns faster than this from one frame to the next has jumped."""
JUMP_DEG = (60.0, 150.0)  # the least that counts at high rates, the most that is asked at low ones
CERTAIN_DEG = (
    30.0  # a flip is undone where less than this is left of the jump (120 Hz; scales as the jump)
)
# A bone that is twisted about its length by more is the more likely wrong, the longer it is: a quarter of a
# second at 45 deg more weighs as much as a jump by half a turn. Of two solutions one is beyond 90 deg.
TWIST_DEG = 90.0
TWIST_WEIGHT = 16.0  # 1/s
BRIDGED_S = (
    0.25  # a wrist or an ankle that leaves for less than this and comes back is taken across
)
BETWEEN_S = 1.0  # two jumps of one joint with less between them: it is wrong in between
END_S = 0.5  # a jump so near to an end of a clip: the frames up to the end are wrong
AROUND_S = 0.05  # beside a jump nothing is trusted either
# What no body turns a joint by, in deg from the T-pose (a wrist's angle holds the forearm's twist).
BEYOND_DEG = {
    "neck": 110.0, "head": 110.0, "left_ankle": 110.0, "right_ankle": 110.0,
    "left_wrist": 130.0, "right_wrist": 130.0,
}  # fmt: skip
_LIMBS = ((1, 4, 7), (2, 5, 8), (16, 18, 20), (17, 19, 21))
_ROLLING = (
    18,
    19,
    7,
    8,
    20,
    21,
    15,
)  # single bones that roll about their length; the head rolls about z
_BRIDGED = (7, 8, 20, 21)
# Toes and hands end the body: nobody looks at their jumps, and they roll with what they end.
_ENDS = (10, 11, 22, 23)

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Mended:
    """A motion whose flips are turned back where that is certain, and are marked elsewhere (its `trusted`).

    mended (T,): frames in which a limb was turned back or a joint taken across. Where a frame is not trusted
    for a jump, the joint is taken across too, so that sensors put on it measure no blow.
    """

    motion: Motion
    mended: Mask

    @property
    def trusted(self) -> Mask:
        """(T,): frames in which nothing is wrong, or is no longer."""
        assert self.motion.trusted is not None
        return self.motion.trusted

    def mended_at(self, other: Motion) -> Mask:
        """(T,): `mended` at the frames of the same motion at another rate."""
        at = np.arange(len(other)) / other.rate_hz
        own = np.arange(len(self.mended)) / self.motion.rate_hz
        return np.asarray(np.interp(at, own, self.mended.astype(float)) > 1e-6)


def jump_limit_deg(rate_hz: float) -> float:
    """What a joint turns by at most from one frame to the next, in deg: `JUMP_DEG_S` / rate, within
    `JUMP_DEG`."""
    return float(np.clip(JUMP_DEG_S / rate_hz, *JUMP_DEG))


def mend(motion: Motion) -> Mended:
    """Find flips and turn them back; to be called at the rate of capture, before any low-pass.

    A limb of two bones is turned by half a turn about the line from its first joint to its last, which stays
    where it is; a forearm, foot or hand about its own length, a head about the way it faces. Of both
    solutions that path through the frames is taken that turns the least from frame to frame and twists the
    bone the least beyond `TWIST_DEG`. Of wrists and ankles that are away for less than `BRIDGED_S` the
    rotation is interpolated. Frames are not trusted beside a jump that is left, between two of one joint less
    than `BETWEEN_S` apart, from one to an end of the clip that is less than `END_S` away, where a joint is
    turned beyond `BEYOND_DEG`, and between two such frames less than `BETWEEN_S` apart.
    """
    work = _Work(motion)
    for limb in _LIMBS:
        work.choose(limb[0], lambda R, limb=limb: _other_side(motion, R, limb))  # type: ignore[misc]
    for joint in _ROLLING:
        work.choose(joint, lambda R, joint=joint: _rolled(motion, R, joint))  # type: ignore[misc]
    for joint in _BRIDGED:
        work.bridge(joint)
    wrong = np.zeros(len(motion), bool)
    for joint in sorted(set(range(24)) - set(_ENDS)):
        wrong |= work.across(joint) | _closed(_beyond(work.R, (joint,)), motion.rate_hz)
    return Mended(replace(motion, R_parent_joint=work.R, trusted=~wrong), work.mended)


class _Work:
    """Local rotations as they are mended, and what is known of their frames."""

    def __init__(self, motion: Motion) -> None:
        self.R = np.array(motion.R_parent_joint)
        self.rate_hz, self.skeleton = motion.rate_hz, motion.skeleton
        self.limit = np.deg2rad(jump_limit_deg(motion.rate_hz))
        self.certain = self.limit * CERTAIN_DEG / JUMP_DEG[0]
        self.mended = np.zeros(len(motion), bool)
        self.seams: dict[int, set[int]] = {}

    def jumps(self, joint: int) -> list[int]:
        """Frames that a joint has jumped to: beyond the limit, or where a limb was turned not smoothly."""
        step = ori.angle_between(self.R[1:, joint], self.R[:-1, joint])
        far = set(np.flatnonzero(step > self.limit) + 1)
        seams = {t for t in self.seams.get(joint, ()) if step[t - 1] > self.certain}
        return sorted(int(t) for t in far | seams)

    def choose(self, joint: int, turn: Callable[[Array], dict[int, Array]]) -> None:
        """Take at each frame the joint as it is, or turned."""
        if not self.jumps(joint) and not _beyond(self.R, (joint,)).any():
            return
        other = turn(self.R)
        both = np.stack([self.R[:, joint], other[joint]])
        twist = np.abs(_twist(both, _along(self.skeleton, joint)))
        excess = np.maximum(twist - np.deg2rad(TWIST_DEG), 0.0) * TWIST_WEIGHT / self.rate_hz
        take = cheapest(both[0], both[1], excess)
        for j, R in other.items():
            self.R[take, j] = R[take]
            self.seams.setdefault(j, set()).update(np.flatnonzero(take[1:] != take[:-1]) + 1)
        self.mended |= take

    def bridge(self, joint: int) -> None:
        """Interpolate between two jumps near each other, where the joint comes back to where it was."""
        cuts = self.jumps(joint)
        k = 0
        while k < len(cuts) - 1:
            near = [
                i for i in range(k + 1, len(cuts)) if cuts[i] - cuts[k] <= BRIDGED_S * self.rate_hz
            ]
            back = [i for i in near if self._returns(joint, cuts[k], cuts[i])]
            if not back:
                k += 1
                continue
            first, behind = cuts[k] - 1, cuts[back[-1]]
            ends = self.R[[first, behind]]
            at = np.arange(first + 1, behind, dtype=float)
            for j in (joint, PARENTS.index(joint)):
                self.R[first + 1 : behind, j] = ori.interpolate(
                    np.array([first, behind], float), ends[:, j, None], at
                )[:, 0]
            self.mended[first + 1 : behind] = True
            k = back[-1] + 1

    def across(self, joint: int) -> Mask:
        """(T,): frames that are wrong for the jumps of a joint, which is interpolated there."""
        T = len(self.R)
        wrong = _beside(self.jumps(joint), T, self.rate_hz)
        if wrong.any() and not wrong.all():
            at = np.arange(T, dtype=float)
            self.R[wrong, joint] = ori.interpolate(at[~wrong], self.R[~wrong, joint], at[wrong])
        return wrong

    def _returns(self, joint: int, start: int, behind: int) -> bool:
        turn = float(ori.angle_between(self.R[start - 1, joint], self.R[behind, joint]))
        return turn < np.deg2rad(JUMP_DEG[0])


def cheapest(a: Array, b: Array, cost: Array) -> Mask:
    """(T,): where b is taken, of two solutions (T,3,3) for a joint: the path with the least sum of the turns
    in rad from frame to frame and of a cost (2,T) of each solution at each frame (Viterbi); of equal ones a.
    """
    both = np.stack([a, b], axis=1)
    step = ori.angle_between(both[:-1, :, None], both[1:, None, :])  # (T-1, from, to)
    own = cost.T + np.array([0.0, 1e-6])
    total, came = own[0], np.zeros((len(a), 2), int)
    for t in range(1, len(a)):
        by = total[:, None] + step[t - 1]
        came[t] = by.argmin(axis=0)
        total = by.min(axis=0) + own[t]
    path = np.empty(len(a), int)
    path[-1] = total.argmin()
    for t in range(len(a) - 1, 0, -1):
        path[t - 1] = came[t, path[t]]
    return path.astype(bool)


def _other_side(motion: Motion, R: Array, limb: tuple[int, int, int]) -> dict[int, Array]:
    """Local rotations (T,3,3) of a limb whose middle joint is on the other side; the last keeps its global
    rotation."""
    first, middle, last = limb
    G, p = motion.skeleton.forward(R, np.zeros((len(R), 3)))
    line = p[:, last] - p[:, first]
    P = ori.exp(np.pi * line / np.linalg.norm(line, axis=-1, keepdims=True))
    above = np.swapaxes(G[:, PARENTS[first]], -1, -2)
    return {
        first: above @ P @ G[:, first],
        last: np.swapaxes(P @ G[:, middle], -1, -2) @ G[:, last],
    }


def _rolled(motion: Motion, R: Array, joint: int) -> dict[int, Array]:
    """Local rotations of a bone rolled by half a turn about its length; what follows keeps its global
    rotation, or rolls with it where it ends the body."""
    Q = ori.exp(np.pi * _along(motion.skeleton, joint))
    rolled = {joint: R[:, joint] @ Q}
    for child in (j for j, parent in enumerate(PARENTS) if parent == joint):
        rolled[child] = Q.T @ R[:, child] @ (Q if child in _ENDS else np.eye(3))
    return rolled


def _along(skeleton: Skeleton, joint: int) -> Array:
    """Unit vector (3,) from a joint to the next in its own frame; the head faces along z."""
    if joint not in PARENTS:
        return np.array([0.0, 0.0, 1.0])
    offset = np.asarray(skeleton.offsets[PARENTS.index(joint)], float)
    return np.asarray(offset / np.linalg.norm(offset))


def _twist(R: Array, axis: Array) -> Array:
    """Twist (...) in rad, in [-pi, pi), of rotations about an axis: R = swing twist."""
    q = ori.to_quat(R)
    return (2 * np.arctan2(q[..., 1:] @ axis, q[..., 0]) + np.pi) % (2 * np.pi) - np.pi


def _beside(cuts: list[int], frames: int, rate_hz: float) -> Mask:
    """(T,): frames beside jumps, between two near each other, and up to an end near one."""
    out = np.zeros(frames, bool)
    around = max(1, round(AROUND_S * rate_hz))
    for t in cuts:
        out[max(0, t - around) : t + around] = True
        if t < END_S * rate_hz:
            out[:t] = True
        if frames - t < END_S * rate_hz:
            out[t:] = True
    for t, u in pairwise(cuts):
        if u - t < BETWEEN_S * rate_hz:
            out[t:u] = True
    return out


def _closed(wrong: Mask, rate_hz: float) -> Mask:
    """A mask (T,) without the gaps shorter than `BETWEEN_S` between its frames."""
    out = np.array(wrong)
    for (_, behind), (first, _) in pairwise(runs(wrong)):
        if first - behind < BETWEEN_S * rate_hz:
            out[behind:first] = True
    return out


def _beyond(R: Array, joints: Sequence[int]) -> Mask:
    """(T,): frames with one of the joints beyond `BEYOND_DEG`."""
    limits = {_INDEX[n]: deg for n, deg in BEYOND_DEG.items() if _INDEX[n] in joints}
    turn = np.rad2deg(ori.angle(R[:, list(limits)]))
    return np.asarray((turn > np.array(list(limits.values()))).any(axis=1))


def runs(mask: Sequence[bool] | Mask) -> list[tuple[int, int]]:
    """(first, behind the last) of each run of true frames."""
    edges = np.flatnonzero(np.diff(np.r_[False, np.asarray(mask, bool), False]))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
