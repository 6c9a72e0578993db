"""Neutral frames of a skeleton that shows no known pose: from its bones, its hinges and the floor."""

from __future__ import annotations

import numpy as np

from mocap import orientation as ori
from mocap.findings import Finding, assumption, doubt
from mocap.formats._frames import (
    SIDES,
    SNAP_DEG,
    STRAIGHT,
    Neutral,
    X,
    Y,
    frame,
    snapped,
    unit,
)
from mocap.formats._source import INDEX, ForeignMotion, Roles
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS

# Neck, head, collars and feet have axes along bones that slant: only what comes this near is snapped.
NEAR_DEG = 8.0


def from_geometry(source: ForeignMotion, roles: Roles, U: Array) -> Neutral:
    """Neutral frames of a skeleton without a known pose.

    Pelvis and chest: from where the limbs attach. Thigh, upper arm: from the bone and the hinge it bends
    about. Shank, forearm, hand: as the bone above, where zero rotation means straight on. Foot: level while
    it stands, and forward along its bone. All others: turning, on average, with the joint above. Exporters
    lay local axes along anatomical ones, so what comes near to a permutation of axes is taken for it: clips
    of one rig then agree exactly.
    """
    G, p = source.forward
    F: dict[int, Array] = {}
    doubts: list[Finding] = []

    def snap(i: int, F_i: Array, within: float = SNAP_DEG) -> Array:
        near, off = snapped(F_i)
        if off <= within:
            return near
        doubts.append(doubt("axes-aslant", joint=source.names[i], off_deg=off))
        return F_i

    F[0] = snap(roles.joint[0], _trunk_frame(source, roles, roles.joint[0], ("hip", "hip")))
    pelvis = G[:, roles.joint[0]] @ F[0]
    spine = [_like(G[:, i], pelvis) for i in roles.spine]
    if spine:
        spine[-1] = _trunk_frame(source, roles, roles.spine[-1], ("shoulder", "collar"))
    F_spine = tuple(snap(i, f) for i, f in zip(roles.spine, spine, strict=True))
    chest = G[:, roles.spine[-1]] @ F_spine[-1] if spine else pelvis
    for j in sorted(set(roles.joint) - {0}):
        name, i, parent = JOINTS[j], roles.joint[j], PARENTS[j]
        if (
            parent in F
            and name.endswith(("knee", "elbow", "wrist"))
            and _straight(source, roles, j, F)
        ):
            F[j] = F[parent]
            continue
        if name.endswith("ankle") and j in roles.target:
            F[j] = _standing_foot(source, roles, j, U)
            continue
        h = _hinge(source, roles, j) if j in _HINGES else None
        if h is not None:
            d = np.einsum("tba,tb->ta", G[:, i], p[:, roles.target[j]] - p[:, i]).mean(axis=0)
            F[j] = snap(i, frame(d, h), within=25.0) @ frame(STRAIGHT[j], _HINGES[j]).T
            continue
        above = G[:, roles.joint[parent]] @ F[parent] if parent in F else chest
        like = _like(G[:, i], above)
        near, off = snapped(like)
        F[j] = near if off < NEAR_DEG else like
    return Neutral(U, F, F_spine, (assumption("axes-by-geometry"),), tuple(doubts))


def _standing_foot(source: ForeignMotion, roles: Roles, j: int, U: Array) -> Array:
    """F of the ankle j: in the quarter of the frames in which its toes move least, the foot is level."""
    G, p = source.forward
    i, toe = roles.joint[j], p[:, roles.target[j]]
    moved = np.linalg.norm(np.gradient(toe, axis=0), axis=1) if len(toe) > 1 else np.zeros(1)
    still = moved <= np.quantile(moved, 0.25)
    local = np.swapaxes(G[still, i], -1, -2)
    up, bone = (
        (local @ U[1]).mean(axis=0),
        (local @ (toe - p[:, i])[still, :, None]).mean(axis=0)[:, 0],
    )
    B = frame(up, bone)  # up, forward, left
    F = B[:, [2, 0, 1]]
    near, off = snapped(F)
    return near if off < NEAR_DEG else F


def _straight(source: ForeignMotion, roles: Roles, j: int, F: dict[int, Array]) -> bool:
    """Whether zero rotation of joint j continues the bone above it straight on.

    Where nothing lies beyond the joint to tell by (a hand without fingers), whether it turns, on
    average, less than 75 deg from the bone above.
    """
    G, p = source.forward
    i, parent = roles.joint[j], PARENTS[j]
    if j in roles.target:
        d = np.einsum("tba,tb->ta", G[:, i], p[:, roles.target[j]] - p[:, i]).mean(axis=0)
        above = np.einsum(
            "tba,tb->ta", G[:, roles.joint[parent]], p[:, i] - p[:, roles.joint[parent]]
        ).mean(axis=0)
        return bool(unit(d) @ unit(above) > np.cos(np.radians(20)))
    mean = ori.mean(np.swapaxes(G[:, roles.joint[parent]], -1, -2) @ G[:, i])
    return bool(ori.angle(mean) < np.radians(75))


def _trunk_frame(source: ForeignMotion, roles: Roles, i: int, ends: tuple[str, str]) -> Array:
    """F of a trunk joint: left from where the limbs attach, up from the other end of the trunk."""
    G, p = source.forward
    ours = {s: roles.joint.get(INDEX[f"{s}_{ends[1]}"], roles.joint[INDEX[f"{s}_{ends[0]}"]])
            for s, _ in SIDES}  # fmt: skip
    left = p[:, ours["left"]] - p[:, ours["right"]]
    if ends[0] == "hip":
        # The first joint above that does not lie on the pelvis itself.
        apart = np.linalg.norm(source.rest - source.rest[i], axis=1) > 1e-3 * np.ptp(source.rest)
        above = [s for s in roles.spine if apart[s]] or [roles.joint[INDEX["left_shoulder"]]]
        up = p[:, above[0]] - p[:, i]
    else:
        # Along the trunk: where a neck is known, towards it.
        neck = roles.joint.get(INDEX["neck"], roles.joint.get(INDEX["head"]))
        up = p[:, neck] - p[:, i] if neck is not None else p[:, i] - p[:, roles.joint[0]]
    local = [np.einsum("tba,tb->ta", G[:, i], v).mean(axis=0) for v in (up, left)]
    B = frame(*local)
    return np.column_stack([B[:, 1], B[:, 0], -B[:, 2]])


def _like(G: Array, above: Array) -> Array:
    """The F that makes a joint, on average over the motion, turn with the joint above it."""
    return ori.mean(np.swapaxes(G, -1, -2) @ above)


# The axis that each long bone's hinge bends about in our T-pose: a knee about +x (the shank goes back), an
# elbow about -y on the left and +y on the right (the forearm goes forward).
_HINGES = {INDEX[f"{s}_{n}"]: h for s, side in SIDES
           for n, h in (("hip", X), ("knee", X), ("shoulder", -side * Y), ("elbow", -side * Y))}  # fmt: skip
_PAIRS = {"hip": ("hip", "knee"), "knee": ("hip", "knee"),
          "shoulder": ("shoulder", "elbow"), "elbow": ("shoulder", "elbow")}  # fmt: skip


def _hinge(source: ForeignMotion, roles: Roles, j: int) -> Array | None:
    """Mean axis (3,), in the frame of joint j, that its limb bends about; None if it stays straight.

    The cross product of the bones above and below the hinge: of thigh and shank the knee's axis, of upper arm
    and forearm the elbow's. It needs no rest pose, and bending the other way would show in its sign.
    """
    side, _, name = JOINTS[j].partition("_")
    G, p = source.forward
    a, b = (INDEX[f"{side}_{n}"] for n in _PAIRS[name])
    u, v = (unit(p[:, roles.target[k]] - p[:, roles.joint[k]]) for k in (a, b))
    h = np.einsum("tba,tb->ta", G[:, roles.joint[j]], np.cross(u, v)).mean(axis=0)
    return h if np.linalg.norm(h) > np.sin(np.radians(1)) else None
