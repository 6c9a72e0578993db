"""BVH for other tools: names, rest poses, and the same motion whoever reads it."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap import orientation as ori
from mocap.formats import bvh, read
from mocap.formats._bvh_profiles import PROFILES, RESTS, Profile, Rest, names
from mocap.formats._bvh_text import parse
from mocap.motion import Motion
from mocap.skeleton import JOINTS, Skeleton
from mocap.synthesis import motions

WAYS = list(product(PROFILES, RESTS))


@pytest.fixture(scope="module")
def motion() -> Motion:
    walk = motions.walk(3.0, rate_hz=30.0).on(Skeleton.default(1.85))
    noise = ori.exp(np.random.default_rng(0).normal(0, 0.2, (24, 3)))
    return Motion(30.0, walk.R_parent_joint @ noise, walk.p_world_root, walk.skeleton)


@pytest.mark.parametrize(("profile", "rest"), WAYS)
def test_a_file_reads_back_as_it_was(
    profile: Profile, rest: Rest, motion: Motion, tmp_path: Path
) -> None:
    bvh.write_motion(tmp_path / "m.bvh", motion, profile, rest)
    back = read(tmp_path / "m.bvh").content
    assert isinstance(back, Motion)
    np.testing.assert_allclose(back.R_parent_joint, motion.R_parent_joint, atol=1e-6)
    np.testing.assert_allclose(back.p_world_joint, motion.p_world_joint, atol=1e-6)
    assert back.skeleton.stature == pytest.approx(1.85)


@pytest.mark.parametrize(("profile", "rest"), WAYS)
def test_joints_are_where_any_tool_puts_them(
    profile: Profile, rest: Rest, motion: Motion, tmp_path: Path
) -> None:
    """Position: parent's + parent's rotation times OFFSET; rotation: parent's times the channels in order."""
    path = tmp_path / "m.bvh"
    bvh.write_motion(path, motion, profile, rest)
    file = parse(path, path.read_bytes())
    values = np.loadtxt(path.read_text().split("Frame Time")[1].splitlines()[1:])
    R: list[Rotation] = []
    p: list[np.ndarray] = []
    column = 3
    for joint in file.joints:
        at = Rotation.identity()
        if joint.name:
            at = Rotation.from_euler("ZXY", values[:, column : column + 3], degrees=True)
            column += 3
        if joint.parent < 0:
            R, p = [at], [values[:, :3]]
            continue
        R.append(R[joint.parent] * at)
        p.append(p[joint.parent] + R[joint.parent].apply(joint.offset))
    for name, place in zip(file.names, p, strict=True):
        if name:
            ours = motion.p_world_joint[:, names(profile).index(name)]
            np.testing.assert_allclose(place / 100, ours, atol=1e-4)


def test_names_are_the_tools_own(motion: Motion, tmp_path: Path) -> None:
    expected = {
        "mixamo": ("left_elbow", "mixamorig:LeftForeArm"), "unity": ("right_hip", "RightUpperLeg"),
        "cmu": ("spine1", "LowerBack"), "smpl": ("spine1", "spine1"),
    }  # fmt: skip
    for profile in PROFILES:
        ours, theirs = expected[profile]
        assert names(profile)[JOINTS.index(ours)] == theirs
        assert len(set(names(profile))) == 24


def test_an_a_pose_has_its_arms_down(motion: Motion, tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    bvh.write_motion(path, motion, "mixamo", "a")
    file = parse(path, path.read_bytes())
    offset = dict(zip(file.names, (j.offset for j in file.joints), strict=True))
    for side, out in (("Left", 1), ("Right", -1)):
        arm = np.array(offset[f"mixamorig:{side}ForeArm"])
        down = np.degrees(np.arctan2(-arm[1], out * arm[0]))
        assert down == pytest.approx(45 + 3, abs=2)  # the table's arms hang 3 deg in the T-pose
