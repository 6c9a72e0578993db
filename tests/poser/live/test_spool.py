"""Sessions are written down as they go: a kill or a full disk loses nothing that was there."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap.errors import PoserError
from mocap.orientation import Array
from poser.live.spool import Spool

ROWS = np.arange(60.0).reshape(20, 3)


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def write(path: Path, head: Mapping[str, Any], rows: Array) -> None:
    np.save(path, rows * head["scale"])


def spool(path: Path) -> Spool:
    return Spool(path, 3, {"scale": 2.0}, write)


def test_rows_become_the_file(tmp_path: Path) -> None:
    made = spool(tmp_path / "a.npy")
    for row in ROWS:
        made.append(row)
    assert names(tmp_path) == ["a.npy.part"]
    made.finish()
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), 2 * ROWS)
    assert names(tmp_path) == ["a.npy"]


def test_nothing_came(tmp_path: Path) -> None:
    spool(tmp_path / "a.npy").finish()
    assert names(tmp_path) == []


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_killed_session_is_made_whole_by_the_next(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from tests.poser.live.test_spool import ROWS, spool\n"
        "made = spool(Path(sys.argv[1]))\n"
        "for row in ROWS: made.append(row)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    line = [sys.executable, "-c", code, str(tmp_path / "a.npy")]
    assert subprocess.run(line, timeout=60).returncode == -signal.SIGKILL
    with (tmp_path / "a.npy.part").open("ab") as f:
        f.write(b"half")
    spool(tmp_path / "a.npy").finish()
    np.testing.assert_array_equal(np.load(tmp_path / "a.rescued.npy"), 2 * ROWS)
    assert names(tmp_path) == ["a.rescued.npy"]
    assert "20 rows" in capsys.readouterr().err


def test_a_strangers_part_is_not_touched(tmp_path: Path) -> None:
    part = tmp_path / "a.npy.part"
    part.write_text("mine")
    with pytest.raises(PoserError, match="move it away"):
        spool(tmp_path / "a.npy")
    assert part.read_text() == "mine"


def test_a_full_disk_ends_the_taking(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made, room = spool(tmp_path / "a.npy"), [200]
    real = os.write

    def some(handle: int, data: memoryview) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = real(handle, data[: room[0]])
        room[0] -= done
        return done

    monkeypatch.setattr(os, "write", some)
    for row in ROWS:
        made.append(row)
    monkeypatch.undo()
    assert made.count > 0 and made.count + made.lost == len(ROWS)
    assert "No space left" in capsys.readouterr().err
    made.finish()
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), 2 * ROWS[: made.count])


def full(path: Path, head: Mapping[str, Any], rows: Array) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def test_rows_stay_where_there_is_no_room_for_the_file(tmp_path: Path) -> None:
    made = Spool(tmp_path / "a.npy", 3, {"scale": 2.0}, full)
    for row in ROWS:
        made.append(row)
    with pytest.raises(PoserError, match=r"a\.npy\.part"):
        made.finish()
    del made
    # The system frees the lock with the session's process; here the handle is the session.
    part = tmp_path / "a.npy.part"
    (tmp_path / "b.npy.part").write_bytes(part.read_bytes())
    spool(tmp_path / "b.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "b.rescued.npy"), 2 * ROWS)
