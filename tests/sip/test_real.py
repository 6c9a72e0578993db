"""The real recording, end to end: read, calibrate, solve; skipped where its file is absent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap import RawRecording, Recording, formats, sensors
from mocap import orientation as ori
from mocap.calibration import calibrate
from mocap.evaluation import metrics
from mocap.solution import Solution
from sip import Settings, solve


@pytest.fixture(scope="module", params=["file", "vqf"])
def calibrated(request: pytest.FixtureRequest, shared: Path) -> Recording:
    """By the file's orientations, and from gyr and acc alone."""
    raw = formats.read(shared / "data/qmt-fullbody/full_body_example_data.mat").content
    assert isinstance(raw, RawRecording)
    recording, _ = calibrate(raw, pose="n", at=44.0, orientation=request.param)
    return recording


def window(recording: Recording, start_s: float, stop_s: float) -> Recording:
    a, b = (round((t - recording.start_s) * recording.rate_hz) for t in (start_s, stop_s))
    return recording.slice(a, b)


@pytest.fixture(scope="module")
def piece(calibrated: Recording) -> Recording:
    return window(calibrated, 112.0, 115.0)


@pytest.fixture(scope="module")
def full(piece: Recording) -> Solution:
    """All 16 sensors: the reference."""
    return solve(piece, settings=Settings(solver="banded"))


def test_all_sensors_are_fitted(piece: Recording, full: Solution) -> None:
    assert full.converged
    apart = ori.angle_between(full.motion.R_world_joint[:, piece.joint], piece.R_world_bone)
    assert np.rad2deg(np.median(apart[piece.ori_valid])) < 3.0


def test_accelerations_help_where_no_sensor_is(piece: Recording, full: Solution) -> None:
    """Six sensors see the window; the ten unseen ones judge, and the solution on all of them."""
    found = {}
    for terms in ("sop", "sip"):
        settings = Settings(terms=terms, solver="banded")
        motion = solve(piece.select(sensors.SIX), settings=settings).motion
        found[terms] = metrics.evaluate(motion, full.motion, recording=piece, seen=sensors.SIX)
    for name in ("left_out_deg", "sip_deg", "position_cm"):
        assert getattr(found["sip"], name) < getattr(found["sop"], name)
