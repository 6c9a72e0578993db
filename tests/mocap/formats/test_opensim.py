"""OpenSim's tables: axes and rows by OpenSim's rules, and what our own reader makes of them."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap import orientation as ori
from mocap.formats import opensim, read
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.skeleton import JOINTS, Skeleton
from mocap.stances import pose_bones
from mocap.synthesis import motions

TO_OPENSIM = Rotation.from_euler("x", -90, degrees=True).as_matrix()


@pytest.fixture(scope="module")
def motion() -> Motion:
    return motions.walk(3.0, rate_hz=50.0).on(Skeleton.default(1.8))


def standing() -> Motion:
    body = Skeleton.default()
    R = body.local_rotations(pose_bones(np.arange(24), "n", 90.0))
    return Motion(60.0, R[None], np.zeros((1, 3)), body)


def test_a_person_who_stands_has_the_axes_of_opensim_s_models() -> None:
    names, R = opensim.segments(standing())
    np.testing.assert_allclose(TO_OPENSIM @ R[0], np.tile(np.eye(3), (len(names), 1, 1)), atol=1e-9)


def test_a_step_forward_turns_the_thigh_about_opensim_s_z() -> None:
    """Hip flexion is positive about z (to the right) in OpenSim's models."""
    still = standing()
    R = np.array(still.R_parent_joint)
    R[0, JOINTS.index("right_hip")] = ori.rot_x(np.radians(-30))  # the knee goes forward
    names, bodies = opensim.segments(Motion(60.0, R, still.p_world_root, still.skeleton))
    thigh = TO_OPENSIM @ bodies[0, names.index("femur_r")]
    np.testing.assert_allclose(np.degrees(ori.log(thigh)), [0, 0, 30], atol=1e-6)


def test_orientations_read_back(motion: Motion, tmp_path: Path) -> None:
    path = tmp_path / "walk.sto"
    opensim.write_orientations(path, motion)
    raw = read(path).content
    assert isinstance(raw, RawRecording) and raw.rate_hz == pytest.approx(50.0)
    assert {"pelvis", "sternum", "left_shank", "right_hand", "head"} <= set(raw.sensors)
    k = raw.sensors.index("left_shank")
    assert raw.R_world_sensor is not None
    # The sensor is fixed on its bone, whatever its axes and heading are.
    turned = np.swapaxes(raw.R_world_sensor[:-1, k], -1, -2) @ raw.R_world_sensor[1:, k]
    bone = motion.R_world_joint[:, JOINTS.index("left_knee")]
    ours = np.swapaxes(bone[:-1], -1, -2) @ bone[1:]
    np.testing.assert_allclose(ori.angle(turned), ori.angle(ours), atol=1e-6)


def test_markers_in_opensim_s_ground(motion: Motion, tmp_path: Path) -> None:
    path = tmp_path / "walk.trc"
    opensim.write_markers(path, motion)
    lines = path.read_text().splitlines()
    rate, _, frames, count, unit, *_ = lines[2].split("\t")
    names = lines[3].split("\t")[2::3]
    table = np.array([[float(x) for x in line.split("\t")] for line in lines[6:]])
    assert (float(rate), int(frames), int(count), unit) == (50.0, len(motion), len(names), "mm")
    np.testing.assert_allclose(table[:, 1], np.arange(len(motion)) / 50, atol=1e-9)
    p = table[:, 2:].reshape(len(motion), len(names), 3) / 1000
    elbow = p[:, names.index("left_elbow")]
    ours = motion.p_world_joint[:, JOINTS.index("left_elbow")]
    np.testing.assert_allclose(
        elbow, np.stack([ours[:, 2], ours[:, 1], -ours[:, 0]], -1), atol=1e-6
    )
    # The walk goes ahead, along OpenSim's x; its right is +z.
    assert p[-1, names.index("RASI"), 0] > p[0, names.index("RASI"), 0] + 0.5
    assert p[0, names.index("RKNE"), 2] > p[0, names.index("LKNE"), 2] + 0.1


def test_markers_keep_their_distance_on_a_bone(motion: Motion) -> None:
    names, p = opensim.markers(motion)
    for a, b in (("LASI", "RASI"), ("LTHI", "left_knee"), ("RWRA", "RELB"), ("LFHD", "RBHD")):
        apart = np.linalg.norm(p[:, names.index(a)] - p[:, names.index(b)], axis=-1)
        assert np.ptp(apart) < 1e-9
        assert 0.05 < apart[0] < 0.45


READ = """
import json, sys
import opensim
sto, trc = opensim.TimeSeriesTableQuaternion(sys.argv[1]), opensim.TimeSeriesTableVec3(sys.argv[2])
row = sto.getRowAtIndex(40)
quats = {n: [row.getElt(0, k).get(i) for i in range(4)] for k, n in enumerate(sto.getColumnLabels())}
row = trc.getRowAtIndex(40)
places = {n: [row.getElt(0, k).get(i) for i in range(3)] for k, n in enumerate(trc.getColumnLabels())}
times = [list(t.getIndependentColumn())[40] for t in (sto, trc)]
unit = trc.getTableMetaDataString("Units")
print(json.dumps([times, quats, places, unit, sto.getNumRows(), trc.getNumRows()]))
"""
needs_opensim = pytest.mark.skipif(
    importlib.util.find_spec("opensim") is None, reason="OpenSim's wheel is not installed"
)


@needs_opensim
def test_opensim_reads_both_tables(motion: Motion, tmp_path: Path) -> None:
    """In a process of its own, which OpenSim's libraries share with none of ours."""
    sto, trc = tmp_path / "m.sto", tmp_path / "m.trc"
    opensim.write_orientations(sto, motion)
    opensim.write_markers(trc, motion)
    line = [sys.executable, "-c", READ, str(sto), str(trc)]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    times, quats, places, unit, *rows = json.loads(done.stdout.splitlines()[-1])
    np.testing.assert_allclose(times, 40 / 50, atol=1e-9)
    assert (unit, rows) == ("mm", [len(motion)] * 2)
    bodies, R = opensim.segments(motion)
    assert list(quats) == [f"{b}_imu" for b in bodies]
    np.testing.assert_allclose(ori.from_quat(np.array(list(quats.values()))), R[40], atol=1e-6)
    names, p = opensim.markers(motion)
    assert list(places) == list(names)
    np.testing.assert_allclose(np.array(list(places.values())) / 1000, p[40], atol=1e-6)
