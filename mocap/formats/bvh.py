"""BVH: motion of any skeleton, read onto our 24 joints; our motion, written for other tools.

Reading: `_bvh_text` parses, `_retarget` maps (joint names, bone directions, rest poses, units). A file
that `write_motion` wrote is recognised by its joints and read back as it was, body included.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap.errors import FormatError, ShapeError
from mocap.findings import assumption
from mocap.formats import Content, Document, Format, Options, _bvh_profiles, _joint_names
from mocap.formats._bvh_profiles import PROFILES, RESTS, Profile, Rest
from mocap.formats._bvh_text import BvhFile, parse
from mocap.formats._files import write_aside
from mocap.formats._retarget import retarget
from mocap.formats._source import ForeignMotion, assign, needed
from mocap.motion import Motion, check_rate
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, REST, STATURE_RANGE, Skeleton

CM = 0.01
_POSITIONS = ("xposition", "yposition", "zposition")
# In CMU's MotionBuilder files "LeftHand" only turns about the forearm; the hand bends at the joint below.
MOTIONBUILDER_HANDS = {f"{s}{n}": f"{s.lower()}_{ours}" for s in ("Left", "Right")
                       for n, ours in (("FingerBase", "wrist"), ("HandIndex1", "hand"))}  # fmt: skip
_ORDER = ("zrotation", "xrotation", "yrotation")
# Where the bones without a joint beyond them end, in m from the joint (for display only).
_ENDS = {
    "left_foot": (0.0, 0.0, 0.06), "right_foot": (0.0, 0.0, 0.06), "head": (0.0, 0.19, 0.0),
    "left_hand": (0.1, 0.0, 0.0), "right_hand": (-0.1, 0.0, 0.0),
}  # fmt: skip


def sniff(path: Path, head: bytes) -> bool:
    """Whether the first bytes are those of a BVH file."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper() == b"HIERARCHY"


def read(path: Path, options: Options) -> Document:
    """The motion in a BVH file, on our body (`options.height` or `options.smpl`, else the table's).

    options.scale: m per unit of the file (else guessed from the legs). options.rate_hz overrides the
    frame time. options.up: the axis that points up (else found). options.mapping: source joint name to
    ours, for names that are not recognised.
    Raises FormatError naming line, joint or frame.
    """
    path = Path(path)
    file = parse(path, path.read_bytes())
    rate = file.rate_hz if options.rate_hz is None else check_rate(options.rate_hz, str(path))
    own = _own_rest(file)
    if own is not None:
        motion = _read_own(path, file, rate, own)
        return Document("bvh", motion, file.assumed, file.doubts)
    source = _source(path, file, rate, options)
    done = retarget(source, _body(options), options.scale, options.up)
    named = assumption("joint-names", joints=dict(source.given))
    assumed = (*file.assumed, *done.assumed, named)
    return Document("bvh", done.motion, assumed, (*file.doubts, *done.doubts))


def _body(options: Options) -> Skeleton:
    if options.smpl is None:
        return Skeleton.default(options.height)
    return Skeleton.from_smpl_file(options.smpl)


def _source(path: Path, file: BvhFile, rate: float, options: Options) -> ForeignMotion:
    """The joints that matter, with their rotations computed."""
    given = options.mapping if isinstance(options.mapping, dict) else {}
    if not given and set(MOTIONBUILDER_HANDS) <= set(file.names):
        given = MOTIONBUILDER_HANDS
    moving = [
        i for i, j in enumerate(file.joints) if j.parent < 0 or set(j.channels) & set(_POSITIONS)
    ]
    still = ForeignMotion(
        path,
        rate,
        file.names,
        file.parents,
        np.array([j.offset for j in file.joints]),
        np.empty((0, len(file.joints), 3, 3)),
        {i: file.translations(i) for i in moving},
        given,
    )
    matched = _joint_names.match(still.names, still.given)
    named = {still.names[i]: joint for joint, i in matched.items()}
    twice = next((n for n in named if still.names.count(n) > 1), None)
    if twice is not None:
        raise FormatError(
            path, f"joint name {twice!r} occurs more than once; {named[twice]} needs one"
        )
    joints = needed(still, assign(still))
    return replace(still.only(joints), R_local=file.rotations(joints), given=named)


def _layout() -> tuple[tuple[str, ...], tuple[int, ...], tuple[int, ...]]:
    """Depth-first order of our joints with the ends ("" and our joint's index) in between."""
    names: list[str] = []
    parents: list[int] = []
    ours: list[int] = []

    def visit(j: int, parent: int) -> None:
        names.append(JOINTS[j])
        parents.append(parent)
        ours.append(j)
        here = len(names) - 1
        for child in (c for c, p in enumerate(PARENTS) if p == j):
            visit(child, here)
        if JOINTS[j] in _ENDS:
            names.append("")
            parents.append(here)
            ours.append(j)

    visit(0, -1)
    return tuple(names), tuple(parents), tuple(ours)


_OWN_NAMES, _OWN_PARENTS, _OWN_JOINTS = _layout()


def _own_rest(file: BvhFile) -> Rest | None:
    """The rest pose of a file that `write_motion` wrote: its joints, its channels, a body like ours."""
    profile = next((p for p in PROFILES if file.names == _named(p)), None)
    if profile is None or file.parents != _OWN_PARENTS:
        return None
    for j in file.joints:
        if j.name and j.channels != (_ORDER if j.parent >= 0 else (*_POSITIONS, *_ORDER)):
            return None
    offsets = np.zeros((24, 3))
    joints = [i for i, j in enumerate(file.joints) if j.name]
    offsets[[_OWN_JOINTS[i] for i in joints]] = [
        CM * np.array(file.joints[i].offset) for i in joints
    ]
    off: dict[Rest, float] = {}
    for rest in RESTS:
        body = Skeleton(JOINTS, PARENTS, _bvh_profiles.in_t_pose(offsets, rest))
        off[rest] = float(np.abs(body.rest_positions - (REST - REST[0])).max())
    nearest = min(RESTS, key=lambda rest: off[rest])
    # Other tools' names may come from other tools, with limbs that are straight at other angles.
    return nearest if off[nearest] < (0.5 if profile == "smpl" else 0.25) else None


def _named(profile: Profile) -> tuple[str, ...]:
    """Names in a file of ours, ends included."""
    ours = _bvh_profiles.names(profile)
    return tuple(ours[j] if name else "" for name, j in zip(_OWN_NAMES, _OWN_JOINTS, strict=True))


def _read_own(path: Path, file: BvhFile, rate: float, rest: Rest) -> Motion:
    offsets = np.zeros((24, 3))
    R = np.empty((len(file.values), 24, 3, 3))
    joints = [i for i, j in enumerate(file.joints) if j.name]
    ours = [_OWN_JOINTS[i] for i in joints]
    offsets[ours] = CM * np.array([file.joints[i].offset for i in joints])
    R[:, ours] = file.rotations(joints)
    p = CM * file.translations(0)
    offsets = _bvh_profiles.in_t_pose(offsets, rest)
    # J0 is no part of a BVH file; it only shifts `trans` of SMPL files.
    offsets[0] = REST[0]
    skeleton = Skeleton(JOINTS, PARENTS, offsets)
    if not STATURE_RANGE[0] <= skeleton.stature <= STATURE_RANGE[1]:
        raise FormatError(path, f"stature {skeleton.stature:.3g} m, expected {STATURE_RANGE} m")
    return Motion(rate, _bvh_profiles.from_rest(R, rest), p, skeleton)


def write_motion(
    path: str | Path, motion: Motion, profile: Profile = "smpl", rest: Rest = "t"
) -> None:
    """Write a motion as BVH for Blender, Unity and others: cm, y up, the body faces +z at zero.

    One ROOT with position and ZXY rotation channels (its OFFSET is zero, so the position is the
    pelvis in the world whether a tool adds or replaces), other joints ZXY rotations in degrees.
    profile: whose names the joints have. rest: the pose in which all rotations are zero, T or A (arms 45 deg
    below). Reading it back gives the same rotations to 1e-7 rad and positions to 1e-8 m.
    """
    if motion.skeleton.names != JOINTS:
        raise ShapeError("BVH holds the 24-joint body only")
    offsets, R = _bvh_profiles.at_rest(motion, rest)
    ends = _bvh_profiles.ends(rest, _ENDS)
    lines = ["HIERARCHY"]
    _write_joint(lines, _bvh_profiles.names(profile), offsets, ends, 0, 0)
    angles = np.degrees(_euler_zxy(R))
    order = [j for name, j in zip(_OWN_NAMES, _OWN_JOINTS, strict=True) if name]
    values = np.concatenate(
        [motion.p_world_root / CM, angles[:, order].reshape(len(motion), -1)], axis=1
    )
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.rate_hz:.10f}"]
    with write_aside(path) as aside, aside.open("w", encoding="ascii", newline="\n") as f:
        f.write("\n".join(lines) + "\n")
        np.savetxt(f, values, fmt="%.6f")


def _write_joint(
    lines: list[str],
    names: tuple[str, ...],
    offsets: Array,
    ends: dict[str, Array],
    j: int,
    depth: int,
) -> None:
    pad, inner = "\t" * depth, "\t" * (depth + 1)
    offset = offsets[j] / CM if j else np.zeros(3)
    channels = "6 Xposition Yposition Zposition" if j == 0 else "3"
    lines += [
        f"{pad}{'JOINT' if j else 'ROOT'} {names[j]}",
        f"{pad}{{",
        f"{inner}OFFSET {_triple(offset)}",
        f"{inner}CHANNELS {channels} Zrotation Xrotation Yrotation",
    ]
    for child in (c for c, p in enumerate(PARENTS) if p == j):
        _write_joint(lines, names, offsets, ends, child, depth + 1)
    if JOINTS[j] in ends:
        end = _triple(ends[JOINTS[j]] / CM)
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {end}", f"{inner}}}"]
    lines.append(f"{pad}}}")


def _triple(v: Array) -> str:
    return " ".join(f"{x:.6f}" for x in v)


def _euler_zxy(R: Array) -> Array:
    """Angles (...,3) rad (z, x, y) with R = Rz Rx Ry; at the pole (x = +-90 deg) y is zero."""
    x = np.arcsin(np.clip(R[..., 2, 1], -1.0, 1.0))
    pole = np.abs(R[..., 2, 1]) > 1 - 1e-12
    z = np.arctan2(-R[..., 0, 1], R[..., 1, 1])
    y = np.arctan2(-R[..., 2, 0], R[..., 2, 2])
    z = np.where(pole, np.arctan2(R[..., 1, 0], R[..., 0, 0]), z)
    return np.stack([z, x, np.where(pole, 0.0, y)], axis=-1)


def _write(path: Path, content: Content) -> None:
    if not isinstance(content, Motion):
        raise FormatError(path, "BVH holds a motion, not a recording")
    write_motion(path, content)


FORMAT = Format(
    "bvh",
    (".bvh",),
    sniff,
    read,
    _write,
    kinds=("motion",),
    about="skeletons of most animation tools: Mixamo, Rokoko, OptiTrack, Xsens, Blender",
    sign="BVH (begins with HIERARCHY)",
)
