"""One motion of our body, written as the tools of the field would write it.

They have their own joints, rest poses and local axes. In the T-pose (straight arms level with palms down,
straight legs, feet level and forward) a tool's joint has the axes F_j^T in ours. From there bones turn by
B_j(t) = R_j(t) S_j, where S_j turns the T-pose's straight limb into that of our rest pose, so the tool's
joint has the world rotation B_j F_j^T.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.motion import Motion
from mocap.skeleton import JOINTS, PARENTS, REST
from mocap.synthesis import motions
from tests.mocap.formats import motion_files as files

RATE = 120.0
# Another order than that of the joints, as in the Daz files: bodies that lie are no pole of it.
ROOT_CHANNELS = "6 Xposition Yposition Zposition Zrotation Yrotation Xrotation"
J = {name: j for j, name in enumerate(JOINTS)}
SIDES = (("left", 1.0), ("right", -1.0))
_NO_TURN = np.eye(3)


def a_motion(seed: int = 3, seconds: float = 3.0) -> Motion:
    """Walking, to which every joint adds smooth angles of some 10 deg of its own; knees and elbows bend more.

    Hands turn with the wrists and toes with the feet.
    """
    rng = np.random.default_rng(seed)
    walk = motions.walk(4.0, RATE).slice(60, 60 + round(seconds * RATE))
    t = np.arange(len(walk)) / RATE
    waves = np.sin(
        2 * np.pi * rng.uniform(0.4, 0.9, (24, 3, 1)) * t + rng.uniform(0, 6, (24, 3, 1))
    )
    angles = np.radians(rng.uniform(6, 14, (24, 3, 1))) * waves
    angles[[J["pelvis"], *(J[f"{s}_{n}"] for s, _ in SIDES for n in ("hand", "foot"))]] = 0
    for s, side in SIDES:
        angles[J[f"{s}_knee"]] = 0
        angles[J[f"{s}_elbow"]] *= 0.3
        angles[J[f"{s}_elbow"], 1] -= side * np.radians(35)
    R = Rotation.from_rotvec(np.moveaxis(angles, -1, 0).reshape(-1, 3)).as_matrix()
    return Motion(
        RATE, walk.R_parent_joint @ R.reshape(len(t), 24, 3, 3), walk.p_world_root, walk.skeleton
    )


def to(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation (3,3) that takes the direction of a (3,) to that of b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    turn = np.arctan2(np.linalg.norm(axis), a @ b)
    return Rotation.from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * turn).as_matrix()


def straight(rest: np.ndarray = REST) -> np.ndarray:
    """S (24,3,3): the T-pose's limbs to those of rest positions (24,3), lower ones after upper ones."""
    S = np.tile(_NO_TURN, (24, 1, 1))
    for s, side in SIDES:
        for chain, d in (("hip knee ankle", (0, -1, 0)), ("shoulder elbow wrist", (side, 0, 0))):
            j, k, end = (J[f"{s}_{n}"] for n in chain.split())
            S[j] = to(np.array(d, float), rest[k] - rest[j])
            S[k] = to(S[j] @ d, rest[end] - rest[k]) @ S[j]
    return S


def t_pose() -> dict[str, np.ndarray]:
    """Where joints lie in the T-pose, in m from the pelvis; neck and collars do not slant as ours."""
    at = {"pelvis": np.zeros(3)}
    own: dict[str, tuple[float, ...]] = {"neck": (0, 0.24, 0), "head": (0, 0.1, 0)}
    for s, left in SIDES:
        own |= {f"{s}_collar": (left * 0.03, 0.2, 0), f"{s}_shoulder": (left * 0.15, 0, 0)}
        own |= {f"{s}_foot": (0, -0.06, 0.13), f"{s}_hand": (left * 0.09, 0, 0)}
    for j, name in enumerate(JOINTS[1:], 1):
        bone = REST[j] - REST[PARENTS[j]]
        side, _, stem = name.partition("_")
        if stem in ("knee", "ankle"):
            bone = np.linalg.norm(bone) * np.array((0, -1.0, 0))
        elif stem in ("elbow", "wrist"):
            bone = np.linalg.norm(bone) * np.array((1.0 if side == "left" else -1.0, 0, 0))
        at[name] = at[JOINTS[PARENTS[j]]] + np.array(own.get(name, bone), float)
    return at


@dataclass(frozen=True)
class Joint:
    """A tool's joint. plays: our joint that it turns with; at: where it lies in the T-pose, in m."""

    name: str
    parent: str
    plays: str
    at: np.ndarray


@dataclass(frozen=True)
class Rig:
    """A tool's skeleton: joints, parents first, and our axes in those of its joints, by our joint's name."""

    joints: tuple[Joint, ...]
    F: dict[str, np.ndarray]
    unit_m: float = 0.01
    offsets: dict[str, tuple[float, float, float]] | None = None  # where they are not the T-pose's

    def rotations(self, motion: Motion) -> np.ndarray:
        """World rotations (T,K,3,3) of the joints."""
        B = motion.R_world_joint @ straight(motion.skeleton.rest_positions)
        return np.stack([B[:, J[j.plays]] @ self.frame(j).T for j in self.joints], axis=1)

    def frame(self, joint: Joint) -> np.ndarray:
        return self.F.get(joint.plays, _NO_TURN)

    def offset(self, joint: Joint) -> np.ndarray:
        """In the parent's axes, in the tool's unit."""
        if self.offsets and joint.name in self.offsets:
            return np.array(self.offsets[joint.name])
        above = next((j for j in self.joints if j.name == joint.parent), None)
        if above is None:
            return np.zeros(3)
        return np.asarray(self.frame(above) @ (joint.at - above.at) / self.unit_m)

    def _root_place(self, G: np.ndarray) -> np.ndarray:
        """From the pelvis to the joint without parent (T,3), along the chain that leads there."""
        by_name = {j.name: k for k, j in enumerate(self.joints)}
        k = next(k for k, j in enumerate(self.joints) if j.plays == "pelvis")
        p = np.zeros((len(G), 3))
        while self.joints[k].parent:
            above = by_name[self.joints[k].parent]
            p = p - G[:, above] @ self.offset(self.joints[k])
            k = above
        return p

    def bvh(self, motion: Motion, first: np.ndarray | None = None) -> str:
        """The motion as BVH. first (K,3,3): world rotations of a T-pose frame put before it."""
        G = self.rotations(motion)
        p = motion.p_world_root / self.unit_m
        p = p + self._root_place(G)
        if first is not None:
            G, p = np.concatenate([first[None], G]), np.concatenate([p[:1], p])
        lines, order = ["HIERARCHY"], []
        index = {j.name: k for k, j in enumerate(self.joints)}
        local = np.array(G)
        for k, j in enumerate(self.joints):
            if j.parent:
                local[:, k] = np.swapaxes(G[:, index[j.parent]], -1, -2) @ G[:, k]

        def visit(k: int) -> None:
            j = self.joints[k]
            order.append(k)
            lines.append(f"{'JOINT' if j.parent else 'ROOT'} {j.name}\n{{")
            lines.append("OFFSET " + " ".join(f"{x:.6f}" for x in self.offset(j)))
            moves = "3 Zrotation Xrotation Yrotation" if j.parent else ROOT_CHANNELS
            lines.append(f"CHANNELS {moves}")
            children = [c for c, other in enumerate(self.joints) if other.parent == j.name]
            for child in children:
                visit(child)
            if not children:
                lines.append("End Site\n{\nOFFSET 0 0 0\n}")
            lines.append("}")

        visit(next(k for k, j in enumerate(self.joints) if not j.parent))
        angles = [
            Rotation.from_matrix(local[:, k]).as_euler(
                "ZXY" if self.joints[k].parent else "ZYX", True
            )
            for k in order
        ]
        rows = np.concatenate([p, *angles], axis=1)
        lines += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {1 / motion.rate_hz:.9f}"]
        return "\n".join([*lines, *(" ".join(f"{x:.6f}" for x in r) for r in rows), ""])


def _both(rows: str) -> list[str]:
    """Rows with {s} for a side's word, {l} and {L} for its letter, once for each side where they have one."""
    out = []
    for row in rows.strip().splitlines():
        for s, _ in SIDES if "{" in row else SIDES[:1]:
            out.append(row.format(s=s.capitalize(), l=s[0], L=s[0].upper(), side=s))
    return out


def _rig(rows: str, F: dict[str, np.ndarray] | None = None, **more: object) -> Rig:
    """A rig of rows `name parent joint-of-ours [other share]`: a share of the way to the joint `other`."""
    at, joints = t_pose(), []
    for name, parent, plays, *way in (row.split() for row in _both(rows)):
        place = at[plays]
        if way:
            place = place + float(way[1]) * (at[way[0]] - place)
        joints.append(Joint(name, "" if parent == "-" else parent, plays, place))
    return Rig(tuple(joints), F or {}, **more)  # type: ignore[arg-type]


MIXAMO = _rig("""
mixamorig:Hips - pelvis
mixamorig:Spine mixamorig:Hips spine1
mixamorig:Spine1 mixamorig:Spine spine2
mixamorig:Spine2 mixamorig:Spine1 spine3
mixamorig:Neck mixamorig:Spine2 neck
mixamorig:Head mixamorig:Neck head
mixamorig:{s}Shoulder mixamorig:Spine2 {side}_collar
mixamorig:{s}Arm mixamorig:{s}Shoulder {side}_shoulder
mixamorig:{s}ForeArm mixamorig:{s}Arm {side}_elbow
mixamorig:{s}Hand mixamorig:{s}ForeArm {side}_wrist
mixamorig:{s}HandMiddle1 mixamorig:{s}Hand {side}_hand
mixamorig:{s}UpLeg mixamorig:Hips {side}_hip
mixamorig:{s}Leg mixamorig:{s}UpLeg {side}_knee
mixamorig:{s}Foot mixamorig:{s}Leg {side}_ankle
mixamorig:{s}ToeBase mixamorig:{s}Foot {side}_foot
""")


def from_the_head(rig: Rig) -> Rig:
    """A Mixamo-like rig whose hierarchy begins at the head: neck, trunk and hips hang below it."""
    stem = "mixamorig:"
    above = dict(zip(("Neck", "Spine2", "Spine1", "Spine", "Hips"),
                     ("Head", "Neck", "Spine2", "Spine1", "Spine"), strict=True))  # fmt: skip
    parent = {stem + child: stem + p for child, p in above.items()} | {f"{stem}Head": ""}
    joints = [replace(j, parent=parent.get(j.name, j.parent)) for j in rig.joints]
    return replace(rig, joints=tuple(joints))


# Xsens: four joints in the spine, where MVNX has the segments L5, L3, T12 and T8.
XSENS = _rig("""
Hips - pelvis
Chest Hips spine1
Chest2 Chest spine1 spine2 0.5
Chest3 Chest2 spine2
Chest4 Chest3 spine3
Neck Chest4 neck
Head Neck head
{s}Collar Chest4 {side}_collar
{s}Shoulder {s}Collar {side}_shoulder
{s}Elbow {s}Shoulder {side}_elbow
{s}Wrist {s}Elbow {side}_wrist
{s}Hip Hips {side}_hip
{s}Knee {s}Hip {side}_knee
{s}Ankle {s}Knee {side}_ankle
{s}Toe {s}Ankle {side}_foot
""")


def _turns(axis: str, **degrees: float) -> dict[str, np.ndarray]:
    return {n: Rotation.from_euler(axis, v, True).as_matrix() for n, v in degrees.items()}


# At zero angles CMU's legs are spread by 20 deg, feet along with them; in the T-pose that MotionBuilder's
# conversion begins with, the neck has turned by -16 deg about x and the head by +16.
CMU_F = _turns("x", neck=16, head=-16)
for _side, _sign in SIDES:
    for _name in ("hip", "knee", "ankle", "foot"):
        CMU_F |= _turns("z", **{f"{_side}_{_name}": 20.0 * _sign})

MOTIONBUILDER = _rig("""
Hips - pelvis
{L}HipJoint Hips pelvis
{s}UpLeg {L}HipJoint {side}_hip
{s}Leg {s}UpLeg {side}_knee
{s}Foot {s}Leg {side}_ankle
{s}ToeBase {s}Foot {side}_foot
LowerBack Hips spine1
Spine LowerBack spine2
Spine1 Spine spine3
Neck Spine1 neck
Neck1 Neck neck head 0.5
Head Neck1 head
{s}Shoulder Spine1 {side}_collar
{s}Arm {s}Shoulder {side}_shoulder
{s}ForeArm {s}Arm {side}_elbow
{s}Hand {s}ForeArm {side}_elbow {side}_wrist 0.5
{s}FingerBase {s}Hand {side}_wrist
{s}HandIndex1 {s}FingerBase {side}_hand
""", CMU_F, unit_m=0.0254 / 0.45)  # fmt: skip

# The Daz figure's bones, by which it is known, and how CMU's conversion lays its joints, rounded to a degree.
_DAZ_OFFSETS = {
    "lShin": (0.0, -36.8199, 0.73152), "rShin": (0.0, -36.8199, 0.73152),
    "lFoot": (-0.73152, -45.1104, -5.12064), "rFoot": (0.73152, -45.1104, -5.12064),
    "lForeArm": (28.1742, -1.7115, 0.48768), "rForeArm": (-28.1742, -1.7115, 0.48768),
    "lHand": (22.5879, 0.773209, 7.07136), "rHand": (-22.5879, 0.773209, 7.07136),
    "chest": (0.0, 11.7043, -0.48768),
}  # fmt: skip
_DAZ_F = _turns("x", left_hip=5, right_hip=5, left_knee=4, right_knee=5) | _turns(
    "z", left_shoulder=-7, left_elbow=-8, left_wrist=-8, right_shoulder=8, right_elbow=8, right_wrist=8
)  # fmt: skip

DAZ = _rig("""
hip - pelvis
abdomen hip spine1
chest abdomen spine3
neck chest neck
head neck head
{l}Collar chest {side}_collar
{l}Shldr {l}Collar {side}_shoulder
{l}ForeArm {l}Shldr {side}_elbow
{l}Hand {l}ForeArm {side}_wrist
{l}Buttock hip pelvis
{l}Thigh {l}Buttock {side}_hip
{l}Shin {l}Thigh {side}_knee
{l}Foot {l}Shin {side}_ankle
""", _DAZ_F, offsets=_DAZ_OFFSETS)  # fmt: skip


def _along_x() -> dict[str, np.ndarray]:
    """Our axes in those of a rig whose local x runs along each bone, backward on the right side."""
    F = {n: to(np.array((0, 1.0, 0)), np.array((1.0, 0, 0)))
         for n in ("pelvis", "spine1", "spine3", "neck", "head")}  # fmt: skip
    quarter = Rotation.from_euler("x", 90, True).as_matrix()
    for s, side in SIDES:
        for n in ("hip", "knee"):
            F[f"{s}_{n}"] = quarter @ to(np.array((0, -side, 0)), np.array((1.0, 0, 0)))
        for n in ("collar", "shoulder", "elbow", "wrist", "hand"):
            F[f"{s}_{n}"] = quarter
        for n in ("ankle", "foot"):
            F[f"{s}_{n}"] = to(np.array((0, 0, side)), np.array((1.0, 0, 0)))
    return F


ALONG_X = _rig("""
Hips - pelvis
Spine Hips spine1
Chest Spine spine3
Neck Chest neck
Head Neck head
Shoulder_{L} Chest {side}_collar
UpperArm_{L} Shoulder_{L} {side}_shoulder
LowerArm_{L} UpperArm_{L} {side}_elbow
Hand_{L} LowerArm_{L} {side}_wrist
UpperLeg_{L} Hips {side}_hip
LowerLeg_{L} UpperLeg_{L} {side}_knee
Foot_{L} LowerLeg_{L} {side}_ankle
Toes_{L} Foot_{L} {side}_foot
""", _along_x())  # fmt: skip


# Bandai-Namco's bones, and how neck, head, collars and feet lie in them, rounded to a degree.
_BANDAI_OFFSETS = {"Neck": (16.3773, 0.0, 0.0)} | {
    f"{bone}_{letter}": (sign * x, 0.0, 0.0)
    for letter, sign in (("L", 1.0), ("R", -1.0))
    for bone, x in (("LowerLeg", 39.0811), ("Foot", 40.9854), ("LowerArm", 24.3286),
                    ("Hand", 22.2916), ("UpperArm", 5.34809))
}  # fmt: skip
_BANDAI_F = {
    name: Rotation.from_rotvec(v, degrees=True).as_matrix() for name, v in {
        "neck": (-70, -68, -72), "head": (-70, -68, -73), "left_collar": (1, -18, 4),
        "right_collar": (-177, -11, -24), "left_ankle": (40, 41, 83),
        "right_ankle": (-98, -96, 48), "left_foot": (51, 52, 79), "right_foot": (-87, -86, 59),
    }.items()
}  # fmt: skip
BANDAI = replace(ALONG_X, F=ALONG_X.F | _BANDAI_F, offsets=_BANDAI_OFFSETS)


def write_motionbuilder(folder: Path, motion: Motion) -> Path:
    """A T-pose as frame 0, then the motion."""
    rig = MOTIONBUILDER
    first = np.array([rig.frame(j).T for j in rig.joints])
    return _written(folder / "motionbuilder.bvh", rig.bvh(motion, first))


def write_daz(folder: Path, motion: Motion) -> Path:
    """Zero rotations as frame 0, then the motion."""
    first = np.tile(_NO_TURN, (len(DAZ.joints), 1, 1))
    return _written(folder / "daz.bvh", DAZ.bvh(motion, first))


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


_AMC_PLAYS = {
    "root": "pelvis", "lowerback": "spine1", "upperback": "spine2", "thorax": "spine3",
    "lowerneck": "neck", "head": "head",
} | {
    s[0] + bone: f"{s}_{ours}" for s, _ in SIDES for bone, ours in (
        ("femur", "hip"), ("tibia", "knee"), ("foot", "ankle"), ("toes", "foot"),
        ("clavicle", "collar"), ("humerus", "shoulder"), ("radius", "elbow"), ("wrist", "elbow"),
        ("hand", "wrist"), ("fingers", "hand"),
    )
}  # fmt: skip


def write_amc(folder: Path, motion: Motion) -> Path:
    """An ASF skeleton whose bones turn about all three of their axes, and the motion as AMC."""
    bones = files.asf_bones()
    free = "rx ry rz"
    B = motion.R_world_joint @ straight(motion.skeleton.rest_positions)
    G = {n: B[:, J[o]] @ CMU_F.get(o, _NO_TURN).T for n, o in _AMC_PLAYS.items()}
    G |= {f"{s[0]}hipjoint": G["root"] for s, _ in SIDES}
    p = motion.p_world_root / (0.0254 / 0.45)
    angles = {"root": np.concatenate([p, _about(G["root"])], axis=1)}
    for name, parent, _, _, axis, dof in bones:
        if not dof:
            continue
        C = Rotation.from_euler("xyz", [float(a) for a in axis.split()], True).as_matrix()
        angles[name] = _about(C.T @ np.swapaxes(G[parent], -1, -2) @ G[name] @ C)
    lines = ["#!OML:ASF somewhere", ":FULLY-SPECIFIED", ":DEGREES"]
    for t in range(len(motion)):
        lines.append(str(t + 1))
        lines += [f"{n} " + " ".join(f"{x:.6f}" for x in a[t]) for n, a in angles.items()]
    text = files.asf_text()
    for dof in sorted({b[5] for b in bones if b[5]}, key=len):
        text = text.replace(f"\ndof {dof}\n", f"\ndof {free}\n")
    _written(folder / "07.asf", text)
    return _written(folder / "07_01.amc", "\n".join([*lines, ""]))


def _about(R: np.ndarray) -> np.ndarray:
    """Angles (T,3) deg of Rz Ry Rx about x, y and z."""
    return np.asarray(Rotation.from_matrix(R).as_euler("xyz", True))


_MVN_PLAYS = {
    "Pelvis": "pelvis", "L5": "spine1", "L3": "spine1", "T12": "spine2", "T8": "spine3",
    "Neck": "neck", "Head": "head",
} | {
    f"{s.capitalize()}{segment}": f"{s}_{ours}" for s, _ in SIDES for segment, ours in (
        ("Shoulder", "collar"), ("UpperArm", "shoulder"), ("ForeArm", "elbow"), ("Hand", "wrist"),
        ("UpperLeg", "hip"), ("LowerLeg", "knee"), ("Foot", "ankle"), ("Toe", "foot"),
    )
}  # fmt: skip


def write_mvnx(folder: Path, motion: Motion) -> Path:
    """Segments alone, no sensors: x forward, y left, z up; identity in the T-pose."""
    theirs = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    B = motion.R_world_joint @ straight(motion.skeleton.rest_positions)
    G = theirs @ np.stack([B[:, J[o]] for o in _MVN_PLAYS.values()], axis=1) @ theirs.T
    q = np.roll(Rotation.from_matrix(G.reshape(-1, 3, 3)).as_quat(), 1, axis=1).reshape(len(G), -1)
    lines = [f'<?xml version="1.0"?><mvnx><subject frameRate="{RATE:g}"><segments>']
    lines += [f'<segment label="{n}"/>' for n in _MVN_PLAYS]
    lines.append("</segments><frames>")
    for t, row in enumerate(q):
        numbers = " ".join(f"{x:.7f}" for x in row)
        lines.append(
            f'<frame type="normal" time="{1000 * t / RATE:.3f}"><orientation>{numbers}</orientation></frame>'
        )
    return _written(folder / "take.mvnx", "\n".join([*lines, "</frames></subject></mvnx>"]))


def _bvh(name: str, rig: Rig) -> Callable[[Path, Motion], Path]:
    return lambda folder, motion: _written(folder / f"{name}.bvh", rig.bvh(motion))


WRITERS: dict[str, Callable[[Path, Motion], Path]] = {
    "amc": write_amc,
    "motionbuilder": write_motionbuilder,
    "daz": write_daz,
    "mixamo": _bvh("mixamo", MIXAMO),
    "xsens-bvh": _bvh("xsens", XSENS),
    "mvnx": write_mvnx,
    "along-x": _bvh("along_x", ALONG_X),
    "bandai": _bvh("bandai", BANDAI),
}
RIGS = {
    "motionbuilder": MOTIONBUILDER,
    "mixamo": MIXAMO,
    "xsens-bvh": XSENS,
    "along-x": ALONG_X,
    "bandai": BANDAI,
}
