"""The command line as a process: exit status, streams, interruption, imports."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mocap import synthesis
from mocap.formats.native import write_recording
from mocap.synthesis import motions
from poser import commands
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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("words", [["--help"], ["info", "--help"], ["--version"], ["formats"]])
def test_a_full_disk_behind_stdout_is_said(words: list[str]) -> None:
    line = [sys.executable, "-m", "poser", *words]
    with Path("/dev/full").open("w") as full:
        out = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert out.returncode == 1 and "No space left" in out.stderr


def test_a_reader_that_goes_away(folder: Path) -> None:
    line = f"{sys.executable} -m poser info {folder / 'walk.npz'} --json | true"
    done = subprocess.run(line, shell=True, capture_output=True, text=True, timeout=60)
    assert done.stderr == ""


def interrupted(
    sign: str, line: list[str], env: dict[str, str], patience_s: float = 200.0
) -> tuple[int, str, str]:
    """Runs a command on a terminal, sends Ctrl-C's signal once its progress shows `sign`.

    Returns exit status, stdout, and what stood on the terminal after the signal, without control codes.
    Fails where the command ends by itself, or shows no such sign in `patience_s`.
    """
    ours, theirs = pty.openpty()
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=theirs, text=True, env=env)
    os.close(theirs)
    try:
        shown, deadline = "", time.monotonic() + patience_s
        while sign not in shown:
            assert time.monotonic() < deadline, f"no sign of {sign!r}: {shown[-500:]!r}"
            more = _terminal(ours)
            assert more is not None, f"ended before {sign!r}: {shown[-500:]!r}"
            shown += more
        process.send_signal(signal.SIGINT)
        shown, deadline = "", time.monotonic() + patience_s
        while (more := _terminal(ours)) is not None:
            assert time.monotonic() < deadline, f"went on after the signal: {shown[-500:]!r}"
            shown += more
        stdout, _ = process.communicate(timeout=patience_s)
    finally:
        process.kill()
        os.close(ours)
    return process.returncode, stdout, re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown)


def _terminal(handle: int) -> str | None:
    """What has come within a second, or None where nobody writes any more."""
    if not select.select([handle], [], [], 1.0)[0]:
        return ""
    try:
        return os.read(handle, 1 << 16).decode(errors="replace") or None
    except OSError:  # Linux says so with EIO
        return None


@pytest.mark.skipif(os.name != "posix", reason="signals and terminals")
@pytest.mark.parametrize(
    ("solver", "sign"),
    [
        (None, "banded iteration"),
        (None, "IPOPT finish"),
        ("ipopt-cold", "IPOPT iteration"),
        ("banded", "banded iteration"),
    ],
)
def test_ctrl_c_leaves_no_half_file(tmp_path: Path, solver: str | None, sign: str) -> None:
    """In each way of solving; in the default one in both solvers."""
    recording, out, temporary = tmp_path / "rec.npz", tmp_path / "out", tmp_path / "tmp"
    write_recording(recording, synthesis.recording(motions.builtin(seconds=22.0)))
    out.mkdir()
    temporary.mkdir()
    line = [sys.executable, "-m", "poser", "solve", str(recording), "-o", str(out / "m.npz")]
    line += ["--solver", solver] if solver else []
    env = os.environ | {"COLUMNS": "160", "TERM": "xterm", "TMPDIR": str(temporary)}
    status, stdout, shown = interrupted(sign, line, env)
    assert (status, stdout) == (130, "")
    said = [row.strip() for row in re.split(r"[\r\n]+", shown) if "poser" in row]
    assert said == ["poser solve: interrupted"]
    assert shown.rstrip().endswith("poser solve: interrupted")
    assert "Traceback" not in shown
    assert list(out.iterdir()) == [] and list(temporary.iterdir()) == []


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
