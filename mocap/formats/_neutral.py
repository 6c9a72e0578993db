"""Neutral frames: our axes in the local axes of a foreign skeleton's joints.

F_j (3,3): column k is our axis k (left, up, forward in the T-pose) in the coordinates of the source
joint that plays our joint j. Found from a pose in which the body's posture is known, or from geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.formats._source import INDEX, Roles, Source
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, REST

SNAP_DEG = 35.0  # a local axis this near to an anatomical one is taken for it
SIDES = (("left", 1.0), ("right", -1.0))
X, Y, Z = np.eye(3)


@dataclass(frozen=True, eq=False)
class Neutral:
    """U (3,3): the source's world to ours. F: our joint index to F_j. F_spine: of each spine joint."""

    U: Array
    F: dict[int, Array]
    F_spine: tuple[Array, ...]
    assumption: str
    warnings: tuple[str, ...] = ()


def unit(v: Array) -> Array:
    """v / |v| along the last axis; zero stays zero."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300))


def minimal_rotation(a: Array, b: Array) -> Array:
    """The rotation (3,3) by the smallest angle that takes the direction of a (3,) to that of b."""
    a, b = unit(np.asarray(a, float)), unit(np.asarray(b, float))
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis, sine = np.cross(a, np.eye(3)[np.argmin(np.abs(a))]), 1.0
        return ori.exp(np.pi * unit(axis))
    return ori.exp(axis / sine * np.arctan2(sine, cosine))


def frame(d: Array, h: Array) -> Array:
    """Orthonormal columns [d, h made normal to d, their cross product] of directions (3,)."""
    d = unit(d)
    h = unit(h - (h @ d) * d)
    return np.column_stack([d, h, np.cross(d, h)])


def find(source: Source, roles: Roles) -> Neutral:
    """The neutral frames of a source.

    In this order: zero rotations, if the limbs then point as in a T-, A- or N-pose; frame 0, if it is
    a clear T-pose; else geometry.
    """
    Q = _body_axes(source.rest, roles, snap=True)
    U = _upright(source, roles, Q)
    if Q is not None and _is_standing(source.rest @ Q, roles):
        F = dict.fromkeys(roles.joint, Q)
        said = "zero rotations are the rest pose; bones are aligned to ours by their directions"
        return Neutral(U, F, (Q,) * len(roles.spine), said)
    G, p = source.forward
    if is_t_pose(p[0] @ U.T, roles, tolerance_deg=20.0):
        left = (p[0] @ U.T)[[roles.joint[INDEX["left_hip"]], roles.joint[INDEX["right_hip"]]]]
        yaw = np.arctan2(-(left[0] - left[1])[2], (left[0] - left[1])[0])
        Q0 = U.T @ ori.rot_y(yaw)
        F = {j: G[0, i].T @ Q0 for j, i in roles.joint.items()}
        spine = tuple(G[0, i].T @ Q0 for i in roles.spine)
        return Neutral(U, F, spine, "frame 0 is a T-pose and gives each joint's rest orientation")
    return _from_geometry(source, roles, U)


def _body_axes(p: Array, roles: Roles, snap: bool) -> Array | None:
    """Columns left, up, forward of a body with joint positions p (K,3), or None where degenerate."""
    at = {name: p[roles.joint[INDEX[name]]] for name in
          ("left_hip", "right_hip", "left_shoulder", "right_shoulder")}  # fmt: skip
    left = at["left_hip"] - at["right_hip"]
    up = at["left_shoulder"] + at["right_shoulder"] - at["left_hip"] - at["right_hip"]
    if np.linalg.norm(np.cross(left, up)) < 1e-6 * max(float(left @ left), float(up @ up), 1e-300):
        return None
    B = frame(up, left)[:, [1, 0, 2]]
    B[:, 2] *= -1  # left x up, not up x left
    return _snapped(B)[0] if snap else B


def _snapped(F: Array) -> tuple[Array, float]:
    """The nearest rotation that permutes axes, and how far it is in deg; F itself beyond SNAP_DEG."""
    # tr(F^T P) = 1 + 2 cos(angle)
    best = _PERMUTATIONS[int(np.argmax(np.einsum("ab,nab->n", F, _PERMUTATIONS)))]
    off = float(np.degrees(ori.angle_between(F, best)))
    return (best, off) if off <= SNAP_DEG else (F, off)


def _permutations() -> Array:
    """The 24 rotations (24,3,3) that take coordinate axes to coordinate axes."""
    axes = [s * a for a in np.eye(3) for s in (1.0, -1.0)]
    return np.array(
        [np.column_stack([a, b, np.cross(a, b)]) for a in axes for b in axes if abs(a @ b) < 0.5]
    )


_PERMUTATIONS = _permutations()


def _upright(source: Source, roles: Roles, Q: Array | None) -> Array:
    """U (3,3): turns the source's up axis to y.

    y is up wherever the rest pose or the mean posture says so, as BVH has it; another axis needs both.
    """
    p = source.forward[1]
    shoulders = p[:, [roles.joint[INDEX[f"{s}_shoulder"]] for s in ("left", "right")]].mean(axis=1)
    ankles = p[:, [roles.joint[INDEX[f"{s}_ankle"]] for s in ("left", "right")]].mean(axis=1)
    mean = (shoulders - ankles).mean(axis=0)
    k = int(np.argmax(np.abs(mean)))
    seen = np.sign(mean[k]) * np.eye(3)[k]
    rest = seen if Q is None else Q[:, 1]
    if max(seen @ Y, rest @ Y) > 0.7 or seen @ rest < 0.7:
        return np.eye(3)
    return np.round(minimal_rotation(seen, Y), 12)


def _limbs(p: Array, roles: Roles) -> dict[str, Array]:
    """Unit vectors of thighs, shanks, upper arms, forearms and the trunk of positions p (K,3)."""
    at = {JOINTS[j]: p[i] for j, i in roles.joint.items()}
    out = {}
    for s, _ in SIDES:
        for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
            v = at[f"{s}_{b}"] - at[f"{s}_{a}"]
            out[f"{s}_{a}"] = v / max(float(np.linalg.norm(v)), 1e-300)
    trunk = at["left_shoulder"] + at["right_shoulder"] - at["left_hip"] - at["right_hip"]
    out["trunk"] = trunk / max(float(np.linalg.norm(trunk)), 1e-300)
    return out


def _is_standing(p: Array, roles: Roles) -> bool:
    """Whether positions (K,3) in body axes are a T-, A- or N-pose with straight limbs."""
    d = _limbs(p, roles)
    down, flat = np.cos(np.radians(40)), np.sin(np.radians(40))
    for s, side in SIDES:
        if min(-d[f"{s}_hip"][1], -d[f"{s}_knee"][1]) < down:
            return False
        arm, fore = d[f"{s}_shoulder"], d[f"{s}_elbow"]
        if abs(arm[2]) > flat or arm @ fore < down or arm[1] > flat or side * arm[0] < -0.3:
            return False
    return bool(d["trunk"][1] > down)


def is_t_pose(p: Array, roles: Roles, tolerance_deg: float) -> bool:
    """Whether positions (K,3) in a y-up world are a T-pose at any heading, each limb within tolerance."""
    B = _body_axes(p, roles, snap=False)
    if B is None or B[1, 1] < np.cos(np.radians(tolerance_deg)):
        return False
    forward = unit(np.array([B[0, 2], 0.0, B[2, 2]]))
    d = _limbs(p @ np.column_stack([np.cross(Y, forward), Y, forward]), roles)
    wanted = {f"{s}_{j}": -Y for s, _ in SIDES for j in ("hip", "knee")}
    wanted |= {f"{s}_{j}": side * X for s, side in SIDES for j in ("shoulder", "elbow")}
    return all(d[k] @ v > np.cos(np.radians(tolerance_deg)) for k, v in wanted.items())


def _from_geometry(source: Source, roles: Roles, U: Array) -> Neutral:
    """Neutral frames of a skeleton without a known pose.

    Pelvis and chest: from where the limbs attach. Thigh, upper arm, foot: from the bone and the hinge it
    bends about. Shank, forearm, hand: as the bone above, where zero rotation means straight on. All
    others: turning, on average, with the joint above. Exporters lay local axes along anatomical ones,
    so what comes near to a permutation of axes is taken for it: clips of one rig then agree exactly.
    """
    G, p = source.forward
    F: dict[int, Array] = {}
    doubts: list[str] = []

    def snap(i: int, F_i: Array, within: float = SNAP_DEG) -> Array:
        snapped, off = _snapped(F_i)
        if off <= within:
            return snapped
        doubts.append(
            f"the local axes of {source.names[i]} lie {off:.0f} deg off the body's, so its twist is "
            f"that of the mean posture"
        )
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
        h = _hinge(source, roles, name) if name.endswith(_HINGED) else None
        if h is not None:
            d = np.einsum("tba,tb->ta", G[:, i], p[:, roles.target[j]] - p[:, i]).mean(axis=0)
            F[j] = snap(i, frame(d, h), within=25.0) @ frame(*_OUR_LIMBS[name]).T
            continue
        above = G[:, roles.joint[parent]] @ F[parent] if parent in F else chest
        F[j] = snap(i, _like(G[:, i], above))
    said = (
        "zero rotations are no rest pose: each joint's axes are found from the bones' geometry and the "
        "hinges of knees and elbows"
    )
    return Neutral(U, F, F_spine, said, tuple(doubts))


def _straight(source: Source, roles: Roles, j: int, F: dict[int, Array]) -> bool:
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


def _trunk_frame(source: Source, roles: Roles, i: int, ends: tuple[str, str]) -> Array:
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


# Joints whose twist a hinge shows: the bone above or below bends about it.
_HINGED = ("hip", "knee", "shoulder", "elbow", "ankle")


def _our_limbs() -> dict[str, tuple[Array, Array]]:
    """Bone direction and hinge axis of each hinged joint in our T-pose.

    A knee bends about +x (the shank goes back), an elbow about -y on the left and +y on the right (the
    forearm goes forward). The foot's reference is x as well.
    """
    out: dict[str, tuple[Array, Array]] = {}
    for s, side in SIDES:
        out |= {f"{s}_hip": (-Y, X), f"{s}_knee": (-Y, X)}
        out |= {f"{s}_shoulder": (side * X, -side * Y), f"{s}_elbow": (side * X, -side * Y)}
        foot = REST[INDEX[f"{s}_foot"]] - REST[INDEX[f"{s}_ankle"]]
        out[f"{s}_ankle"] = (foot, -X)
    return out


_OUR_LIMBS = _our_limbs()


def _hinge(source: Source, roles: Roles, name: str) -> Array | None:
    """Mean axis (3,), in the joint's own frame, that its limb bends about; None if it stays straight.

    The cross product of the bone above the hinge and the bone below it: for a thigh and shank the
    knee's axis, for an upper arm and forearm the elbow's, for a foot (shank and foot) the ankle's. It
    needs no rest pose, and bending the other way would show in its sign.
    """
    side, _, joint = name.partition("_")
    first = {
        "hip": "hip",
        "knee": "hip",
        "shoulder": "shoulder",
        "elbow": "shoulder",
        "ankle": "knee",
    }
    second = {"hip": "knee", "shoulder": "elbow", "knee": "ankle"}[first[joint]]
    a, b = INDEX[f"{side}_{first[joint]}"], INDEX[f"{side}_{second}"]
    if a not in roles.target or b not in roles.target:
        return None
    G, p = source.forward
    u = unit(p[:, roles.target[a]] - p[:, roles.joint[a]])
    v = unit(p[:, roles.target[b]] - p[:, roles.joint[b]])
    h = np.einsum("tba,tb->ta", G[:, roles.joint[INDEX[name]]], np.cross(u, v)).mean(axis=0)
    return h if np.linalg.norm(h) > np.sin(np.radians(1)) else None
