"""Files as such: what is written is whole or not there, what is not a file is not waited for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mocap.errors import FormatError, PoserError
from mocap.formats._files import ASIDE, alone, read_json, write_aside

posix = pytest.mark.skipif(os.name != "posix", reason="signals, links and locks")


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def _interrupted(path: Path) -> None:
    with write_aside(path) as aside:
        aside.write_text("half")
        raise KeyboardInterrupt


def child(code: str, *words: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, timeout=60)


def test_what_was_there_stays_after_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(KeyboardInterrupt):
        _interrupted(path)
    assert path.read_text() == "before" and names(tmp_path) == ["a.txt"]


@posix
def test_a_killed_run_leaves_what_was_there_and_the_next_removes_its_rest(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    code = (
        "import os, signal, sys; from mocap.formats._files import write_aside\n"
        "with write_aside(sys.argv[1]) as aside:\n"
        "    aside.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert child(code, path).returncode == -signal.SIGKILL
    assert path.read_text() == "before" and len(names(tmp_path)) == 2
    with write_aside(path) as aside:
        aside.write_text("after")
    assert path.read_text() == "after" and names(tmp_path) == ["a.txt"]


@posix
def test_what_another_run_is_writing_is_left_alone(tmp_path: Path) -> None:
    with write_aside(tmp_path / "a.txt") as aside:
        aside.write_text("a")
        code = (
            "import sys; from mocap.formats._files import write_aside\n"
            "with write_aside(sys.argv[1]) as aside: aside.write_text('b')"
        )
        assert child(code, tmp_path / "b.txt").returncode == 0
        assert aside.exists()
    assert names(tmp_path) == ["a.txt", "b.txt"]


@posix
def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"before")
    code = (
        "import resource, signal, sys; from mocap.formats._files import write_aside\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        "    with write_aside(sys.argv[1]) as aside: aside.write_bytes(bytes(5000))\n"
        "except OSError as e: print(e.filename)"
    )
    assert child(code, path).stdout.strip() == str(path)
    assert path.read_bytes() == b"before" and names(tmp_path) == ["a.bin"]


@posix
def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link, target = tmp_path / "a.txt", tmp_path / "there" / "b.txt"
    target.write_text("before")
    link.symlink_to(target)
    with write_aside(link) as aside:
        aside.write_text("after")
    assert link.is_symlink() and target.read_text() == "after"


@posix
def test_what_must_not_be_replaced(tmp_path: Path) -> None:
    kept, pipe = tmp_path / "kept.txt", tmp_path / "pipe.txt"
    kept.write_text("kept")
    kept.chmod(0o444)
    os.mkfifo(pipe)
    for path, word in ((kept, "read-only"), (pipe, "pipe"), (tmp_path, "folder")):
        with pytest.raises(FormatError, match=word), write_aside(path):
            raise AssertionError("is not reached")
    assert kept.read_text() == "kept" and pipe.is_fifo()


@posix
def test_permissions_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    path.chmod(0o600)
    with write_aside(path) as aside:
        aside.write_text("after")
    assert path.stat().st_mode & 0o777 == 0o600


@posix
@pytest.mark.parametrize("what", ["pipe", "device", "bad", "deep", "bytes"])
def test_json_that_is_none(what: str, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "device":
        path.symlink_to("/dev/zero")
    else:
        path.write_bytes({"bad": b"{", "deep": b"[" * 100_000, "bytes": b"\xff\xfe"}[what])
    with pytest.raises(FormatError, match=r"pipe|is not JSON"):
        read_json(path)


@posix
def test_a_folder_is_held_by_one_and_freed_by_its_end(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path; from mocap.formats._files import alone\n"
        "with alone(Path(sys.argv[1])):\n"
        "    print('held', flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(PoserError, match="another run"), alone(tmp_path):
            raise AssertionError("is not reached")
    finally:
        process.kill()
        process.communicate()
    with alone(tmp_path):
        assert not any(name.startswith(ASIDE) for name in names(tmp_path))
    assert names(tmp_path) == []
