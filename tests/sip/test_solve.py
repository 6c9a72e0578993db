"""Whole solves: closed forms, symmetries, agreement of the solver ways, gaps, windows, reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import Recording, sensors, synthesis
from mocap import orientation as ori
from mocap.errors import SolveError
from mocap.synthesis.motions import walk
from sip import Settings, initial, solve
from sip.prior import shipped
from sip.windows import windows
from tests.sip.conftest import wavy

ARM = ("pelvis", "left_upper_arm", "left_forearm", "left_wrist", "left_hand")


def static(names: tuple[str, ...], R: np.ndarray, frames: int = 3) -> Recording:
    """Constant orientations (S,3,3), no accelerations."""
    return Recording(
        60.0,
        names,
        np.broadcast_to(R, (frames, *R.shape)),
        np.full((frames, len(names), 3), np.nan),
    )


def test_arm_in_closed_form(bare: Settings) -> None:
    """Without a prior the angles of an arm are the relative rotations of its measured bones.

    The forearm wears two sensors that disagree by 20 degrees about its own y axis: with equal sigmas
    the answer is half-way, and the cost 2 * (10 deg / sigma)^2 / 2 a frame.
    """
    upper = ori.exp([0.2, -0.3, -0.9])
    half = np.deg2rad(10)
    elbow = ori.exp([0, -1.2, 0.1])
    hand = ori.exp([0.1, 0.2, 0.3])
    fore = upper @ elbow
    R = np.stack([np.eye(3), upper, fore @ ori.rot_y(half), fore @ ori.rot_y(-half), fore @ hand])
    five = np.deg2rad(5.0)
    settings = replace(bare, terms="sop", solver="banded", tolerance=1e-12, sigma_orientation=five)
    solution = solve(static(ARM, R), settings=settings)
    solved = solution.motion.R_parent_joint[1]
    assert np.rad2deg(ori.angle_between(solved[18], elbow)) < 1e-4
    assert np.rad2deg(ori.angle_between(solved[20], hand)) < 1e-4
    assert np.rad2deg(ori.angle_between(solution.motion.R_world_joint[1, 16], upper)) < 1e-4
    assert solution.total_cost == pytest.approx(3 * (10 / 5) ** 2, rel=1e-6)


def test_turning_the_world_turns_the_answer(recording: Recording) -> None:
    settings = Settings(solver="banded", tolerance=1e-8)
    yaw = 2.1
    a = solve(recording, settings=settings).motion
    b = solve(recording.turned(yaw), settings=settings).motion
    turned = a.turned(yaw)
    assert np.abs(b.R_world_joint - turned.R_world_joint).max() < 2e-3
    assert np.abs(b.p_world_root - turned.p_world_root).max() < 2e-3


def test_solver_ways_agree() -> None:
    """From the same start near the solution all ways reach the same cost (limits inactive).

    Without feet that stand: their robust cost leaves the path so flat a valley that solvers stop 5e-6 apart.
    """
    motion = wavy(30, size=0.1)
    recording = synthesis.recording(motion, sensors.SIX)
    base = Settings()
    wide = replace(base.prior, lower=np.full(69, -3.0), upper=np.full(69, 3.0))
    base = replace(base, prior=wide, start=motion, tolerance=1e-12, sigma_contact=np.inf)
    costs = {}
    for way in ("banded", "ipopt", "ipopt-cold"):
        solution = solve(recording, settings=replace(base, solver=way))
        assert solution.converged, (way, solution.status)
        costs[way] = solution.total_cost
    assert costs["ipopt"] == pytest.approx(costs["banded"], rel=1e-6)
    assert costs["ipopt-cold"] == pytest.approx(costs["banded"], rel=1e-6)


def test_ipopt_enforces_limits(recording: Recording) -> None:
    tight = replace(Settings().prior, lower=np.full(69, -0.15), upper=np.full(69, 0.15))
    settings = Settings(prior=tight)
    soft = solve(recording, settings=replace(settings, solver="banded")).motion
    hard = solve(recording, settings=settings).motion
    angles = [np.abs(m.poses[:, 3:]).max() for m in (soft, hard)]
    assert angles[0] > 0.16
    assert angles[1] < 0.15 + 1e-6


@pytest.mark.parametrize(
    "names", [("head",), ("left_wrist", "right_pocket"), sensors.FIVE, sensors.SUIT]
)
@pytest.mark.parametrize("rate", [25.0, 100.0])
def test_any_sensors_any_rate(names: tuple[str, ...], rate: float) -> None:
    recording = synthesis.recording(wavy(20, rate), names, synthesis.Noise(), 3)
    solution = solve(recording, settings=Settings(solver="banded"))
    assert len(solution.motion) == 20
    assert solution.motion.rate_hz == rate
    assert np.isfinite(solution.motion.p_world_joint).all()


def test_one_and_two_frames() -> None:
    for frames in (1, 2, 3):
        recording = static(sensors.SIX, np.broadcast_to(np.eye(3), (6, 3, 3)), frames)
        assert len(solve(recording).motion) == frames


def test_gaps_are_bridged() -> None:
    """A hole in all sensors and one in a single sensor cost little more than what they hide."""
    motion = walk(seconds=3.0)
    full = synthesis.recording(motion, sensors.SIX)
    valid = np.array(full.valid)
    valid[20:26] = False
    valid[40:50, 3] = False
    holed = replace(full, valid=valid)
    settings = Settings(solver="banded")
    a, b = (solve(r, settings=settings).motion for r in (full, holed))
    apart = np.rad2deg(ori.angle_between(a.R_world_joint, b.R_world_joint))
    assert apart[20:26].mean() < 3
    assert apart.mean() < 1.5


def test_no_valid_sample_is_refused(recording: Recording) -> None:
    dead = replace(recording, valid=np.zeros_like(recording.valid))
    with pytest.raises(SolveError, match="no valid orientation"):
        solve(dead)


def test_start_of_another_length_is_refused(recording: Recording) -> None:
    with pytest.raises(SolveError, match="the start has 7 frames, the recording 40"):
        solve(recording, settings=Settings(start=wavy(7)))


def test_start_of_another_rate_is_refused(recording: Recording) -> None:
    with pytest.raises(SolveError, match="the start runs at 50 Hz, the recording at 60 Hz"):
        solve(recording, settings=Settings(start=wavy(40, 50.0)))


def test_a_start_past_a_half_turn_does_not_jump() -> None:
    """A wrist that winds from 150 to 210 degrees and back: rotation vectors of the same rotations."""
    angle = np.deg2rad(180 + 30 * np.sin(np.linspace(0, 12, 80)))
    for sign in (1, -1):
        axis = sign * np.array([0.6, 0.0, 0.8])
        w = angle[:, None, None] * axis
        R = ori.exp(w)
        chart = ori.log(R)
        assert np.linalg.norm(np.diff(chart, axis=0), axis=-1).max() > 5
        smooth = initial.unwrapped(chart)
        assert np.linalg.norm(np.diff(smooth, axis=0), axis=-1).max() < 0.2
        assert np.allclose(ori.exp(smooth), R, atol=1e-9)
    still = np.zeros((5, 2, 3))
    assert np.array_equal(initial.unwrapped(still), still)


def test_a_start_whose_rig_flips_stays_within_the_limits() -> None:
    """A wrist that jumps from 100 degrees to -90: a fault of the motion, not a turn past the half."""
    motion = wavy(40)
    R = np.array(motion.R_parent_joint)
    angle = np.deg2rad(np.where(np.arange(40) < 30, 100.0, -90.0))
    R[:, 20] = ori.rot_x(angle)
    conditioned = shipped().given(tuple(range(1, 24)), 0.05)
    x, _ = initial.from_motion(replace(motion, R_parent_joint=R), conditioned)
    wrist = x[:, 6 + 57 : 6 + 60]
    assert np.allclose(ori.exp(wrist), R[:, 20], atol=1e-9)
    assert np.abs(wrist).max() <= np.deg2rad(100) + 1e-9
    carried_round = initial.unwrapped(ori.log(R[:, 1:]))[:, 19]
    assert np.abs(carried_round).max() > np.deg2rad(260)


@pytest.mark.parametrize("frames", [1, 99, 100, 101, 250, 999])
def test_windows_cover_every_frame_once(frames: int) -> None:
    plan = windows(frames, 100, 20)
    kept = np.concatenate([np.arange(w.start, w.keep) for w in plan])
    assert np.array_equal(kept, np.arange(frames))
    assert all(w.stop - w.start <= 100 for w in plan)
    assert plan[-1].stop == frames


def test_windows_agree_with_the_whole() -> None:
    motion = walk(seconds=5.0)
    recording = synthesis.recording(motion, sensors.SIX)
    settings = Settings(solver="banded", tolerance=1e-6)
    whole = solve(recording, settings=settings)
    parts = solve(recording, settings=replace(settings, window=120, overlap=40))
    assert parts.report["windows"] > 2
    assert max(parts.report["seam_deg"]) < 2
    apart = np.rad2deg(ori.angle_between(whole.motion.R_world_joint, parts.motion.R_world_joint))
    assert apart.mean() < 1
    # No jump at a seam: relative to the root, steps there are like steps elsewhere.
    p = parts.motion.p_world_joint - parts.motion.p_world_joint[:, :1]
    step = np.linalg.norm(np.diff(p, axis=0), axis=-1).max(axis=1)
    true = motion.p_world_joint - motion.p_world_joint[:, :1]
    assert step.max() < 1.3 * np.linalg.norm(np.diff(true, axis=0), axis=-1).max()


def test_self_calibration_reports_its_constants() -> None:
    """Sensors wrong by known constants fit better; how well these are found: benchmarks/."""
    motion = wavy(150, size=0.35, seed=2)
    noise = replace(synthesis.Noise.none(), mounting_deg=4.0, heading_deg=3.0, acc_bias=0.1)
    recording = synthesis.recording(motion, sensors.SIX, noise, 5)
    plain, own = (
        solve(recording, settings=Settings(solver="banded", self_calibration=c))
        for c in (False, True)
    )
    assert own.sensors is not None
    assert plain.sensors is None
    assert own.total_cost < plain.total_cost
    assert set(own.sensors) == set(sensors.SIX)
    one = own.sensors["head"]
    assert len(one["mounting_rad"]) == 3
    assert all(0 < s < 1 for s in one["std"])


def test_uncertainty_is_larger_where_nothing_is_measured(recording: Recording) -> None:
    solution = solve(recording, settings=Settings(solver="banded", uncertainty=True))
    assert solution.std_rad is not None
    assert solution.std_rad.shape == (len(recording), 24, 3)
    mean = np.rad2deg(solution.std_rad.mean(axis=(0, 2)))
    assert (mean > 0).all()
    assert mean[0] < mean[16]  # the pelvis wears a sensor, the upper arm does not


def test_solution_reports_itself(recording: Recording) -> None:
    solution = solve(recording)
    assert solution.converged
    assert "optimal" in solution.status
    assert solution.iterations > 0
    assert solution.seconds > 0
    terms = {"orientation", "acceleration", "prior", "limits", "smoothness", "gauge", "contact"}
    assert set(solution.cost) == terms
    assert set(solution.sigmas) == terms
    for name in terms - {"orientation", "acceleration"}:
        rms = np.sqrt(np.mean(np.square(solution.residuals[name])))
        assert solution.sigmas[name] == pytest.approx(rms)
    assert solution.residuals["orientation"].shape == (len(recording), 6, 3)
    assert solution.gradient_norm < 1


def test_interrupt_inside_ipopt_is_raised_at_once(recording: Recording) -> None:
    calls = []

    def progress(fraction: float, words: str) -> None:
        calls.append(words)
        if "IPOPT" in words:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(recording, settings=Settings(solver="ipopt-cold"), progress=progress)
    assert sum("IPOPT" in c for c in calls) == 1
