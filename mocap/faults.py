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
MARGIN_DEG = 40.0  # of two solutions that is the right one whose mean twist is smaller by this
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
_ROLLING = (18, 19, 7, 8, 20, 21)  # single bones that roll about their length
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
    where it is; a forearm, foot or hand about its own length. A jump that becomes smooth when one side of it
    is turned parts right from wrong; which side is wrong is said by the twist of the bone about its length,
    which bodies keep small. Of wrists and ankles that are away for less than `BRIDGED_S` the rotation is
    interpolated. Frames are not trusted beside a jump that is left, between two of one joint less than
    `BETWEEN_S` apart, from one to an end of the clip that is less than `END_S` away, where both solutions are
    as good, and where a joint is turned beyond `BEYOND_DEG`.
    """
    work = _Work(motion)
    for limb in _LIMBS:
        work.choose(limb[0], lambda R, limb=limb: _other_side(motion, R, limb))  # type: ignore[misc]
    for joint in _ROLLING:
        work.choose(joint, lambda R, joint=joint: _rolled(motion, R, joint))  # type: ignore[misc]
    for joint in _BRIDGED:
        work.bridge(joint)
    wrong = work.doubtful.any(axis=1) | _beyond(work.R)
    for joint in sorted(set(range(24)) - set(_ENDS)):
        wrong |= work.across(joint)
    return Mended(replace(motion, R_parent_joint=work.R, trusted=~wrong), work.mended)


class _Work:
    """Local rotations as they are mended, and what is known of their frames."""

    def __init__(self, motion: Motion) -> None:
        self.R = np.array(motion.R_parent_joint)
        self.rate_hz, self.skeleton = motion.rate_hz, motion.skeleton
        self.limit = np.deg2rad(jump_limit_deg(motion.rate_hz))
        self.certain = self.limit * CERTAIN_DEG / JUMP_DEG[0]
        self.mended = np.zeros(len(motion), bool)
        self.doubtful = np.zeros((len(motion), 24), bool)
        self.seams: dict[int, set[int]] = {}

    def jumps(self, joint: int) -> list[int]:
        """Frames that a joint has jumped to: beyond the limit, or where a limb was turned not smoothly."""
        step = ori.angle_between(self.R[1:, joint], self.R[:-1, joint])
        far = set(np.flatnonzero(step > self.limit) + 1)
        seams = {t for t in self.seams.get(joint, ()) if step[t - 1] > self.certain}
        return sorted(int(t) for t in far | seams)

    def choose(self, joint: int, turn: Callable[[Array], dict[int, Array]]) -> None:
        """Between the jumps of a joint: it as it is, or turned."""
        cuts = self.jumps(joint)
        if not cuts and not _beyond(self.R, (joint,)).any():
            return
        other = turn(self.R)
        a, b = self.R[:, joint], other[joint]
        turned, group = _labels(a, b, cuts, self.certain)
        twist = np.abs(_twist(np.stack([a, b]), _along(self.skeleton, joint)))
        sizes = [(group == g).sum() for g in range(group[-1] + 1)]
        take = np.zeros(len(a), bool)
        for g in range(len(sizes)):
            mine = group == g
            kept = np.where(turned, twist[1], twist[0])[mine].mean()
            reverse = np.where(turned, twist[0], twist[1])[mine].mean()
            if abs(kept - reverse) < np.deg2rad(MARGIN_DEG):
                self.doubtful[:, joint] |= mine & (
                    turned if turned[mine].any() else g != int(np.argmax(sizes))
                )
                continue
            take |= mine & (turned if kept < reverse else ~turned)
        for j, R in other.items():
            self.R[take, j] = R[take]
        self.mended |= take
        for j in other:
            self.seams.setdefault(j, set()).update(np.flatnonzero(take[1:] != take[:-1]) + 1)

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
            self.doubtful[first + 1 : behind, joint] = False
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


def _labels(a: Array, b: Array, cuts: list[int], certain: float) -> tuple[Mask, NDArray[np.int_]]:
    """(T,) turned against the frames before, and (T,) which frames hang together by certain flips.

    At each cut the joint stays with its solution, or changes to the other where that is smooth; where neither
    is, another group begins.
    """
    turned, group = np.zeros(len(a), bool), np.zeros(len(a), int)
    for t in cuts:
        before = b[t - 1] if turned[t - 1] else a[t - 1]
        step = [float(ori.angle_between(before, x[t])) for x in (a, b)]
        smooth = min(step) < certain
        turned[t:] = smooth and step[1] < step[0]
        group[t:] += not smooth
    return turned, group


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
    child = PARENTS.index(joint)
    Q = ori.exp(np.pi * _along(motion.skeleton, joint))
    below = Q.T @ R[:, child]
    return {joint: R[:, joint] @ Q, child: below @ Q if child in _ENDS else below}


def _along(skeleton: Skeleton, joint: int) -> Array:
    """Unit vector (3,) from a joint to the next in its own frame."""
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


def _beyond(R: Array, joints: Sequence[int] = tuple(range(24))) -> Mask:
    """(T,): frames with one of the joints beyond `BEYOND_DEG`."""
    limits = {_INDEX[n]: deg for n, deg in BEYOND_DEG.items() if _INDEX[n] in joints}
    turn = np.rad2deg(ori.angle(R[:, list(limits)]))
    return np.asarray((turn > np.array(list(limits.values()))).any(axis=1))


def runs(mask: Sequence[bool] | Mask) -> list[tuple[int, int]]:
    """(first, behind the last) of each run of true frames."""
    edges = np.flatnonzero(np.diff(np.r_[False, np.asarray(mask, bool), False]))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
