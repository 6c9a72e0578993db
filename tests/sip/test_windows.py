"""Windows, holes and rates: what long and broken recordings meet, and self-calibration's signs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mocap import Recording, Skeleton, sensors, synthesis
from mocap.errors import FormatError, ShapeError, SolveError
from sip import Prior, Settings, initial, solve
from sip.problem import build
from sip.windows import windows
from tests.sip.conftest import wavy


@pytest.fixture(scope="module")
def noisy() -> Recording:
    return synthesis.recording(wavy(60), sensors.SIX, synthesis.Noise(), 1)


@pytest.mark.parametrize("names", [sensors.SIX, sensors.SIX[:5]])
def test_window_without_a_valid_sample(noisy: Recording, names: tuple[str, ...]) -> None:
    """A hole longer than a window, with and without a pelvis sensor."""
    recording = noisy.select(names)
    valid = np.array(recording.valid)
    valid[15:55] = False
    settings = Settings(solver="banded", window=16, overlap=4)
    solution = solve(replace(recording, valid=valid), settings=settings)
    assert any(not valid[w.start : w.stop].any() for w in windows(60, 16, 4))
    assert np.isfinite(solution.motion.p_world_joint).all()
    assert len(solution.motion) == 60


def test_orientations_that_may_not_be_used_stay_unused_on_the_coarse_grid() -> None:
    """Accelerations around a hole may be enough for a coarse one, whatever the orientation holds."""
    clean = synthesis.recording(wavy(60), sensors.SIX)
    valid, R = np.array(clean.valid), np.array(clean.R_world_bone)
    valid[28], R[28] = False, 0.0
    recording = Recording(60.0, clean.sensors, R, clean.acc_world, valid)
    coarse = initial.coarsened(recording, 4)
    assert coarse.acc_valid[7].all()
    assert not coarse.ori_valid[7].any()


@pytest.mark.parametrize("solver", ["banded", "ipopt"])
def test_report_of_windows_is_of_the_whole(noisy: Recording, solver: str) -> None:
    """Residuals lie on the recording's frames, and the cost is that of the motion returned."""
    settings = Settings(solver=solver, window=30, overlap=8)  # type: ignore[arg-type]
    solution = solve(noisy, settings=settings)
    assert solution.report["windows"] == 3
    T = len(noisy)
    assert solution.residuals["orientation"].shape == (T, 6, 3)
    assert solution.residuals["acceleration"].shape == (T - 2, 6, 3)
    problem = build(noisy, Skeleton.default(), settings)
    x, R_ref = initial.from_motion(solution.motion, problem.prior)
    point = problem.point(x, R_ref, np.zeros((6, 7)))
    for term in problem.terms:
        if term.name in ("orientation", "acceleration", "prior"):
            r = term.residual(point)
            assert np.allclose(r, solution.residuals[term.name], atol=1e-6)
            assert term.loss(r) == pytest.approx(solution.cost[term.name])


def test_windows_are_no_longer_than_asked() -> None:
    for frames in (101, 119, 180, 199, 1000, 12345):
        plan = windows(frames, 100, 20)
        assert max(w.stop - w.start for w in plan) <= 100
        assert all(a.stop - b.start == 20 for a, b in pairwise(plan))


def test_windows_that_cannot_overlap_are_refused() -> None:
    with pytest.raises(SolveError, match="twice the overlap"):
        Settings(window=100, overlap=60)


def test_lone_pelvis_in_windows(noisy: Recording) -> None:
    """No body joint is above a sensor: the seam is that of the root."""
    settings = Settings(solver="banded", window=30, overlap=8)
    solution = solve(noisy.select(("pelvis",)), settings=settings)
    assert np.isfinite(solution.report["seam_deg"]).all()
    assert max(solution.report["seam_deg"]) > 0


def test_standard_deviations_at_1000_hz() -> None:
    """Accelerations at 1000 Hz against the gauge: the matrix is singular to rounding."""
    recording = synthesis.recording(wavy(200, 1000.0), sensors.SIX, synthesis.Noise(), 1)
    settings = Settings(solver="banded", self_calibration=True, uncertainty=True, max_iterations=4)
    solution = solve(recording, settings=settings)
    assert solution.std_rad is not None
    assert np.isfinite(solution.std_rad).all()
    assert solution.std_rad.max() < np.pi


def test_true_constants_explain_what_the_sensors_measured() -> None:
    """Mounting, heading and bias have the frames and signs that the virtual sensors give them."""
    noise = replace(synthesis.Noise.none(), mounting_deg=4.0, heading_deg=3.0, acc_bias=0.1)
    recording = synthesis.recording(wavy(30), sensors.SIX, noise, 5)
    drawn = recording.noise
    assert drawn is not None
    assert recording.reference is not None
    problem = build(recording, Skeleton.default(), Settings(self_calibration=True))
    x, R_ref = initial.from_motion(recording.reference, problem.prior)
    heading = np.array(drawn["heading_mean_rad"])[:, None]
    u = np.hstack([drawn["mounting_rotvec"], heading, drawn["acc_bias"]])
    for constants, size in ((u, 1e-8), (-u, np.inf)):
        point = problem.point(x, R_ref, constants)
        for term in problem.terms:
            if term.name in ("orientation", "acceleration"):
                worst = np.abs(term.residual(point)).max()
                assert worst < size
                assert size < 1 or worst > 0.05


def test_a_sensor_the_wrong_way_round_is_said(noisy: Recording) -> None:
    """Two sensors on one bone, one turned by 180 degrees: neither can be followed."""
    names = ("pelvis", "left_forearm", "left_wrist")
    clean = synthesis.recording(wavy(20), names)
    R = np.array(clean.R_world_bone)
    R[:, 2] = R[:, 2] @ np.diag([-1.0, 1.0, -1.0])
    settings = Settings(solver="banded", terms="sop", max_iterations=3)
    # The forearm's measurements, fifty of them, outvote the wrist's.
    many = (names[0], *[f"forearm_{i}" for i in range(50)], names[2])
    index = [0, *[1] * 50, 2]
    recording = Recording(
        60.0, many, R[:, index], np.full((20, 52, 3), np.nan), clean.valid[:, index],
        joint=clean.joint[index], placement=clean.placement[index],
    )  # fmt: skip
    solution = solve(recording, settings=settings)
    assert solution.report["samples_beyond_150_deg"] == {"left_wrist": 18}
    assert "left_wrist" in solution.status
    assert "150" not in solve(noisy, settings=settings).status


def test_raw_sensors_need_three_frames() -> None:
    with pytest.raises(ShapeError, match="3 frames"):
        synthesis.raw_recording(wavy(2), sensors.SIX)


def test_a_file_that_is_no_prior(tmp_path: Path) -> None:
    for content in (b"", b"nothing", b"PK\x03\x04 half a zip"):
        path = tmp_path / "prior.npz"
        path.write_bytes(content)
        with pytest.raises(FormatError, match="not a prior"):
            Prior.load(path)


def test_sip_without_accelerations_says_that_it_is_sop(noisy: Recording) -> None:
    blind = replace(noisy, acc_world=np.full_like(noisy.acc_world, np.nan))
    sip, sop = (
        solve(blind, settings=Settings(solver="banded", terms=t))  # type: ignore[arg-type]
        for t in ("sip", "sop")
    )
    assert "no sensor has an acceleration" in sip.status
    assert "no sensor has an acceleration" not in sop.status
    assert sip.total_cost == pytest.approx(sop.total_cost, rel=1e-2)
