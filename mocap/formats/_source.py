"""A foreign skeleton in motion, and which of its joints play ours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.formats import _joint_names
from mocap.orientation import Array
from mocap.skeleton import JOINTS

INDEX = {name: j for j, name in enumerate(JOINTS)}
# The joint at the far end of each of our bones, where one bone is meant.
_BONES = (("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"), ("collar", "shoulder"),
          ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"))  # fmt: skip
TARGET = {INDEX[f"{s}_{a}"]: INDEX[f"{s}_{b}"] for s in ("left", "right") for a, b in _BONES} | {
    INDEX["neck"]: INDEX["head"]
}


@dataclass(frozen=True, eq=False)
class ForeignMotion:
    """A foreign motion: K joints, parents first, lengths in the file's unit.

    names: "" for what cannot be matched (ends of chains). offsets (K,3): each joint in its parent's
    frame. R_local (T,K,3,3): R_parent_joint. translations: (T,3) by joint, where a joint moves in its
    parent; that of joint 0 is its place in the world. given: names that the user mapped by hand. start_s:
    time of the first frame on the take's clock.
    """

    path: Path
    rate_hz: float
    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    R_local: Array
    translations: dict[int, Array]
    given: dict[str, str] = field(default_factory=dict)
    start_s: float = 0.0

    def __len__(self) -> int:
        return len(self.R_local)

    def slice(self, start: int) -> ForeignMotion:
        """Without the frames before `start`."""
        moved = {j: t[start:] for j, t in self.translations.items()}
        later = self.start_s + start / self.rate_hz
        return replace(self, R_local=self.R_local[start:], translations=moved, start_s=later)

    def only(self, joints: list[int]) -> ForeignMotion:
        """With those joints alone; the parent of each must be among them."""
        new = {j: k for k, j in enumerate(joints)}
        return replace(
            self,
            names=tuple(self.names[j] for j in joints),
            parents=tuple(new.get(self.parents[j], -1) for j in joints),
            offsets=self.offsets[joints],
            R_local=self.R_local[:, joints],
            translations={new[j]: t for j, t in self.translations.items() if j in new},
        )

    def path_to(self, joint: int) -> list[int]:
        """Joints from the root down to `joint`, both included."""
        chain = [joint]
        while self.parents[chain[-1]] >= 0:
            chain.append(self.parents[chain[-1]])
        return chain[::-1]

    def between(self, a: int, b: int) -> tuple[int, ...]:
        """The joints on the way through the tree from a (not included) to b (included).

        Where neither is above the other, the joint that carries both is left out: it moves with neither.
        """
        up, down = self.path_to(a), self.path_to(b)
        shared = sum(i == j for i, j in zip(up, down, strict=False))
        way = [*up[shared:][::-1], *down[shared - (b in up) :]]
        return tuple(i for i in way if i != a)

    def below(self, joint: int) -> list[int]:
        """All descendants of `joint`."""
        inside = {joint}
        for j, parent in enumerate(self.parents):
            if parent in inside:
                inside.add(j)
        return sorted(inside - {joint})

    @cached_property
    def forward(self) -> tuple[Array, Array]:
        """Global rotations (T,K,3,3) and positions (T,K,3) in the source's world and unit."""
        R = np.array(self.R_local)
        p = np.empty(R.shape[:-1])
        for j, parent in enumerate(self.parents):
            moved = self.translations.get(j)
            if parent < 0:
                p[:, j] = self.offsets[j] if moved is None else moved
                continue
            if moved is None:
                p[:, j] = p[:, parent] + R[:, parent] @ self.offsets[j]
            else:
                p[:, j] = p[:, parent] + (R[:, parent] @ moved[..., None])[..., 0]
            R[:, j] = R[:, parent] @ R[:, j]
        return R, p

    @cached_property
    def rest(self) -> Array:
        """(K,3): joint positions at zero rotation, the root at the origin."""
        p = np.zeros_like(self.offsets)
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                moved = self.translations.get(j)
                p[j] = p[parent] + (self.offsets[j] if moved is None else moved.mean(axis=0))
        return p


@dataclass(frozen=True, eq=False)
class Roles:
    """Which source joint plays which of ours.

    joint: our index to the source's, for the pelvis, neck, head and limbs that exist. spine: the
    source's joints between pelvis and arms, from below. target: the source joint (or end) at the far
    end of each of our bones that has one.
    """

    joint: dict[int, int]
    spine: tuple[int, ...]
    target: dict[int, int]


def needed(source: ForeignMotion, roles: Roles) -> list[int]:
    """The joints that the roles' kinematics depend on (not fingers, eyes or props)."""
    ends = {*roles.joint.values(), *roles.target.values()}
    return sorted({i for end in ends for i in source.path_to(end)})


def assign(source: ForeignMotion) -> Roles:
    """The roles of a source's joints, limbs by name, pelvis and spine by structure.

    Raises FormatError naming the limbs that no joint name fits, or that are not on one chain.
    """
    named = _joint_names.match(source.names, source.given)
    if any(j not in named for j in _joint_names.REQUIRED):
        raise FormatError(source.path, _joint_names.unmatched(source.names, named))
    joint = {INDEX[name]: i for name, i in named.items()}
    _check_chains(source, joint)
    legs, arms = (
        [source.path_to(joint[INDEX[f"{s}_{a}"]])[:-1] for s in ("left", "right")]
        for a in ("hip", "shoulder")
    )
    # By the legs: what the hierarchy begins with may be the head, or a reference on the floor.
    joint[0], chest = _last_common(legs), _last_common(arms)
    for a in ("hip", "shoulder"):
        pair = [joint[INDEX[f"{s}_{a}"]] for s in ("left", "right")]
        width = float(np.linalg.norm(source.rest[pair[0]] - source.rest[pair[1]]))
        if not width > 1e-3 * float(np.ptp(source.rest)):
            raise FormatError(source.path, f"left and right {a} lie on each other")
    if min(joint[0], chest) < 0:
        raise FormatError(source.path, "legs and arms do not hang on one root")
    spine = source.between(joint[0], chest)
    for name in ("neck", "head"):
        if INDEX[name] in joint and joint[INDEX[name]] in (joint[0], *spine):
            del joint[INDEX[name]]
    return Roles(joint, spine, _targets(source, joint))


def _check_chains(source: ForeignMotion, joint: dict[int, int]) -> None:
    for a, b in TARGET.items():
        if a not in joint or b not in joint or a in source.path_to(joint[b])[:-1]:
            continue
        if joint[a] in source.path_to(joint[b])[:-1]:
            continue
        if JOINTS[b] in _joint_names.REQUIRED:
            names = source.names[joint[a]], source.names[joint[b]]
            raise FormatError(
                source.path, f"joint {names[1]!r} is not below {names[0]!r}, as {JOINTS[b]} must be"
            )
        del joint[a if JOINTS[a] not in _joint_names.REQUIRED else b]


def _last_common(paths: list[list[int]]) -> int:
    last = -1
    for together in zip(*paths, strict=False):
        if len(set(together)) == 1:
            last = together[0]
    return last


def _targets(source: ForeignMotion, joint: dict[int, int]) -> dict[int, int]:
    hip, knee = joint[INDEX["left_hip"]], joint[INDEX["left_knee"]]
    length = float(np.linalg.norm(source.rest[knee] - source.rest[hip]))
    if not length > 0:
        raise FormatError(
            source.path, f"joint {source.names[knee]!r} lies on {source.names[hip]!r}: no thigh"
        )

    def far(a: int, candidates: Iterable[int]) -> int | None:
        """The farthest candidate, if at least 4 % of a thigh away: shorter has no direction."""
        span = {b: float(np.linalg.norm(source.rest[b] - source.rest[a])) for b in candidates}
        best = max(span, key=lambda b: span[b], default=None)
        return best if best is not None and span[best] > 0.04 * length else None

    target = {}
    for a, b in TARGET.items():
        if a not in joint:
            continue
        found = far(joint[a], [joint[b]]) if b in joint else None
        if found is None and JOINTS[a].endswith(("wrist", "ankle")):
            below = source.below(joint[a])
            found = far(joint[a], [i for i in below if "thumb" not in _name_above(source, i)])
        if found is not None:
            target[a] = found
        elif JOINTS[a].endswith(("hip", "knee", "shoulder", "elbow")):
            raise FormatError(
                source.path, f"the bone from {source.names[joint[a]]!r} has no length", JOINTS[a]
            )
    return target


def _name_above(source: ForeignMotion, joint: int) -> str:
    """The joint's name in lower case, or of the nearest named joint above an end."""
    while not source.names[joint]:
        joint = source.parents[joint]
    return source.names[joint].lower()
