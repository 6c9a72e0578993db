"""Small motion files that the tests write, members of the data archives, and a second BVH kinematics."""

from __future__ import annotations

import tarfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.skeleton import JOINTS, PARENTS, REST

XSENS = {"pelvis": "Hips", "spine1": "Chest", "spine2": "Chest2", "spine3": "Chest3", "neck": "Neck",
         "head": "Head", "collar": "Collar", "shoulder": "Shoulder", "elbow": "Elbow",
         "wrist": "Wrist", "hip": "Hip", "knee": "Knee", "ankle": "Ankle", "foot": "Toe"}  # fmt: skip
MIXAMO = {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck",
          "head": "Head", "collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
          "hand": "HandMiddle1", "hip": "UpLeg", "knee": "Leg", "ankle": "Foot",
          "foot": "ToeBase"}  # fmt: skip
BLENDER = {"pelvis": "hips", "spine1": "spine", "spine3": "chest", "neck": "neck", "head": "head",
           "collar": "shoulder", "shoulder": "upper_arm", "elbow": "forearm", "wrist": "hand",
           "hip": "thigh", "knee": "shin", "ankle": "foot", "foot": "toe"}  # fmt: skip


def members(archive: Path, wanted: Sequence[str], into: Path) -> dict[str, Path]:
    """The wanted files of an archive by name, written into a folder; reading stops at the last one."""
    found: dict[str, Path] = {}
    with tarfile.open(archive) as tar:
        for member in tar:
            name = Path(member.name).name
            data = tar.extractfile(member) if name in wanted else None
            if data is not None:
                found[name] = into / name
                found[name].write_bytes(data.read())
            if len(found) == len(set(wanted)):
                break
    return found


def extract(archive: Path, wanted: tuple[str, ...], into: Path) -> dict[str, Path]:
    """The wanted `.bvh` members of an archive by stem."""
    found = members(archive, [f"{stem}.bvh" for stem in wanted], into)
    return {path.stem: path for path in found.values()}


@dataclass
class Kinematics:
    """Joints of a BVH file by name: positions (T,3) in the world, and the T of the file."""

    at: dict[str, np.ndarray]
    frames: int


def kinematics(path: Path) -> Kinematics:
    """Forward kinematics of a BVH file, written once more and as plainly as possible."""
    head, _, tail = path.read_text().partition("MOTION")
    numbers = np.array([line.split() for line in tail.split("\n")[3:] if line.strip()], float)
    at: dict[str, np.ndarray] = {}
    stack: list[tuple[np.ndarray, np.ndarray]] = []
    R, p = np.tile(np.eye(3), (len(numbers), 1, 1)), np.zeros((len(numbers), 3))
    name, column = "", 0
    for line in head.splitlines():
        words = line.split()
        if words and words[0] in ("ROOT", "JOINT", "End"):
            name = " ".join(words[1:])
        elif words[:1] == ["{"]:
            stack.append((R, p))
        elif words[:1] == ["}"]:
            R, p = stack.pop()
        elif words[:1] == ["OFFSET"]:
            p = stack[-1][1] + R @ np.array(words[1:4], float)
        elif words[:1] == ["CHANNELS"]:
            channels = words[2:]
            block = numbers[:, column : column + len(channels)]
            column += len(channels)
            if "Xposition" in channels:
                moved = block[:, [channels.index(f"{a}position") for a in "XYZ"]]
                p = stack[-1][1] + (R @ moved[..., None])[..., 0]
            turns = [i for i, c in enumerate(channels) if c.endswith("rotation")]
            order = "".join(channels[i][0] for i in turns)
            R = R @ Rotation.from_euler(order, block[:, turns], degrees=True).as_matrix()
            at[name] = p
    return Kinematics(at, len(numbers))


def joint_name(joint: str, names: dict[str, str], style: str) -> str | None:
    """A tool's name of our joint; None where the tool has no such joint. style: "{side}{name}" or so."""
    side, _, stem = joint.partition("_")
    if side not in ("left", "right"):
        return (
            style.format(side="", name=names[joint], letter="").strip(".")
            if joint in names
            else None
        )
    if stem not in names:
        return None
    return style.format(side=side.capitalize(), name=names[stem], letter=side[0].upper())


def bvh_text(
    names: dict[str, str] | None = None,
    style: str = "{side}{name}",
    unit: float = 0.01,
    angles: np.ndarray | None = None,
    path: np.ndarray | None = None,
    rate_hz: float = 60.0,
) -> str:
    """A BVH file of our rest body as another tool would name it.

    unit: m per unit. angles: (T,24,3) deg about z, x, y of our joints; those the tool lacks are not
    written. path: (T,3) m of the pelvis.
    """
    names = XSENS if names is None else names
    angles = np.zeros((5, 24, 3)) if angles is None else angles
    path = np.tile([0.0, 1.0, 0.0], (len(angles), 1)) if path is None else path
    lines, order = ["HIERARCHY"], []

    def visit(j: int, above: int) -> None:
        name = joint_name(JOINTS[j], names, style)
        if name is not None:
            offset = (REST[j] - REST[above]) / unit if above >= 0 else np.zeros(3)
            lines.append(f"{'JOINT' if above >= 0 else 'ROOT'} {name}\n{{")
            lines.append("OFFSET " + " ".join(f"{x:.9g}" for x in offset))
            channels = "3" if above >= 0 else "6 Xposition Yposition Zposition"
            lines.append(f"CHANNELS {channels} Zrotation Xrotation Yrotation")
            order.append(j)
            above = j
        children = [c for c, parent in enumerate(PARENTS) if parent == j]
        for child in children:
            visit(child, above)
        if not children and name is not None:
            lines.append("End Site\n{\nOFFSET 0 1 0\n}")
        if name is not None:
            lines.append("}")

    visit(0, -1)
    values = np.concatenate([path / unit, angles[:, order].reshape(len(angles), -1)], axis=1)
    lines += ["MOTION", f"Frames: {len(values)}", f"Frame Time: {1 / rate_hz:.9f}"]
    lines += [" ".join(f"{x:.9g}" for x in row) for row in values]
    return "\n".join(lines) + "\n"


# CMU's bones of one side or the middle: name, parent, direction, length, axis, degrees of freedom.
_BONES = (
    ("hipjoint", "root", "0.65 -0.71 0.25", 2.5, "0 0 0", ""),
    ("femur", "hipjoint", "0.34202 -0.939693 0", 7.6, "0 0 20", "rx ry rz"),
    ("tibia", "femur", "0.34202 -0.939693 0", 7.3, "0 0 20", "rx"),
    ("foot", "tibia", "0.0886837 -0.243657 0.965798", 2.2, "-90 0 20", "rx rz"),
    ("toes", "foot", "0 0 1", 1.1, "-90 0 20", "rx"),
    ("clavicle", "thorax", "0.967826 0.247107 -0.0474446", 3.6, "0 0 0", "ry rz"),
    ("humerus", "clavicle", "1 0 0", 4.9, "180 -30 -90", "rx ry rz"),
    ("radius", "humerus", "1 0 0", 3.4, "180 -30 -90", "rx"),
    ("wrist", "radius", "1 0 0", 1.7, "0 90 90", "ry"),
    ("hand", "wrist", "1 0 0", 0.7, "0 90 90", "rx rz"),
    ("fingers", "hand", "1 0 0", 0.5, "0 90 90", "rx"),
)
_MIDDLE = (
    ("lowerback", "root", "0 1 0", 2.1, "0 0 0", "rx ry rz"),
    ("upperback", "lowerback", "0 1 0", 2.1, "0 0 0", "rx ry rz"),
    ("thorax", "upperback", "0 1 0", 2.1, "0 0 0", "rx ry rz"),
    ("lowerneck", "thorax", "0 1 0", 1.6, "0 0 0", "rx ry rz"),
    ("head", "lowerneck", "0 1 0", 1.6, "0 0 0", "rx ry rz"),
)


def _mirrored(numbers: str, signs: tuple[int, int, int]) -> str:
    return " ".join(f"{s * float(v):g}" for s, v in zip(signs, numbers.split(), strict=True))


def asf_bones() -> list[tuple[str, str, str, float, str, str]]:
    """All bones of a small CMU-like skeleton."""
    bones = list(_MIDDLE)
    for side in "lr":
        for name, parent, direction, length, axis, dof in _BONES:
            above = parent if parent in ("root", "thorax") else side + parent
            if side == "r":  # mirrored in x: rotations about y and z turn the other way
                direction, axis = _mirrored(direction, (-1, 1, 1)), _mirrored(axis, (1, -1, -1))
            bones.append((side + name, above, direction, length, axis, dof))
    return bones


def asf_text() -> str:
    """A skeleton file as CMU's."""
    lines = ["# a comment", ":version 1.10", ":name VICON", ":units", "mass 1.0", "length 0.45",
             "angle deg", ":root", "order TX TY TZ RX RY RZ", "axis XYZ", "position 0 0 0",
             "orientation 0 0 0", ":bonedata"]  # fmt: skip
    for k, (name, _, direction, length, axis, dof) in enumerate(asf_bones(), 1):
        lines += ["begin", f"id {k}", f"name {name}", f"direction {direction}", f"length {length}",
                  f"axis {axis} XYZ", *([f"dof {dof}"] if dof else []), "end"]  # fmt: skip
    lines += [":hierarchy", "begin"]
    return "\n".join([*lines, *(f"{b[1]} {b[0]}" for b in asf_bones()), "end", ""])


def amc_text(frames: list[dict[str, str]]) -> str:
    """Frames of angles in deg by bone; bones not named have zeros."""
    lines = ["#!OML:ASF somewhere", ":FULLY-SPECIFIED", ":DEGREES"]
    for t, frame in enumerate(frames, 1):
        lines += [str(t), "root " + frame.get("root", "0 17 0 0 0 0")]
        for name, *_, dof in asf_bones():
            if dof:
                lines.append(f"{name} " + frame.get(name, " ".join("0" for _ in dof.split())))
    return "\n".join([*lines, ""])
