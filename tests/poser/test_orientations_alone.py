"""Files that hold orientations and no accelerations, from the file to poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.formats import native
from mocap.recording import RawRecording
from poser.__main__ import main
from tests.mocap.formats import recording_files as made

Answer = Callable[..., Any]

BODIES = {
    "sternum": "torso_imu", "pelvis": "pelvis_imu", "head": "head_imu",
    **{
        f"{side}_{place}": f"{body}_{side[0]}_imu"
        for side in ("left", "right")
        for place, body in (
            ("thigh", "femur"), ("shank", "tibia"), ("foot", "calcn"), ("forearm", "radius"),
        )
    },
}  # fmt: skip


def sto(path: Path, raw: RawRecording) -> Path:
    """The orientations of a recording as OpenSense writes them."""
    assert raw.R_world_sensor is not None
    quats = ori.to_quat(ori.R_ZUP_YUP @ raw.R_world_sensor)
    lines = ["DataType=Quaternion", "version=3", "OpenSimVersion=4.1", "endheader"]
    lines.append("\t".join(["time", *(BODIES[n] for n in raw.sensors)]))
    for t, row in enumerate(quats):
        cells = (",".join(f"{v:.9g}" for v in q) for q in row)
        lines.append("\t".join([f"{t / raw.rate_hz:.6f}", *cells]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_from_a_table_of_our_own_to_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    six = ("pelvis", "head", "left_forearm", "right_forearm", "left_shank", "right_shank")
    moving = replace(made.motion(T=300), rate_hz=30.0).resampled(60.0).slice(0, 240)
    from mocap import synthesis

    path = sto(tmp_path / "take.sto", synthesis.raw_recording(moving, six, rng=3))
    rec, poses = tmp_path / "rec.npz", tmp_path / "poses.npz"
    assert main(["calibrate", str(path), "-o", str(rec), "--pose", "t", "--facing", "0"]) == 0
    said = capsys.readouterr().out
    assert said.count("poses rest on orientations alone") == 1
    assert not native.read_recording(rec).acc_valid.any()

    assert main(["solve", str(rec), "-o", str(poses), "--to", "1.5"]) == 0
    assert "so this is SOP" in capsys.readouterr().out
    found = formats.read(poses).content
    hips = np.degrees(ori.angle_between(found.R_world_joint[-1, 0], moving.R_world_joint[89, 0]))  # type: ignore[union-attr]
    assert hips < 10

    assert main(["track", str(rec), "-o", str(poses), "--method", "hybrid", "--to", "0.5"]) == 0
    assert len(formats.read(poses).content) == 30


def test_a_real_take_faces_as_with_its_accelerations(
    tmp_path: Path, shared: Path, answer: Answer
) -> None:
    """OpenSense's example: what its sensors' accelerations are left out of is calibrated alike."""
    raw = formats.read(shared / "data" / "opensense").content
    assert isinstance(raw, RawRecording)
    raw = raw.slice(0, 1500)
    native.write_raw(tmp_path / "whole.npz", raw)
    sto(tmp_path / "take.sto", raw)
    answer("calibrate", tmp_path / "whole.npz", "-o", tmp_path / "a.npz")
    found = answer("calibrate", tmp_path / "take.sto", "-o", tmp_path / "b.npz")
    assert {f["code"] for f in found["diagnostics"]} == {"no-acc"}
    a, b = (native.read_recording(tmp_path / f"{n}.npz") for n in "ab")
    b = b.select(a.sensors)
    both = a.ori_valid & b.ori_valid
    apart = np.degrees(ori.angle_between(a.R_world_bone[both], b.R_world_bone[both]))
    assert both.mean() > 0.95
    assert apart.mean() < 3
