"""Broken files through the command line: exit 1, one sentence on stderr, nothing written, nothing run.

The files are those of `tests/mocap/test_broken_table.py`, every cell of it that is damage.
"""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

MOCAP_TESTS = Path(__file__).parents[1] / "mocap"
sys.path.insert(0, str(MOCAP_TESTS))
table: Any = importlib.import_module("test_broken_table")
files: Any = importlib.import_module("recording_files")

Refusal = Callable[..., tuple[int, str]]
RAW = ("native raw recording", "TotalCapture, uncalibrated", "qmt", "OpenSense", "Xsens MTw", "CSV",
       "CSV folder")  # fmt: skip
MOTIONS = ("AMASS, and native motions", "BVH", "ASF/AMC")


def commands(row: str, path: Path, out: Path) -> list[tuple[str | Path, ...]]:
    """`poser` commands that read a file of this row, the last one as it would be used."""
    use: tuple[str | Path, ...] = ("solve", path, "-o", out / "m.npz", "--solver", "banded")
    if row in RAW:
        use = ("calibrate", path, "-o", out / "rec.npz", "--no-strict")
    if row in MOTIONS:
        use = ("synthesize", path, "-o", out)
    return [("info", path), ("convert", path, out / "c.npz"), use]


def _cells() -> list[Any]:
    return [
        pytest.param(row, cell, id=f"{row}: {damage}")
        for row, (_, _, cells) in table.TABLE.items()
        for damage, cell in zip(table.DAMAGE, cells, strict=True)
        if isinstance(cell, str)
    ]


def _listing(folder: Path) -> set[Path]:
    return {p for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(("row", "case"), _cells())
def test_one_sentence_and_nothing_written(
    row: str, case: str, tmp_path: Path, refusal: Refusal
) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    out.mkdir()
    path = table.TABLE[row][1][case][0](source)
    before = _listing(source)
    for words in commands(row, path, out):
        status, sentence = refusal(*words)
        assert status == 1, (words, sentence)
        # The error may be in a file beside or inside it.
        assert str(source) in sentence
        assert "a fault of the program" not in sentence
        assert len(sentence) - len(str(path)) < 450, sentence
        assert list(out.iterdir()) == []
        assert _listing(source) == before
    assert not (source / "executed").exists()


@pytest.mark.parametrize("suffix", [".pkl", ".npz", ".npy", ".mat", ".bvh", ".csv", ".sto", ".pt"])
def test_a_bare_malicious_pickle(suffix: str, tmp_path: Path, refusal: Refusal) -> None:
    """Whatever its name says, it is not loaded."""
    path = tmp_path / f"evil{suffix}"
    path.write_bytes(pickle.dumps(files.Evil(tmp_path / "executed")))
    for words in (("info", path), ("convert", path, tmp_path / "c.npz")):
        assert refusal(*words)[0] == 1
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
def test_a_malicious_body(suffix: str, folder: Path, tmp_path: Path, refusal: Refusal) -> None:
    """--smpl reads pickles of the user's: nothing in one is run, nor in an array that is one."""
    path = tmp_path / f"body{suffix}"
    evil = files.Evil(tmp_path / "executed")
    if suffix == ".pkl":
        path.write_bytes(pickle.dumps({"v_template": evil}, protocol=2))
    else:
        np.savez(path, v_template=files.objects([evil]))
    status, sentence = refusal("info", folder / "walk.npz", "--smpl", path)
    assert status == 1 and str(path) in sentence
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_broken_start(folder: Path, tmp_path: Path, refusal: Refusal) -> None:
    """The second file that `solve` reads."""
    start = tmp_path / "start.npz"
    start.write_bytes((folder / "walk.npz").read_bytes()[:2000])
    out = tmp_path / "m.npz"
    words = ("solve", folder / "rec" / "walk.npz", "-o", out, "--start", start)
    status, sentence = refusal(*words)
    assert status == 1 and str(start) in sentence and "cut short" in sentence
    assert [p.name for p in tmp_path.iterdir()] == ["start.npz"]


@pytest.mark.parametrize(("row", "case"), [("native recording", "cut"), ("DIP-IMU", "malicious")])
def test_as_a_process(row: str, case: str, tmp_path: Path) -> None:
    """The same with real streams and a real exit status."""
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    out.mkdir()
    path = table.TABLE[row][1][case][0](source)
    line = [sys.executable, "-m", "poser", "convert", str(path), str(out / "c.npz")]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"poser convert: {path}") and done.stderr.count("\n") == 1
    assert list(out.iterdir()) == [] and not (source / "executed").exists()
