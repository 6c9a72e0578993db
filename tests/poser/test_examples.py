"""The examples run alone, as a user runs them."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.skeleton import JOINTS
from mocap.synthesis import motions

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


RUN = [
    ("synthesize_and_solve", 3, "SIP: "),
    ("calibrate_raw", 11, "the same"),
    ("fewer_sensors", 3, "pelvis alone"),
    ("live_loop", 1, "60 poses"),
    ("own_term", 2, "with goniometers: knees 1."),
    ("compare_methods", 2, "nearest pose"),
    ("own_placement", 3, "telling the seats is worth 0."),
    ("own_estimator", 3, "hybrid around them, 2 of 180 frames: no sensor measured"),
]


@pytest.mark.parametrize(("name", "seconds", "said"), RUN)
def test_example(name: str, seconds: int, said: str, tmp_path: Path) -> None:
    line = [sys.executable, str(EXAMPLES / f"{name}.py"), "--seconds", str(seconds)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seconds", ["5", "-1"])
def test_too_short_a_motion_to_calibrate_is_told_in_one_sentence(seconds: str) -> None:
    line = [sys.executable, str(EXAMPLES / "calibrate_raw.py"), f"--seconds={seconds}"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (2, "")
    *usage, sentence = done.stderr.splitlines()
    assert usage[0].startswith("usage: ") and len(usage) == 1
    assert f"--seconds {seconds} is too short: the pose and the walk take 8 s" in sentence


def test_the_shortest_motion_to_calibrate_is_long_enough() -> None:
    line = [sys.executable, str(EXAMPLES / "calibrate_raw.py"), "--seconds=8"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    assert "facing: hinge of the shank" in done.stdout  # it was the walk that told


def test_every_example_is_tested() -> None:
    names = {p.stem for p in EXAMPLES.glob("*.py")}
    assert names == {name for name, *_ in RUN} | {
        "send_udp",
        "slimevr_set",
        "opensim_ik",
    }  # in live/test_sender.py, test_quickstart.py, below


@pytest.mark.skipif(
    importlib.util.find_spec("opensim") is None, reason="OpenSim's wheel is not here"
)
def test_opensim_finds_the_angles_of_the_walk(tmp_path: Path) -> None:
    """By IMUs and by markers: the knees bend as they did, to within 1 deg."""
    line = [sys.executable, str(EXAMPLES / "opensim_ik.py"), "-o", str(tmp_path)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    walk = motions.walk(3.0)
    knee = np.rad2deg(ori.angle(walk.R_parent_joint[:, JOINTS.index("left_knee")]))
    for name in ("ik_motion.mot", "ik_motion_markers.mot"):
        head, _, rows = (tmp_path / name).read_text().partition("endheader\n")
        names, *values = rows.splitlines()
        assert "inDegrees=yes" in head
        found = np.array([line.split() for line in values], float)[
            :, names.split().index("left_knee_rz")
        ]
        np.testing.assert_allclose(-found, knee, atol=1.0)
