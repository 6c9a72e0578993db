"""Joints of foreign skeletons by name: every tool's spelling gives the same pose as the plain one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Options, _joint_names
from mocap.motion import Motion
from tests.mocap.formats import motion_files as files

LIMBS = ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
# Stems in the order of LIMBS, and how a tool puts side and stem together; then its neck and head.
TOOLS: dict[str, tuple[str, Callable[[str, str], str], tuple[str, str]]] = {
    "actor's prefix": (
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
        lambda side, stem: f"Actor01_{side.capitalize()}{stem}",
        ("Neck", "Head"),
    ),
    "namespace": (
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
        lambda side, stem: f"mixamorig7:{side.capitalize()}{stem}",
        ("mixamorig7:Neck", "mixamorig7:Head"),
    ),
    "Reallusion": (
        "Clavicle Upperarm Forearm Hand Thigh Calf Foot ToeBase",
        lambda side, stem: f"CC_Base_{side[0].upper()}_{stem}",
        ("CC_Base_NeckTwist01", "CC_Base_Head"),
    ),
    "rigify": (
        "shoulder upper_arm forearm hand thigh shin foot toe",
        lambda side, stem: f"ORG-{stem}.{side[0].upper()}",
        ("Neck", "Head"),
    ),
    "OptiTrack": (
        "Shoulder UArm FArm Hand Thigh Shin Foot Toe",
        lambda side, stem: f"Skeleton_{side[0].upper()}{stem}",
        ("Skeleton_Neck", "Skeleton_Head"),
    ),
    "SMPL": (
        "collar shoulder elbow wrist hip knee ankle foot",
        lambda side, stem: f"m_avg_{side[0].upper()}_{stem}",
        ("Neck", "Head"),
    ),
    "a suffix": (
        "shoulder arm forearm hand upleg leg foot toebase",
        lambda side, stem: f"{side[0]}{stem}_JNT",
        ("neck_JNT", "head_JNT"),
    ),
    "Theia": (
        "clavicle uarm larm hand thigh shank foot toes",
        lambda side, stem: f"{side[0]}_{stem}",
        ("neck", "head"),
    ),
    "Japanese": (
        "肩 腕 ひじ 手首 足 ひざ 足首 つま先",
        lambda side, stem: f"{'左' if side == 'left' else '右'}{stem}",
        ("首", "頭"),
    ),
    "side last": (
        "Clavicle UpperArm LowerArm Hand Thigh Calf Foot Ball",
        lambda side, stem: f"{stem}_{side[0]}",
        ("neck_01", "head"),
    ),
    "capitals": (
        "SHOULDER UPPER_ARM LOWER_ARM HAND UPPER_LEG LOWER_LEG FOOT TOE",
        lambda side, stem: f"{side.upper()}_{stem}",
        ("NECK", "HEAD"),
    ),
    "VRM": (
        "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot ToeBase",
        lambda side, stem: f"J_Bip_{side[0].upper()}_{stem}",
        ("J_Bip_C_Neck", "J_Bip_C_Head"),
    ),
    "Biped": (
        "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0",
        lambda side, stem: f"Bip01 {side[0].upper()} {stem}",
        ("Bip01 Neck", "Bip01 Head"),
    ),
}  # fmt: skip


def renamed(tool: str, text: str) -> str:
    """A file of Xsens' names under a tool's."""
    stems, style, (neck, head) = TOOLS[tool]
    for side in ("left", "right"):
        for ours, stem in zip(LIMBS, stems.split(), strict=True):
            old = f"JOINT {side.capitalize()}{files.XSENS[ours]}\n"
            assert old in text
            text = text.replace(old, f"JOINT {style(side, stem)}\n")
    return text.replace("JOINT Neck\n", f"JOINT {neck}\n").replace(
        "JOINT Head\n", f"JOINT {head}\n"
    )


@pytest.fixture
def plain(rng: np.random.Generator) -> str:
    return files.bvh_text(angles=rng.normal(0, 15, (12, 24, 3)))


def motion(path: Path, text: str, options: Options | None = None) -> Motion:
    path.write_text(text, encoding="utf-8")
    content = formats.read(path, options).content
    assert isinstance(content, Motion)
    return content


@pytest.mark.parametrize("tool", TOOLS)
def test_every_spelling_is_the_same_pose(tmp_path: Path, plain: str, tool: str) -> None:
    want = motion(tmp_path / "plain.bvh", plain)
    text = renamed(tool, plain)
    got = motion(tmp_path / "tool.bvh", text)
    assert ori.angle_between(got.R_parent_joint, want.R_parent_joint).max() < 1e-9
    told = [s for s in formats.read(tmp_path / "tool.bvh").assumptions if "by their names" in s]
    stems, style, _ = TOOLS[tool]
    assert len(told) == 1 and f"{style('left', stems.split()[5])} is left_knee" in told[0]


@pytest.mark.parametrize("tool", TOOLS)
def test_fingers_do_not_make_hands_a_shared_word(tmp_path: Path, plain: str, tool: str) -> None:
    """A hand with fingers, whose names all begin alike, leaves the limbs what they are."""
    stems, style, _ = TOOLS[tool]
    names = [style(side, s) for side in ("left", "right") for s in stems.split()]
    fingers = [
        style(side, f"Hand{finger}{k}")
        for side in ("left", "right")
        for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky")
        for k in (1, 2, 3, 4)
    ]
    found = _joint_names.match([*names, *fingers])
    for k, (side, joint) in enumerate((s, j) for s in ("left", "right") for j in LIMBS):
        assert found[f"{side}_{joint}"] == k


def test_what_is_not_recognised_shows_the_line_to_write(tmp_path: Path, plain: str) -> None:
    text = plain.replace("JOINT LeftKnee\n", "JOINT gauche\n").replace(
        "JOINT RightElbow\n", "JOINT droit\n"
    )
    (tmp_path / "x.bvh").write_text(text)
    with pytest.raises(FormatError) as caught:
        formats.read(tmp_path / "x.bvh")
    said = str(caught.value)
    assert "--map 'NAME=left_knee,NAME=right_elbow'" in said
    assert "gauche" in said and "droit" in said
    told = Options(mapping={"gauche": "left_knee", "droit": "right_elbow"})
    got = motion(tmp_path / "x.bvh", text, told)
    want = motion(tmp_path / "plain.bvh", plain)
    assert ori.angle_between(got.R_parent_joint, want.R_parent_joint).max() < 1e-9


def test_only_names_that_are_used_must_be_unique(tmp_path: Path, plain: str) -> None:
    helper = "JOINT X\n{\nOFFSET 0 1 0\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n"
    text = plain.replace("JOINT LeftKnee\n", f"{helper}{helper}JOINT LeftKnee\n")
    got, want = motion(tmp_path / "x.bvh", text), motion(tmp_path / "plain.bvh", plain)
    assert ori.angle_between(got.R_parent_joint, want.R_parent_joint).max() < 1e-9
    (tmp_path / "x.bvh").write_text(text.replace("JOINT X\n", "JOINT LeftKnee\n"))
    with pytest.raises(FormatError, match="'LeftKnee' occurs more than once; left_knee needs one"):
        formats.read(tmp_path / "x.bvh")
