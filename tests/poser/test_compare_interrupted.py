"""Ctrl-C in `poser compare --jobs 2`: what is done is kept and whole, nothing else is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mocap import formats, sensors, synthesis
from mocap.formats.native import write_recording
from mocap.motion import Motion
from mocap.synthesis import motions

BOUND_S = 120.0  # of a wait that takes seconds on a machine of its own
METHODS = ("sop", "sip")


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_what_is_done_is_whole_and_nothing_else_is_there(tmp_path: Path) -> None:
    """A short recording is done while the other, of 45 s, is being solved: then comes Ctrl-C, which a
    terminal sends to all processes of the group.
    """
    for name, seconds in (("short", 0.8), ("long", 45.0)):
        motion = motions.builtin(seconds=seconds)
        made = synthesis.recording(motion, sensors.SIX, synthesis.Noise(), 0)
        write_recording(tmp_path / f"{name}.npz", made)
    out = tmp_path / "out"
    line = [sys.executable, "-m", "poser", "compare", str(tmp_path / "short.npz")]
    line += [str(tmp_path / "long.npz"), "-o", str(out), "--solver", "banded"]
    line += ["--methods", ",".join(METHODS), "--jobs", "2"]
    process = subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        began = time.monotonic()
        while not (out / "short" / "reference.npz").exists():
            assert process.poll() is None, process.communicate()
            assert time.monotonic() - began < BOUND_S
            time.sleep(0.02)
        assert not (out / "long").exists()
        os.killpg(process.pid, signal.SIGINT)
        stdout, stderr = process.communicate(timeout=BOUND_S)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert (process.returncode, stdout) == (130, "")
    measured = [f"poser compare: short, {m}: done, {k} of 4" for k, m in enumerate(METHODS, 1)]
    assert stderr.splitlines() == [*measured, "poser compare: interrupted"]
    assert [p.name for p in out.iterdir()] == ["short"]
    written = sorted(p.stem for p in (out / "short").iterdir())
    assert {*METHODS, "reference"} <= set(written)
    for name in written:
        motion = formats.read(out / "short" / f"{name}.npz").content
        assert isinstance(motion, Motion) and len(motion) == 48
    # No worker goes on by itself.
    began = time.monotonic()
    while _lives(process.pid):
        assert time.monotonic() - began < BOUND_S
        time.sleep(0.05)


def _lives(group: int) -> bool:
    """Whether a process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
