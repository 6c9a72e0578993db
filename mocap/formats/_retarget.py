"""A foreign skeleton's motion on our 24-joint body: T-pose corresponds to T-pose.

Let G_j(t) be the global rotation of the source joint that plays our joint j. Its axes are whatever the
exporting tool chose, so a constant per joint turns them into ours:

    R_world_j(t) = U G_j(t) F_j M_j

U turns the source's world to y up. F_j is the neutral frame: its columns are our axes in the local axes of
the source joint when the body stands in the T-pose (straight arms level with palms down, straight legs, feet
flat and forward). It comes from the rest pose, from a T-pose in frame 0 or from geometry (`_neutral`), and
from what is known of the rig (`_rigs`). With M = I every one of our rotations is the identity in the T-pose.

Thighs, shanks, upper arms and forearms have an M_j that makes their directions equal the source's in every
frame: N_j S_j^T, where S_j turns the T-pose's straight limb into that of our rest pose, and N_j is the
smallest rotation that takes the straight limb to the source's bone F_j^T d_j. All others have M = I: where a
tool puts the joints inside trunk, neck and shoulder girdle is its own choice.

The body's size differs, so the place is scaled: the middle of the hips moves as the source's times the
ratio of leg lengths, and the lowest foot of the motion stands on the floor y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import _neutral, _upright
from mocap.formats._frames import STRAIGHT, T_POSE_FRAMES, Neutral, minimal_rotation, unit
from mocap.formats._neutral import straightening
from mocap.formats._source import INDEX, ForeignMotion, Roles, assign
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, SOLE_BELOW_TOE, Skeleton

# Length units that occur, in m; the last is CMU's.
UNITS = {"1 m": 1.0, "1 cm": 0.01, "1 mm": 0.001, "1 inch": 0.0254, "1 foot": 0.3048,
         "1/0.45 inch": 0.0254 / 0.45}  # fmt: skip
LEG_RANGE = (0.45, 1.25)  # m, hip to ankle: from a child of 1 m to beyond the tallest
JUMP_DEG_S = 1000.0


@dataclass(frozen=True, eq=False)
class Retargeted:
    """The motion, and what was assumed or is doubtful."""

    motion: Motion
    assumed: tuple[Finding, ...]
    doubts: tuple[Finding, ...]


def retarget(
    source: ForeignMotion,
    skeleton: Skeleton,
    scale: float | None = None,
    up: _upright.Up | None = None,
) -> Retargeted:
    """The source's motion on `skeleton`.

    scale: m per unit of the file; None guesses it from the leg's length. up: the axis of the source's world
    that points up; None finds it. Raises FormatError where limbs
    are not recognised or a given scale makes no human.
    """
    roles = assign(source)
    neutral = _neutral.find(source, roles, up)
    said, doubts = list(neutral.assumed), list(neutral.doubts)
    unit_said, unit_doubt = _unit(source, roles, scale)
    said.append(unit_said)
    doubts += unit_doubt
    drop = neutral.t_pose_frames
    if len(source) > drop + 1 and _starts_with_t_pose(source, roles, neutral.U):
        # The T-pose was put before the take, whose clock starts with the frame after it.
        source = replace(source.slice(drop), start_s=source.start_s + (drop - 1) / source.rate_hz)
        said.append(assumption("t-pose-dropped", frames=drop))
    R = _rotations(source, roles, neutral, skeleton)
    p = _root_path(source, roles, neutral.U, R, skeleton)
    doubts += _moving_bones(source, roles) + _backward_knees(R, skeleton)
    said.append(assumption("path-scaled"))
    motion = Motion(source.rate_hz, skeleton.local_rotations(R), p, skeleton, source.start_s)
    doubts += _beyond_anatomy(motion.R_parent_joint) + _upright.doubts(motion, up)
    return Retargeted(motion, tuple(said), tuple(doubts))


def _rotations(source: ForeignMotion, roles: Roles, neutral: Neutral, skeleton: Skeleton) -> Array:
    """R_world_joint (T,24,3,3)."""
    G, p = source.forward
    R = np.empty((len(source), 24, 3, 3))
    trunk = [neutral.U @ G[:, roles.joint[0]] @ neutral.F[0]]
    trunk += [neutral.U @ G[:, s] @ F for s, F in zip(roles.spine, neutral.F_spine, strict=True)]
    R[:, 0] = trunk[0]
    for k, j in enumerate((INDEX["spine1"], INDEX["spine2"], INDEX["spine3"]), 1):
        R[:, j] = _between(trunk, (len(trunk) - 1) * k / 3)
    own = straightening(skeleton.rest_positions, {j: j for j in range(24)})
    for j in range(1, 24):
        if JOINTS[j].startswith("spine"):
            continue
        if j not in neutral.F:
            R[:, j] = R[:, PARENTS[j]]
            continue
        i = roles.joint[j]
        R[:, j] = neutral.U @ G[:, i] @ neutral.F[j]
        if j in STRAIGHT:
            if neutral.own_limbs:
                d = _local_direction(G[:, i], p[:, roles.target[j]] - p[:, i])
                R[:, j] = R[:, j] @ minimal_rotation(STRAIGHT[j], neutral.F[j].T @ d)
            R[:, j] = R[:, j] @ own[j].T
    if INDEX["neck"] not in neutral.F and INDEX["head"] in neutral.F:
        R[:, INDEX["neck"]] = _between([R[:, INDEX["spine3"]], R[:, INDEX["head"]]], 0.5)
    return R


def _local_direction(G: Array, d: Array) -> Array:
    """Mean unit vector (3,) in the joint's frame of world vectors d (T,3)."""
    return unit(np.einsum("tba,tb->ta", G, d).mean(axis=0))


def _between(R: list[Array], at: float) -> Array:
    """Geodesic interpolation at place `at` along a chain of rotations (T,3,3), 0 its first."""
    k = min(int(at + 1e-9), len(R) - 1)
    s = at - k
    if s < 1e-9:
        return R[k]
    return R[k] @ ori.exp(s * ori.log(np.swapaxes(R[k], -1, -2) @ R[k + 1]))


def _root_path(
    source: ForeignMotion, roles: Roles, U: Array, R: Array, skeleton: Skeleton
) -> Array:
    """p_world_root (T,3) m: the hips' middle follows the source's, scaled; lowest foot on the floor."""
    hips = [INDEX["left_hip"], INDEX["right_hip"]]
    middle = source.forward[1][:, [roles.joint[h] for h in hips]].mean(axis=1) @ U.T
    ratio = _leg(skeleton.rest_positions, {j: j for j in range(24)}) / _leg(
        source.rest, roles.joint
    )
    p = ratio * middle - R[:, 0] @ skeleton.offsets[hips].mean(axis=0)
    feet = skeleton.positions(R, p)[:, [INDEX[f"{s}_{j}"] for s in ("left", "right")
                                        for j in ("ankle", "foot")], 1]  # fmt: skip
    p[:, 1] += SOLE_BELOW_TOE - feet.min()
    return p


def _leg(rest: Array, joint: dict[int, int]) -> float:
    """Mean length of the two legs, hip to knee to ankle."""
    total = 0.0
    for s in ("left", "right"):
        hip, knee, ankle = (rest[joint[INDEX[f"{s}_{j}"]]] for j in ("hip", "knee", "ankle"))
        total += float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee)) / 2
    return total


def _unit(
    source: ForeignMotion, roles: Roles, scale: float | None
) -> tuple[Finding, list[Finding]]:
    """What is assumed of the file's unit, and doubts. The unit cancels in the scaled path."""
    leg = _leg(source.rest, roles.joint)
    body = Skeleton.default()
    per_leg = body.stature / _leg(body.rest_positions, {j: j for j in range(24)})
    if scale is not None:
        if not (np.isfinite(scale) and LEG_RANGE[0] <= leg * scale <= LEG_RANGE[1]):
            raise FormatError(
                source.path,
                f"at {scale:g} m per unit the legs are {leg * scale:.3g} m long, expected "
                f"{LEG_RANGE[0]} to {LEG_RANGE[1]} m",
            )
        return assumption("unit-told", unit_m=scale, stature_m=leg * scale * per_leg), []
    name = min(UNITS, key=lambda u: abs(np.log(leg * UNITS[u] * per_leg / body.stature)))
    stature = leg * UNITS[name] * per_leg
    if not LEG_RANGE[0] <= leg * UNITS[name] <= LEG_RANGE[1]:
        return assumption("unit-unknown"), [doubt("unit-none-fits", leg=leg)]
    usual = 1.3 <= stature <= 2.2
    odd = [] if usual else [doubt("stature", stature_m=stature, unit=name)]
    return assumption("unit-guessed", unit=name, stature_m=stature), odd


def _starts_with_t_pose(source: ForeignMotion, roles: Roles, U: Array) -> bool:
    """Whether frame 0 is a T-pose that the motion leaves in one jump.

    A person cannot turn a limb from rest at `JUMP_DEG_S`, so such a frame was put in by a tool. Files
    whose motion itself starts in a T-pose are left whole.
    """
    if len(source) <= T_POSE_FRAMES + 1:
        return False
    joints = list(roles.joint.values())
    head = source.slice(0).R_local[: T_POSE_FRAMES + 1]
    G, p = source.forward[0][: len(head), joints], source.forward[1]
    jump = np.degrees(ori.angle_between(G[0], G[1])).max() * source.rate_hz
    travelled = np.degrees(ori.angle_between(G[0], G[-1])).max()
    if jump < JUMP_DEG_S or travelled < 30.0:
        return False
    return _neutral.is_t_pose(p[0] @ U.T, roles, tolerance_deg=30.0)


def _moving_bones(source: ForeignMotion, roles: Roles) -> list[Finding]:
    """Doubts about limb joints whose position channels change the bone's length."""
    leg = _leg(source.rest, roles.joint)
    inside = {i for j, i in roles.joint.items() if j}
    for j, t in source.translations.items():
        moved = float(np.ptp(t, axis=0).max())
        if j in inside and source.parents[j] >= 0 and moved > 0.01 * leg:
            return [doubt("joint-moves", joint=source.names[j], units=moved)]
    return []


# Joints that no body turns so far from the T-pose, in deg (a wrist's angle holds the forearm's twist).
_STIFF = {"neck": 120.0, "head": 120.0, "left_ankle": 120.0, "right_ankle": 120.0,
          "left_wrist": 150.0, "right_wrist": 150.0}  # fmt: skip


def _beyond_anatomy(R_parent_joint: Array) -> list[Finding]:
    """A doubt for each joint that turns beyond `_STIFF`: a fault of the source's own angles."""
    doubts = []
    for name, limit in _STIFF.items():
        cosine = (np.trace(R_parent_joint[:, INDEX[name]], axis1=-2, axis2=-1) - 1) / 2
        frames = np.flatnonzero(cosine < np.cos(np.radians(limit)))
        if len(frames):
            most = float(np.degrees(np.arccos(max(float(cosine.min()), -1.0))))
            first, last = int(frames[0]), int(frames[-1])
            doubts.append(
                doubt(
                    "beyond-anatomy",
                    joint=name,
                    most_deg=most,
                    frames=len(frames),
                    first=first,
                    last=last,
                )
            )
    return doubts


def _backward_knees(R: Array, skeleton: Skeleton) -> list[Finding]:
    """A doubt where the knees bend backward most of the time: the sides may be exchanged."""
    for s in ("left", "right"):
        hip, knee, ankle = (INDEX[f"{s}_{j}"] for j in ("hip", "knee", "ankle"))
        thigh = unit(skeleton.offsets[knee])
        shank = np.swapaxes(R[:, hip], -1, -2) @ R[:, knee] @ unit(skeleton.offsets[ankle])
        flexion = np.cross(thigh, shank)[:, 0]
        if np.mean(flexion < -np.sin(np.radians(10))) > 0.5:
            return [doubt("knee-backward", side=s)]
    return []
