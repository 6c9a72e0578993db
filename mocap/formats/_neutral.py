"""Neutral frames of a foreign skeleton: from a pose in which its posture is known, or from geometry.

What is known of a rig beyond its file (`_rigs`) comes on top.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from mocap.findings import assumption
from mocap.formats import _rigs, _upright
from mocap.formats._frames import (
    SIDES,
    STRAIGHT,
    Neutral,
    Y,
    frame,
    minimal_rotation,
    snapped,
    unit,
)
from mocap.formats._geometry import from_geometry
from mocap.formats._source import INDEX, ForeignMotion, Roles
from mocap.orientation import Array
from mocap.skeleton import JOINTS

NEAR_T_DEG = 10.0  # a limb that lies nearer to the T-pose is in it: rigs place joints by so much


def find(source: ForeignMotion, roles: Roles, up: _upright.Up | None = None) -> Neutral:
    """The neutral frames of a source: of its pose, and what is known of its rig beyond that."""
    found, rig = of_pose(source, roles, up), _rigs.known(source)
    if rig is None:
        return found
    frames = {j: F for j, F in rig.frames().items() if j in roles.joint}
    return replace(
        found,
        F=found.F | frames,
        assumed=(*found.assumed, assumption(rig.code)),
        own_limbs=rig.own_limbs,
        t_pose_frames=rig.t_pose_frames,
    )


def of_pose(source: ForeignMotion, roles: Roles, up: _upright.Up | None = None) -> Neutral:
    """The neutral frames that a source's poses show.

    In this order: zero rotations, if the limbs then point as in a T-, A- or N-pose; frame 0, if it is
    a clear T-pose; else geometry.
    """
    Q = _body_axes(source.rest, roles, snap=True)
    U = _up(source, roles, Q) if up is None else _upright.world(up)
    if Q is not None and _is_standing(source.rest @ Q, roles):
        F = {j: Q @ S for j, S in _straightened(source.rest @ Q, roles).items() if j in roles.joint}
        return Neutral(U, F, (Q,) * len(roles.spine), (assumption("rest-pose"),))
    G, p = source.forward
    if is_t_pose(p[0] @ U.T, roles, tolerance_deg=20.0):
        left = (p[0] @ U.T)[[roles.joint[INDEX["left_hip"]], roles.joint[INDEX["right_hip"]]]]
        yaw = np.arctan2(-(left[0] - left[1])[2], (left[0] - left[1])[0])
        Q0 = U.T @ ori.rot_y(yaw)
        S = _straightened(p[0] @ Q0, roles)
        F = {j: G[0, i].T @ Q0 @ S[j] for j, i in roles.joint.items()}
        spine = tuple(G[0, i].T @ Q0 for i in roles.spine)
        return Neutral(U, F, spine, (assumption("t-pose-first"),))
    return from_geometry(source, roles, U)


def straightening(p: Array, joint: dict[int, int]) -> dict[int, Array]:
    """S_j (3,3) of thighs, shanks, upper arms and forearms by our joint index.

    p (K,3): joint positions in body axes, in a T-, A- or N-pose; joint: our joint index to theirs. S takes
    the T-pose's directions (`STRAIGHT`) to the pose's, the smallest way, that of the bone above first.
    """
    d = _limbs(p, joint)
    S = {}
    for s, _ in SIDES:
        for upper, lower in (("hip", "knee"), ("shoulder", "elbow")):
            first = minimal_rotation(STRAIGHT[INDEX[f"{s}_{upper}"]], d[f"{s}_{upper}"])
            bent = first @ STRAIGHT[INDEX[f"{s}_{lower}"]]
            S[INDEX[f"{s}_{upper}"]] = first
            S[INDEX[f"{s}_{lower}"]] = minimal_rotation(bent, d[f"{s}_{lower}"]) @ first
    return S


def _straightened(p: Array, roles: Roles) -> dict[int, Array]:
    """What turns the T-pose's joints into those of a body at rest, (3,3) by our joint index.

    p as in `straightening`. Hands go with a forearm that is off the T-pose by more than `NEAR_T_DEG`. Feet
    stand on the floor whatever the legs do; only where a foot is built along a spread leg (CMU's skeletons)
    it goes with the leg.
    """
    S = {j: np.eye(3) for j in roles.joint} | straightening(p, roles.joint)
    for s, _ in SIDES:
        fore, shank = S[INDEX[f"{s}_elbow"]], S[INDEX[f"{s}_knee"]]
        off = np.degrees(ori.angle(np.array([fore, shank])))
        if off[0] > NEAR_T_DEG:
            S |= {INDEX[f"{s}_{n}"]: fore for n in ("wrist", "hand")}
        if off[1] > NEAR_T_DEG and _along_leg(p, roles, s, shank):
            S |= {INDEX[f"{s}_{n}"]: shank for n in ("ankle", "foot")}
    return S


def _along_leg(p: Array, roles: Roles, side: str, shank: Array) -> bool:
    """Whether a foot points straight forward if its leg is turned to be vertical, and only then."""
    ankle = INDEX[f"{side}_ankle"]
    if ankle not in roles.target:
        return False
    foot = unit(p[roles.target[ankle]] - p[roles.joint[ankle]])
    return bool(abs((shank.T @ foot)[0]) < np.sin(np.radians(2)) < abs(foot[0]))


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
    return snapped(B)[0] if snap else B


def _up(source: ForeignMotion, roles: Roles, Q: Array | None) -> Array:
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


def _limbs(p: Array, joint: dict[int, int]) -> dict[str, Array]:
    """Unit vectors of thighs, shanks, upper arms, forearms and the trunk of positions p (K,3)."""
    at = {JOINTS[j]: p[i] for j, i in joint.items()}
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
    d = _limbs(p, roles.joint)
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
    d = _limbs(p @ np.column_stack([np.cross(Y, forward), Y, forward]), roles.joint)
    return all(d[JOINTS[j]] @ v > np.cos(np.radians(tolerance_deg)) for j, v in STRAIGHT.items())
