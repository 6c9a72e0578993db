"""The window that moves: the whole solve's answer, streams and their resumption, what it does in need."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from mocap import Motion, Recording, Skeleton, sensors, synthesis
from mocap import orientation as ori
from mocap.evaluation import metrics
from mocap.synthesis.motions import walk
from sip import Horizon, HorizonSettings, PoseBelief, Settings, solve
from sip.horizon import HorizonState, run
from sip.model import Evidence
from tests.sip.conftest import wavy

BODY = Skeleton.default()


def horizon(recording: Recording, settings: Settings, listening: bool = False, **how) -> Horizon:
    return Horizon(
        BODY, recording.joint, recording.placement, recording.rate_hz, settings,
        HorizonSettings(**how), listening,
    )  # fmt: skip


def fed(h: Horizon, evidence: Evidence, state: HorizonState | None = None) -> HorizonState:
    state = state or h.init()
    for t in range(len(evidence)):
        state = h.step(state, evidence.slice(t, t + 1))
    return state


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({"sigma_contact": np.inf}, sensors.SIX),
        ({"terms": "sop"}, ("head", "left_wrist")),
        ({"self_calibration": True, "correlation_s": 4.0}, ("left_wrist", "head", "pelvis")),
        ({"smooth_order": 3, "smooth_angle": 500.0, "smooth_root": 500.0}, ("head", "pelvis")),
    ],
    ids=["sip", "sop", "calibrating", "jerk"],
)
def test_a_window_as_long_as_the_recording_has_the_answer_of_solve(
    settings: dict, names: tuple[str, ...]
) -> None:
    # The end frames of what is synthesised have no samples.
    recording = synthesis.recording(wavy(22), names, synthesis.Noise(), 1).slice(1, 21)
    exact = Settings(
        solver="banded", tolerance=1e-15, max_iterations=300, sigma_gauge=1e4, **settings
    )
    whole = solve(recording, settings=exact)
    h = horizon(recording, exact, seconds=1.0)
    state = fed(h, Evidence.of(recording))
    for _ in range(200):
        state = h.improved(state)
    problem = h.problem(state)
    assert state.point is not None
    assert problem.cost(state.point) == pytest.approx(whole.total_cost, rel=1e-8)
    for lag in range(20):
        pose = h.pose(state, lag)
        apart = np.abs(pose.R_parent_joint - whole.motion.R_parent_joint[19 - lag])
        assert apart.max() < 1e-6


def test_it_follows_a_walk_nearly_as_the_whole_solve_does() -> None:
    recording = synthesis.recording(walk(4.0), sensors.SIX, synthesis.Noise(), 1)
    assert recording.reference is not None
    whole = solve(recording, settings=Settings(solver="banded"))
    R, p = run(horizon(recording, Settings()), recording, 12)
    found = Motion(60.0, R, p, BODY)
    scores = [metrics.evaluate(m, recording.reference) for m in (found, whole.motion)]
    assert scores[0].sip_deg is not None and scores[1].sip_deg is not None
    assert scores[0].sip_deg < 1.2 * scores[1].sip_deg


def test_stopped_and_gone_on_with_is_as_if_it_had_run_on() -> None:
    recording = synthesis.recording(wavy(40), ("head", "pelvis"), synthesis.Noise(), 1)
    settings = Settings(self_calibration=True)
    h = horizon(recording, settings, seconds=0.2)
    evidence = Evidence.of(recording)
    whole = fed(h, evidence)
    half = pickle.loads(pickle.dumps(fed(h, evidence.slice(0, 23))))
    resumed = fed(horizon(recording, settings, seconds=0.2), evidence.slice(23, 40), half)
    assert whole.point is not None and resumed.point is not None
    # Equal but for rounding: memory lies elsewhere. The place, which hardly anything holds, feels it most.
    assert np.abs(whole.point.x - resumed.point.x)[:, 3:].max() < 1e-6
    assert np.abs(whole.point.x - resumed.point.x)[:, :3].max() < 1e-4
    assert np.abs(whole.point.u - resumed.point.u).max() < 1e-6


def test_a_stream_and_its_replay_are_the_same() -> None:
    recording = synthesis.recording(wavy(32), ("head", "pelvis"), synthesis.Noise(), 1).slice(1, 31)
    h = horizon(recording, Settings(), seconds=0.2)
    R, p = run(h, recording, 4)
    state, evidence = h.init(), Evidence.of(recording)
    for t in range(30):
        state = h.step(state, evidence.slice(t, t + 1))
        if t >= 4:
            pose = h.pose(state, 4)
            assert np.abs(pose.R_parent_joint - R[t - 4]).max() < 1e-6
            assert np.abs(pose.p_world_root - p[t - 4]).max() < 1e-4


@pytest.mark.parametrize("names", [sensors.SIX, ("left_wrist", "right_pocket", "head")], ids=str)
def test_turning_the_world_turns_the_answer(names: tuple[str, ...]) -> None:
    recording = synthesis.recording(walk(3.0).slice(60, 120), names, synthesis.Noise(), 1)
    yaw = 2.1
    settings = Settings(self_calibration=True)
    runs = [run(horizon(r, settings), r, 5) for r in (recording, recording.turned(yaw))]
    a, b = (Motion(60.0, R, p, BODY) for R, p in runs)
    turned = a.turned(yaw)
    # They part by rounding alone, which the place feels most: nothing but what came before it holds it.
    assert np.abs(b.R_world_joint - turned.R_world_joint).max() < 1e-5
    assert np.abs(b.p_world_root - turned.p_world_root).max() < 5e-3


def test_a_second_without_sensors_is_bridged() -> None:
    recording = synthesis.recording(wavy(120), sensors.SIX, synthesis.Noise(), 1)
    valid = recording.valid.copy()
    valid[40:100] = False
    blind = replace(recording, valid=valid)
    R, p = run(horizon(blind, Settings()), blind, 5)
    assert ori.is_rotation(R).all() and np.isfinite(p).all()
    reference = recording.reference
    assert reference is not None
    k = list(recording.joint).index(0)
    apart = ori.angle_between(R[110:, 0], recording.R_world_bone[110:, k])
    assert np.rad2deg(apart.max()) < 15


def test_what_a_network_says_late_is_heard() -> None:
    """A sure network's pose of five frames ago is the pose of five frames ago."""
    recording = synthesis.recording(wavy(40), sensors.SIX)
    truth = recording.reference
    assert truth is not None
    belief = PoseBelief(truth.R_parent_joint, np.eye(72) * np.deg2rad(0.01) ** 2)
    h = horizon(recording, Settings(), listening=True)
    R, _ = run(h, recording, 5, belief, 5)
    active = list(h.kinematics.active)
    apart = np.rad2deg(ori.angle_between(R, truth.R_parent_joint))[:, active]
    assert apart[10:35].max() < 1.0


def test_the_deviation_is_that_of_the_whole_matrix() -> None:
    recording = synthesis.recording(wavy(30), sensors.SIX, synthesis.Noise(), 1)
    h = horizon(recording, Settings(self_calibration=True), seconds=0.2)
    state = replace(fed(h, Evidence.of(recording)), factor=None)
    pose = h.pose(state, 3, deviation=True)
    assert state.point is not None and pose.std_rad is not None
    H = h.problem(state).hessian(state.point).dense()
    variance = np.diag(np.linalg.inv(H))
    n, t = h.kinematics.n, len(state) - 4
    assert pose.std_rad[0] == pytest.approx(np.sqrt(variance[t * n + 3 : t * n + 6]), rel=1e-4)
    for i, j in enumerate(h.kinematics.active):
        at = t * n + 6 + 3 * i
        assert pose.std_rad[j] == pytest.approx(np.sqrt(variance[at : at + 3]), rel=1e-4)


def test_the_matrix_of_the_last_step_has_nearly_the_same_deviation() -> None:
    recording = synthesis.recording(wavy(30), sensors.SIX, synthesis.Noise(), 1)
    h = horizon(recording, Settings(self_calibration=True), seconds=0.2)
    state = fed(h, Evidence.of(recording))
    assert state.factor is not None
    assert pickle.loads(pickle.dumps(state)).factor is None
    quick, exact = (h.pose(s, 3, True).std_rad for s in (state, replace(state, factor=None)))
    ratio = quick / exact
    assert 0.95 < np.median(ratio) < 1.05 and ratio.min() > 0.6 and ratio.max() < 1.6


@pytest.mark.parametrize("name", ["seconds", "memory_s"])
def test_settings_refuse_nonsense(name: str) -> None:
    from mocap.errors import SolveError

    with pytest.raises(SolveError, match=name):
        HorizonSettings(**{name: -1.0})
