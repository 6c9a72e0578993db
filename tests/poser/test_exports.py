"""poser convert to other tools' files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import body
from mocap.formats import _bvh_profiles, amass, read
from mocap.motion import Motion
from mocap.synthesis import motions
from poser import exports
from poser.__main__ import main


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    path = tmp_path / "walk.npz"
    amass.write_motion(path, motions.walk(3.0, rate_hz=30.0))
    return path


def test_the_parser_offers_what_the_library_has() -> None:
    assert exports.LOOKS == body.LOOKS
    assert (exports.PROFILES, exports.RESTS) == (_bvh_profiles.PROFILES, _bvh_profiles.RESTS)


def test_the_parser_needs_no_numpy() -> None:
    code = "import sys; from poser.__main__ import parser; parser(); print('numpy' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"


@pytest.mark.parametrize("suffix", exports.WRITERS)
def test_every_suffix_is_written(
    suffix: str, walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = walk.with_suffix(suffix)
    assert main(["convert", str(walk), str(out)]) == 0
    assert "motion, 90 frames at 30 Hz" in capsys.readouterr().out
    assert out.stat().st_size > 10_000
    assert {p.name for p in out.parent.iterdir()} == {"walk.npz", out.name}


@pytest.mark.parametrize("suffix", exports.WRITERS)
def test_solve_and_track_write_it_directly(suffix: str, folder: Path, tmp_path: Path) -> None:
    """A solution as a file for other tools is what poser convert makes of its .npz."""
    rec, own, other = str(folder / "rec" / "walk.npz"), tmp_path / "m.npz", tmp_path / f"x{suffix}"
    direct = tmp_path / f"m{suffix}"
    words = ["solve", rec, "--solver", "banded", "--terms", "sop", "-o"]
    assert main([*words, str(own)]) == main([*words, str(direct)]) == 0
    assert main(["convert", str(own), str(other)]) == 0
    assert abs(direct.stat().st_size - other.stat().st_size) < 0.01 * other.stat().st_size
    words = ["track", rec, "--method", "imuposer", "-o", str(tmp_path / f"t{suffix}")]
    assert main(words) == 0
    assert (tmp_path / f"t{suffix}").stat().st_size > 10_000


def test_uncertainty_goes_into_npz_alone(folder: Path, tmp_path: Path, refusal: Any) -> None:
    for words in (("solve",), ("track", "--method", "hybrid")):
        command, *more = words
        line = (
            command,
            folder / "rec" / "walk.npz",
            *more,
            "-o",
            tmp_path / "m.glb",
            "--uncertainty",
        )
        status, sentence = refusal(*line)
        assert status == 2 and "a .glb file cannot hold it" in sentence


def test_a_profile_is_written_and_read(walk: Path) -> None:
    out = walk.with_suffix(".bvh")
    assert main(["convert", str(walk), str(out), "--profile", "unity", "--rest", "a"]) == 0
    assert "JOINT LeftUpperArm" in out.read_text()
    motion = read(out).content
    assert isinstance(motion, Motion)
    ours = motions.walk(3.0, rate_hz=30.0)
    np.testing.assert_allclose(motion.p_world_joint, ours.p_world_joint, atol=1e-5)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["w.glb", "--rest", "a"], "--rest: is for .bvh files"),
        (["w.bvh", "--body", "mesh"], "--body: is for .glb files"),
        (["w.glb", "--body", "smpl"], "needs --smpl FILE"),
        (["w.fbx"], ".npz or .bvh or .glb"),
    ],
)
def test_what_does_not_fit_is_refused(
    words: list[str], said: str, walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, *options = words
    assert main(["convert", str(walk), str(walk.parent / name), *options]) == 2
    assert said in capsys.readouterr().err
