"""The real recording, end to end: read, calibrate, solve; skipped where its file is absent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap import RawRecording, Recording, formats, sensors
from mocap import orientation as ori
from mocap.calibration import calibrate
from sip import Settings, solve


@pytest.fixture(scope="module")
def calibrated(shared: Path) -> Recording:
    raw = formats.read(shared / "data/qmt-fullbody/full_body_example_data.mat").content
    assert isinstance(raw, RawRecording)
    recording, _ = calibrate(raw, pose="n", at=44.0)
    return recording


def window(recording: Recording, start_s: float, stop_s: float) -> Recording:
    a, b = (round((t - recording.start_s) * recording.rate_hz) for t in (start_s, stop_s))
    return recording.slice(a, b)


def test_all_sensors_are_fitted(calibrated: Recording) -> None:
    piece = window(calibrated, 95.0, 97.0)
    solution = solve(piece, settings=Settings(solver="banded"))
    assert solution.converged
    apart = ori.angle_between(solution.motion.R_world_joint[:, piece.joint], piece.R_world_bone)
    assert np.rad2deg(np.median(apart[piece.ori_valid])) < 3.0


def test_accelerations_help_where_no_sensor_is(calibrated: Recording) -> None:
    """Six sensors see the window; the thighs' own sensors, unseen, judge."""
    piece = window(calibrated, 112.0, 116.0)
    left_out = {}
    for terms in ("sop", "sip"):
        settings = Settings(terms=terms, solver="banded")
        motion = solve(piece.select(sensors.SIX), settings=settings).motion
        unseen = [i for i, n in enumerate(piece.sensors) if n not in sensors.SIX]
        apart = ori.angle_between(
            motion.R_world_joint[:, piece.joint[unseen]], piece.R_world_bone[:, unseen]
        )
        left_out[terms] = np.rad2deg(apart.mean())
    assert left_out["sip"] < left_out["sop"]
