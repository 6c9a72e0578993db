"""Broken files through the command line: exit 1, one sentence on stderr, nothing written, nothing run.

The files are those of `tests/mocap/test_broken_table.py`, every cell of it that is damage.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from mocap.formats.amass import write_motion
from tests.mocap.formats import recording_files as files
from tests.mocap.formats import test_broken_table as table

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


@pytest.mark.timeout(60)
@pytest.mark.parametrize("suffix", [".npz", ".mat", ".pkl", ".bvh", ".amc", ".csv", ".mvnx", ".pt"])
def test_a_pipe(suffix: str, tmp_path: Path, refusal: Refusal) -> None:
    """Refused before it is opened, which would wait for whoever writes into it."""
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    for words in (("info", path), ("convert", path, tmp_path / "c.npz")):
        status, sentence = refusal(*words)
        assert status == 1 and f"{path}: is a pipe" in sentence


@pytest.mark.timeout(60)
def test_a_pipe_as_calibration(tmp_path: Path, refusal: Refusal) -> None:
    path = tmp_path / "pipe.json"
    os.mkfifo(path)
    status, sentence = refusal(
        "live", "--source", "udp:9123", "--method", "dip", "--calibration", path
    )
    assert status == 1 and f"{path}: is a pipe" in sentence


@pytest.mark.timeout(60)
def test_a_device(refusal: Refusal, tmp_path: Path) -> None:
    """One that never ends, under a name that has a format."""
    path = tmp_path / "zero.mat"
    path.symlink_to("/dev/zero")
    assert "is a pipe, a socket or a device" in refusal("info", path)[1]


def _csv_folder(folder: Path) -> tuple[Path, Path, list[str]]:
    os.mkfifo(folder / "pelvis.csv")
    return folder, folder / "pelvis.csv", []


def _body(folder: Path) -> tuple[Path, Path, list[str]]:
    os.mkfifo(folder / "body.npz")
    return walk(folder), folder / "body.npz", ["--smpl", str(folder / "body.npz")]


def _mapping(folder: Path) -> tuple[Path, Path, list[str]]:
    os.mkfifo(folder / "map.xml")
    return files.sto(folder), folder / "map.xml", ["--map", str(folder / "map.xml")]


def walk(folder: Path) -> Path:
    """A short motion."""
    write_motion(folder / "walk.npz", files.motion())
    return folder / "walk.npz"


@pytest.mark.timeout(60)
@pytest.mark.parametrize("make", [_csv_folder, _body, _mapping])
def test_a_pipe_beside_or_inside(
    make: Callable[[Path], tuple[Path, Path, list[str]]], tmp_path: Path, refusal: Refusal
) -> None:
    path, pipe, more = make(tmp_path)
    status, sentence = refusal("info", path, *more)
    assert status == 1 and f"{pipe}: is a pipe" in sentence


def test_a_file_that_crashed_the_process(tmp_path: Path) -> None:
    """MATLAB numbers of a type that does not exist ended scipy's reader with a signal."""
    path = tmp_path / "crash.mat"
    savemat(path, {"t": np.arange(40.0)[:, None], "hip": {"acc": np.ones((40, 3))}})
    path.write_bytes(path.read_bytes().replace(b"\t\0\0\0\x40\1\0\0", b"\n\0\0\0\x40\1\0\0"))
    line = [sys.executable, "-m", "poser", "info", str(path)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    said = "not a whole MATLAB 5 file: damaged or cut short"
    assert (done.returncode, done.stderr) == (1, f"poser info: {path}: {said}\n")
