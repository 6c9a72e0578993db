"""BVH: limbs point where the source's own kinematics say, whatever tool wrote the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError, ShapeError
from mocap.formats import Document, Options, bvh
from mocap.motion import Motion
from mocap.skeleton import JOINTS, Skeleton
from tests.mocap.formats import broken
from tests.mocap.formats import motion_files as files

J = {name: j for j, name in enumerate(JOINTS)}
SIDES = ("left", "right")
# The source's joints at hip, knee, ankle, shoulder, elbow and wrist.
LIMBS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
NAMES = {
    "daz": ("{l}Thigh", "{l}Shin", "{l}Foot", "{l}Shldr", "{l}ForeArm", "{l}Hand"),
    "motionbuilder": ("{s}Hip", "{s}Knee", "{s}Ankle", "{s}Shoulder", "{s}Elbow", "{s}Wrist"),
    "bandai": (
        "UpperLeg_{L}",
        "LowerLeg_{L}",
        "Foot_{L}",
        "UpperArm_{L}",
        "LowerArm_{L}",
        "Hand_{L}",
    ),
}
WALKS = "02_01"  # a person walking forward
CLIPS = {
    "daz": ("07_12", WALKS, "14_37"),
    "motionbuilder": ("131_01",),
    "bandai": ("dataset-2_run_feminine_021", "dataset-2_raise-up-left-hand_normal_002"),
}
ALL = [(kind, clip) for kind, clips in CLIPS.items() for clip in clips]


@pytest.fixture(scope="module")
def clips(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One file for each clip of the data."""
    data, folder = shared / "data", tmp_path_factory.mktemp("bvh")
    out = {c: data / "cmu-motionbuilder-bvh" / f"{c}.bvh" for c in CLIPS["motionbuilder"]}
    out |= files.extract(data / "cmu-daz-bvh.tar.xz", CLIPS["daz"], folder)
    return out | files.extract(data / "bandai2-bvh.tar.xz", CLIPS["bandai"], folder)


_read: dict[Path, Document] = {}


def document(path: Path) -> Document:
    """The file, read once."""
    if path not in _read:
        _read[path] = formats.read(path)
    return _read[path]


def motion(path: Path, options: Options | None = None) -> Motion:
    content = formats.read(path, options).content if options else document(path).content
    assert isinstance(content, Motion)
    return content


def unit(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def degrees_between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    sine = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.degrees(np.arctan2(sine, np.sum(u * v, axis=-1)))


def bone(m: Motion, a: str, b: str) -> np.ndarray:
    return unit(m.p_world_joint[:, J[b]] - m.p_world_joint[:, J[a]])


def in_frame(m: Motion, joint: str, v: np.ndarray) -> np.ndarray:
    """World vectors (T,3) in the axes of a joint."""
    return np.asarray(np.einsum("tba,tb->ta", m.R_world_joint[:, J[joint]], v))


@pytest.mark.parametrize(("kind", "clip"), ALL)
def test_limbs_point_as_in_the_source(clips: dict[str, Path], kind: str, clip: str) -> None:
    m, source = motion(clips[clip]), files.kinematics(clips[clip])
    dropped = source.frames - len(m)
    # Daz files start with a T-pose that is no part of the motion.
    assert dropped == (8 if kind == "daz" else 0)
    for side in SIDES:
        at = [source.at[n.format(l=side[0], L=side[0].upper(), s=side.capitalize())][dropped:]
              for n in NAMES[kind]]  # fmt: skip
        for k in (0, 1, 3, 4):
            own = bone(m, f"{side}_{LIMBS[k]}", f"{side}_{LIMBS[k + 1]}")
            off = degrees_between(own, unit(at[k + 1] - at[k]))
            if kind == "daz":  # its limbs are the original's, off the figure's own by a constant
                assert np.ptp(off) < 0.1 and off.max() < 22, (side, LIMBS[k])
            else:
                assert off.max() < 1.0, (side, LIMBS[k])


@pytest.mark.parametrize(("kind", "clip"), ALL)
def test_joints_bend_as_a_body_does(clips: dict[str, Path], kind: str, clip: str) -> None:
    """Shanks go back from the thighs, forearms forward of the upper arms; all turn as hinges there."""
    m = motion(clips[clip])
    for side, sign in (("left", 1), ("right", -1)):
        shank = in_frame(m, f"{side}_hip", bone(m, f"{side}_knee", f"{side}_ankle"))
        assert np.percentile(shank[:, 2], 95) < np.sin(np.radians(15)), side
        assert np.abs(shank[:, 0]).mean() < 0.25, "a knee does not bend sideways"
        forearm = in_frame(m, f"{side}_shoulder", bone(m, f"{side}_elbow", f"{side}_wrist"))
        assert np.percentile(forearm[:, 2], 5) > -np.sin(np.radians(30)), side
        bent = sign * forearm[:, 0] < 0.7
        if bent.any():
            assert forearm[bent, 2].mean() > 0.4, side
        # Rotations about a bone agree with its neighbours': the knee's axis is the thigh's x axis.
        knee = m.R_parent_joint[:, J[f"{side}_knee"]]
        assert knee[:, 0, 0].mean() > 0.85, side


@pytest.mark.parametrize(("kind", "clip"), ALL)
def test_upright_and_on_the_floor(clips: dict[str, Path], kind: str, clip: str) -> None:
    """Head over pelvis, the lowest foot at 0.02 m, and feet near the floor most of the time."""
    m = motion(clips[clip])
    assert np.median(bone(m, "pelvis", "head")[:, 1]) > 0.85
    feet = m.p_world_joint[:, [J[f"{s}_{j}"] for s in SIDES for j in ("ankle", "foot")], 1]
    assert feet.min() == pytest.approx(0.02, abs=1e-9)
    # In 07_12 the source's own feet rise over the clip; the others stand on one floor.
    assert np.median(feet.min(axis=1)) < (0.15 if clip == "07_12" else 0.1)
    # Our axes on the pelvis: y up, and its x towards the left hip.
    assert np.median(m.R_world_joint[:, 0, 1, 1]) > 0.85
    assert in_frame(m, "pelvis", bone(m, "right_hip", "left_hip"))[:, 0].min() > 0.95


@pytest.mark.parametrize("clip", [WALKS, "dataset-2_run_feminine_021"])
def test_walking_goes_where_the_body_faces(clips: dict[str, Path], clip: str) -> None:
    """The pelvis moves along its own +z, so its +x, where the left hip is, is the left."""
    m = motion(clips[clip])
    step = np.gradient(m.p_world_root[:, [0, 2]], axis=0) * m.rate_hz
    fast = np.linalg.norm(step, axis=1) > 0.5
    assert fast.mean() > 0.3
    facing = unit(m.R_world_joint[fast, 0][:, [0, 2], 2])
    assert np.median(np.sum(facing * unit(step[fast]), axis=1)) > 0.8
    feet = m.R_world_joint[fast][:, [J["left_ankle"], J["right_ankle"]]][..., [0, 2], 2]
    assert np.median(np.sum(feet.mean(axis=1) * unit(step[fast]), axis=1)) > 0.5


def test_one_rig_has_one_mapping(clips: dict[str, Path]) -> None:
    """Constants found from geometry agree between clips: a still joint's M F would differ else."""
    for kind in ("daz", "bandai"):
        said = {document(clips[c]).assumptions[0] for c in CLIPS[kind]}
        assert len(said) == 1
    assert "zero rotations are the rest pose" in document(clips[WALKS]).assumptions[0]


def test_a_joint_beyond_anatomy_is_named(tmp_path: Path) -> None:
    """An ankle that turns by 170 deg is a fault of the file, which stays as it is and is told."""
    angles = np.zeros((8, 24, 3))
    angles[3:6, J["left_ankle"], 2] = 170.0
    path = tmp_path / "x.bvh"
    path.write_text(files.bvh_text(angles=angles))
    warnings = formats.read(path).warnings
    assert len(warnings) == 1
    assert "left_ankle turns by up to 170 deg" in warnings[0]
    assert "3 frames between 3 and 5" in warnings[0]


def a_motion(rng: np.random.Generator, body: Skeleton, T: int = 25) -> Motion:
    R = ori.exp(np.cumsum(rng.normal(0, 0.25, (T, 24, 3)), axis=0))
    return Motion(59.94, R, rng.normal(0, 2, (T, 3)), body)


@pytest.mark.parametrize("height", [None, 1.9])
def test_what_is_written_is_read(
    rng: np.random.Generator, tmp_path: Path, height: float | None
) -> None:
    first = a_motion(rng, Skeleton.default(height))
    bvh.write_motion(tmp_path / "m.bvh", first)
    back = motion(tmp_path / "m.bvh")
    assert back.rate_hz == pytest.approx(first.rate_hz, rel=1e-8)
    assert ori.angle_between(back.R_parent_joint, first.R_parent_joint).max() < 1e-7
    np.testing.assert_allclose(back.p_world_joint, first.p_world_joint, atol=1e-7)


def test_other_tools_see_the_same_joints(rng: np.random.Generator, tmp_path: Path) -> None:
    """The written file, by kinematics that know nothing of our body, in cm."""
    first = a_motion(rng, Skeleton.default())
    bvh.write_motion(tmp_path / "m.bvh", first)
    seen = files.kinematics(tmp_path / "m.bvh").at
    for name, j in J.items():
        np.testing.assert_allclose(0.01 * seen[name], first.p_world_joint[:, j], atol=1e-6)


def test_a_pole_is_written(tmp_path: Path) -> None:
    """At x = +-90 deg the angles z and y turn about one axis; the rotation returns all the same."""
    R = np.tile(np.eye(3), (2, 24, 1, 1))
    R[:, 16] = ori.rot_z(0.4) @ ori.rot_x([np.pi / 2, -np.pi / 2]) @ ori.rot_y(0.3)
    first = Motion(60.0, R, np.zeros((2, 3)), Skeleton.default())
    bvh.write_motion(tmp_path / "m.bvh", first)
    back = motion(tmp_path / "m.bvh")
    assert ori.angle_between(back.R_parent_joint, first.R_parent_joint).max() < 1e-6


def test_only_our_body_is_written(tmp_path: Path) -> None:
    two = Skeleton(("a", "b"), (-1, 0), np.zeros((2, 3)))
    odd = Motion(60.0, np.tile(np.eye(3), (1, 2, 1, 1)), np.zeros((1, 3)), two)
    with pytest.raises(ShapeError, match="24-joint body only"):
        bvh.write_motion(tmp_path / "m.bvh", odd)
    assert not list(tmp_path.iterdir())


TOOLS = {
    "xsens": (files.XSENS, "{side}{name}"),
    "mixamo": (files.MIXAMO, "mixamorig:{side}{name}"),
    "blender": (files.BLENDER, "{name}.{letter}"),
}


def posed(rng: np.random.Generator, T: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Angles (T,24,3) deg about z, x, y and a path (T,3) m."""
    angles = rng.normal(0, 15, (T, 24, 3))
    angles[:, [J["neck"], J["head"], *(J[f"{s}_hand"] for s in SIDES)]] = 0
    return angles, np.cumsum(rng.normal(0, 0.05, (T, 3)), axis=0)


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("unit_m", [1.0, 0.01, 0.001, 0.0254])
def test_a_rig_with_our_rest_pose_is_copied(
    rng: np.random.Generator, tmp_path: Path, tool: str, unit_m: float
) -> None:
    """Our own bones under another tool's names: all rotations return, the path up to the floor."""
    angles, path = posed(rng)
    names, style = TOOLS[tool]
    file = tmp_path / "m.bvh"
    file.write_text(files.bvh_text(names, style, unit=unit_m, angles=angles, path=path))
    doc = formats.read(file)
    m = doc.content
    assert isinstance(m, Motion) and not doc.warnings
    z, x, y = np.moveaxis(np.radians(angles), -1, 0)
    local = ori.rot_z(z) @ ori.rot_x(x) @ ori.rot_y(y)
    for j, name in enumerate(JOINTS):  # joints that the tool lacks do not turn
        if files.joint_name(name, names, style) is None:
            local[:, j] = np.eye(3)
    R = Skeleton.default().rotations(local)
    limbs = [J[f"{s}_{n}"] for s in SIDES for n in ("hip", "knee", "shoulder", "elbow", "collar")]
    apart = np.degrees(ori.angle_between(m.R_world_joint, R))
    assert apart[:, [0, *limbs, J["spine3"]]].max() < 1e-4
    went = m.p_world_root - m.p_world_root[0]
    np.testing.assert_allclose(went, path - path[0], atol=1e-6)
    said = {1.0: "1 m", 0.01: "1 cm", 0.001: "1 mm", 0.0254: "1 inch"}[unit_m]
    # Mixamo's names in cm are as `write_motion` writes them: nothing is guessed.
    ours = (tool, unit_m) == ("mixamo", 0.01)
    assert ours != any(f"length unit {said}, guessed" in s for s in doc.assumptions)


def test_a_scale_is_told(tmp_path: Path) -> None:
    file = tmp_path / "m.bvh"
    file.write_text(files.bvh_text(unit=0.02))
    doc = formats.read(file, Options(scale=0.02))
    assert any("0.02 m as told" in s for s in doc.assumptions)
    with pytest.raises(FormatError, match="legs are"):
        formats.read(file, Options(scale=1.0))
    with pytest.raises(FormatError, match="legs are"):
        formats.read(file, Options(scale=float("nan")))


def test_rate_body_and_names_are_told(rng: np.random.Generator, tmp_path: Path) -> None:
    file = tmp_path / "m.bvh"
    file.write_text(files.bvh_text(rate_hz=30.0).replace("LeftKnee", "Gelenk"))
    with pytest.raises(FormatError, match="NAME=left_knee"):
        formats.read(file)
    told = Options(height=1.6, rate_hz=25.0, mapping={"Gelenk": "left_knee"})
    m = motion(file, told)
    assert m.rate_hz == 25.0 and m.skeleton.stature == pytest.approx(1.6, abs=1e-9)
    assert motion(file, Options(mapping=told.mapping)).rate_hz == 30.0


@pytest.mark.parametrize("rate_hz", [24.0, 30000 / 1001, 60.0, 59.94, 100.0, 120.0, 240.0])
def test_rounded_frame_times_name_the_rate(tmp_path: Path, rate_hz: float) -> None:
    """Tools write 0.0333333 or 0.008333; the rate is the one that rounds to it."""
    file = tmp_path / "m.bvh"
    text = files.bvh_text(rate_hz=rate_hz)
    file.write_text(text.replace(f"{1 / rate_hz:.9f}", f"{1 / rate_hz:.7f}"))
    assert motion(file).rate_hz == pytest.approx(rate_hz, rel=2e-5)


def a_file(change: Callable[[str], str]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        text = files.bvh_text(path=np.tile([0.5, 0.9, 0.25], (5, 1)))
        changed = change(text)
        assert changed != text
        (folder / "x.bvh").write_text(changed)
        return folder / "x.bvh"

    return make


def swap(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


def last_number(new: str) -> Callable[[str], str]:
    return lambda s: s.rstrip()[:-1].rstrip() + f" {new}\n"


BROKEN: dict[str, tuple[Callable[[str], str], str]] = {
    "cut in the hierarchy": (lambda s: s[:500], "no line MOTION"),
    "cut in the numbers": (lambda s: s[: int(0.9 * len(s))], r"found \d+ (numbers|frames), expected"),
    "a frame missing": (swap("Frames: 5", "Frames: 7"), "found 5 frames, expected 7"),
    "no frames": (lambda s: s[: s.index("Frames:")] + "Frames: 0\nFrame Time: 0.1\n", "0"),
    "billions of frames": (swap("Frames: 5", "Frames: 99999999999"), "expected 99999999999"),
    "negative frames": (swap("Frames: 5", "Frames: -5"), "-5"),
    "frames are words": (swap("Frames: 5", "Frames: many"), "many"),
    "zero frame time": (swap("Frame Time: 0.016666667", "Frame Time: 0.0"), "(?i)frame time"),
    "negative frame time": (swap("Frame Time: 0.016666667", "Frame Time: -1"), "(?i)frame time"),
    "nan frame time": (swap("Frame Time: 0.016666667", "Frame Time: nan"), "(?i)frame time"),
    "tiny frame time": (swap("Frame Time: 0.016666667", "Frame Time: 1e-300"), "(?i)frame time"),
    "nan": (last_number("nan"), "frame 4, joint .*: found a value that is not finite"),
    "inf": (last_number("inf"), "not finite"),
    "huge": (last_number("1e300"), r"found the value 1e\+300"),
    "a word": (last_number("abc"), "'abc' where a number was expected"),
    "channels too many": (swap("CHANNELS 3", "CHANNELS 4"), "line 10: .*channel .joint. unknown"),
    "huge channel count": (swap("CHANNELS 3", "CHANNELS 999999999"), "line 9: found .999999999"),
    "channel unknown": (swap("CHANNELS 3 Zrotation", "CHANNELS 3 Qrotation"), "(?i)qrotation"),
    "channel twice": (swap("Zposition Zr", "Xposition Zr"), "a channel occurs twice"),
    "offset is a word": (swap("OFFSET 0 0 0", "OFFSET 0 x 0"), "'x'"),
    "offset is nan": (swap("OFFSET 0 0 0", "OFFSET 0 nan 0"), "line 4: found .nan."),
    "brace missing": (swap("}\nMOTION", "MOTION"), "closing braces are missing"),
    "brace too many": (swap("MOTION", "}\nMOTION"), "without a"),
    "no root": (swap("ROOT", "BONE"), "found .BONE. where ROOT"),
    "no legs": (lambda s: s.replace("Knee", "Foo"), "NAME=left_knee,NAME=right_knee"),
    "a body of no size": (
        lambda s: "\n".join("OFFSET 0 0 0" if "OFFSET" in r else r for r in s.split("\n")),
        "left and right hip lie on each other",
    ),
    "empty": (lambda s: "", "no line MOTION"),
    "garbage": (lambda s: "\x00\xff garbage" * 100, "no line MOTION"),
    "head alone": (lambda s: "HIERARCHY\nMOTION\nFrames: 1\nFrame Time: 0.1\n", "no ROOT"),
}  # fmt: skip


CASES: broken.Cases = {name: (a_file(change), said) for name, (change, said) in BROKEN.items()}


@pytest.mark.parametrize("case", CASES)
def test_broken_files(tmp_path: Path, case: str) -> None:
    make, message = CASES[case]
    broken.must_fail(make(tmp_path), bvh.FORMAT, message)


def test_deep_nesting_is_no_recursion(tmp_path: Path) -> None:
    """A chain of 20,000 joints is read or refused, and takes neither the stack nor minutes."""
    n = 20_000
    chain = "".join(f"JOINT j{i}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for i in range(n))
    text = f"HIERARCHY\nROOT r\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n{chain}" + "}\n" * (n + 1)
    text += "MOTION\nFrames: 1\nFrame Time: 0.1\n" + "0 " * (n + 1) + "\n"
    (tmp_path / "x.bvh").write_text(text)
    broken.must_fail(tmp_path / "x.bvh", bvh.FORMAT)


def same_motion(a: Motion, b: Motion) -> bool:
    apart = ori.angle_between(a.R_parent_joint, b.R_parent_joint).max()
    return bool(apart < 1e-9 and np.abs(a.p_world_root - b.p_world_root).max() < 1e-9)


def written(folder: Path, rng: np.random.Generator) -> tuple[str, Motion]:
    """A file's text, and what it holds."""
    text = files.bvh_text(angles=rng.normal(0, 15, (6, 24, 3)), rate_hz=60.0)
    (folder / "plain.bvh").write_text(text)
    return text, motion(folder / "plain.bvh")


@pytest.mark.parametrize("count", [5, 7])
def test_a_frame_count_that_is_one_off(
    tmp_path: Path, rng: np.random.Generator, count: int
) -> None:
    text, want = written(tmp_path, rng)
    (tmp_path / "x.bvh").write_text(swap("Frames: 6", f"Frames: {count}")(text))
    doc = formats.read(tmp_path / "x.bvh")
    assert isinstance(doc.content, Motion) and same_motion(doc.content, want)
    assert any(f"holds 6 frames, its 'Frames:' line says {count}" in w for w in doc.warnings)


@pytest.mark.parametrize("per_line", [1, 7, 1000])
def test_numbers_count_not_lines(tmp_path: Path, rng: np.random.Generator, per_line: int) -> None:
    text, want = written(tmp_path, rng)
    at = text.index("\n", text.index("Frame Time")) + 1
    numbers = text[at:].split()
    lines = [" ".join(numbers[k : k + per_line]) for k in range(0, len(numbers), per_line)]
    (tmp_path / "x.bvh").write_text(text[:at] + "\n".join(lines) + "\n")
    assert same_motion(motion(tmp_path / "x.bvh"), want)


def test_positions_that_were_never_filled_in_are_not_meant(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Six channels on every joint, all positions below the root zero: the OFFSETs hold, and it is said."""
    text, want = written(tmp_path, rng)
    six = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    head, at, numbers = text.partition("Frame Time")
    first, *rows = numbers.strip().split("\n")
    padded = []
    for row in rows:
        cells = row.split()
        joints = [cells[k : k + 3] for k in range(6, len(cells), 3)]
        padded.append(" ".join([*cells[:6], *(x for j in joints for x in ("0", "0", "0", *j))]))
    head = head.replace("CHANNELS 3 Zrotation Xrotation Yrotation", six)
    (tmp_path / "x.bvh").write_text(head + at + first + "\n" + "\n".join(padded) + "\n")
    doc = formats.read(tmp_path / "x.bvh")
    assert isinstance(doc.content, Motion) and same_motion(doc.content, want)
    assert any("are all zero, so their OFFSETs hold" in a for a in doc.assumptions)


@pytest.mark.parametrize(
    ("time", "rate_hz", "said"),
    [
        ("33.3333", 30.0, "read as milliseconds: 30 Hz"),
        ("16.67", 60.0, "read as milliseconds: 60 Hz"),
        ("8", 125.0, "read as milliseconds: 125 Hz"),
        ("0.0167", 60.0, "0.0167 is 60 Hz"),
        ("0.016", 60.0, "0.016 is 60 Hz"),
        ("0.0166", 60.0, "0.0166 is 60 Hz"),
        ("0.008", 125.0, ""),
        ("0.0083", 120.0, "0.0083 is 120 Hz"),
        ("0.033", 30.0, "0.033 is 30 Hz"),
        ("0.033367", 30000 / 1001, ""),
        ("0.01", 100.0, ""),
        ("0.0123", 1 / 0.0123, ""),
    ],
)
def test_frame_times_with_few_digits(tmp_path: Path, time: str, rate_hz: float, said: str) -> None:
    text = files.bvh_text(rate_hz=60.0)
    (tmp_path / "x.bvh").write_text(swap("Frame Time: 0.016666667", f"Frame Time: {time}")(text))
    doc = formats.read(tmp_path / "x.bvh")
    assert doc.content.rate_hz == pytest.approx(rate_hz, rel=1e-9)
    told = [a for a in doc.assumptions if "Frame Time" in a]
    assert bool(told) == bool(said) and all(said in a for a in told)
