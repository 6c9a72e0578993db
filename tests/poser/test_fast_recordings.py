"""Recordings far faster than a body moves: estimated from fewer frames, answered at their own rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap import formats, sensors, synthesis
from mocap import orientation as ori
from mocap.formats.native import write_recording
from mocap.motion import Motion
from poser.__main__ import main
from tests.mocap.formats import recording_files as files


def test_solve_at_120_hz_and_back_at_1000(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = files.motion(700, 1000.0)
    rec = synthesis.recording(truth, sensors.SUIT)
    write_recording(tmp_path / "fast.npz", rec)
    assert (
        main(["solve", str(tmp_path / "fast.npz"), "-o", str(tmp_path / "m.npz"), "--from", "0.1"])
        == 0
    )
    said = capsys.readouterr()
    assert "runs at 1000 Hz; poses are estimated at 111.1 Hz" in said.err
    assert "600 frames from" in said.out
    found = formats.read(tmp_path / "m.npz").content
    assert isinstance(found, Motion)
    assert (len(found), found.rate_hz, found.start_s) == (600, 1000.0, pytest.approx(0.1))
    apart = ori.angle_between(found.R_world_joint[:, :6], truth.R_world_joint[100:, :6])
    assert np.degrees(apart).mean() < 10
