"""The command line as a process: exit status, streams, interruption, imports."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mocap import synthesis
from mocap.formats.native import write_recording
from poser import commands, motions
from poser.__main__ import main

HEAVY = ("numpy", "scipy", "casadi", "torch", "osqp", "matplotlib", "pinocchio", "vqf", "rich")


def poser(*words: object, **kwargs: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "poser", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, timeout=120, **kwargs)  # type: ignore[call-overload, no-any-return]


@pytest.mark.parametrize("name", commands.NAMES)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: poser {name}")
    assert "--debug" in out


def test_help_and_mocap_import_nothing_heavy() -> None:
    code = (
        "import sys; from poser.__main__ import main; main(['--help']); import mocap, mocap.errors;"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert done.stderr.strip() == "[]"


def test_mocap_types_import_no_solver() -> None:
    heavy = ("casadi", "torch", "osqp", "matplotlib", "pinocchio", "scipy.optimize", "vqf")
    code = (
        "import sys; from mocap import Motion, Recording, Skeleton;"
        f"print([m for m in {heavy!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_wrong_usage_is_one_sentence() -> None:
    for words in ((), ("dance",), ("solve",), ("info", "--jsn", "x"), ("synthesize", "a", "-o")):
        done = poser(*words)
        assert done.returncode == 2
        assert done.stdout == ""
        assert done.stderr.count("\n") == 1
        assert "--help" in done.stderr


def test_an_error_is_one_sentence_and_debug_shows_more(tmp_path: Path) -> None:
    done = poser("info", tmp_path / "absent.npz")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"poser info: {tmp_path / 'absent.npz'}: no such file\n"
    for words in (("--debug", "info", "x.npz"), ("info", "x.npz", "--debug")):
        done = poser(*words)
        assert done.returncode == 1
        assert "Traceback" in done.stderr


def test_an_unexpected_error_is_a_sentence_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise KeyError("a fault")

    monkeypatch.setattr("poser.files.read", broken)
    assert main(["info", "x.npz"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "KeyError" in said and "--debug" in said


def test_stdout_holds_the_json_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    done = poser("solve", folder / "rec" / "walk.npz", "-o", tmp_path / "m.npz", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["frames"] == 180


def test_a_reader_that_goes_away(folder: Path) -> None:
    line = f"{sys.executable} -m poser info {folder / 'walk.npz'} --json | true"
    done = subprocess.run(line, shell=True, capture_output=True, text=True, timeout=60)
    assert done.stderr == ""


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("solver", ["ipopt-cold", "banded"])
def test_ctrl_c_leaves_no_half_file(tmp_path: Path, solver: str) -> None:
    recording = tmp_path / "rec.npz"
    write_recording(recording, synthesis.recording(motions.builtin(seconds=45.0)))
    out = tmp_path / "out"
    out.mkdir()
    line = [sys.executable, "-m", "poser", "solve", str(recording)]
    line += ["-o", str(out / "m.npz"), "--solver", solver]
    for wait_s in (
        2.5,
        6.0,
        12.0,
    ):  # on a busy machine Python itself is still starting after the first
        process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        time.sleep(wait_s)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
        if process.returncode != -signal.SIGINT:
            break
    assert process.returncode == 130
    assert stdout == ""
    assert stderr.splitlines()[-1] == "poser solve: interrupted"
    assert list(out.iterdir()) == []


def test_an_interrupted_write_leaves_the_old_file(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.npz"
    out.write_bytes(b"old")

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("numpy.savez_compressed", interrupted)
    assert main(["convert", str(folder / "walk.npz"), str(out)]) == 130
    assert out.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["m.npz"]
