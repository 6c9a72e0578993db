"""A network's poses as a term: derivatives, what they pull to, and how far they are believed."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import Recording, Skeleton, sensors, synthesis
from mocap import orientation as ori
from sip import PoseBelief, Settings, initial, solve
from sip.belief import Listener
from sip.problem import Problem, build
from sip.sensor_kinematics import SensorKinematics
from sip.solvers.band import Band
from tests.sip.conftest import wavy

DEVICES = ("left_wrist", "right_pocket", "head")


def uneven(rng: np.random.Generator, frames: int | None = None) -> np.ndarray:
    """A covariance (72,72), or one a frame, in which joints lean against each other."""
    shape = (72, 90) if frames is None else (frames, 72, 90)
    A = rng.normal(size=shape) * np.deg2rad(10.0) / np.sqrt(90)
    return np.asarray(A @ A.swapaxes(-1, -2))


def near(recording: Recording, rng: np.random.Generator, size: float, each: bool) -> PoseBelief:
    """The truth, every joint off by about `size` rad."""
    assert recording.reference is not None
    R = recording.reference.R_parent_joint
    off = ori.exp(rng.normal(size=(len(R), 24, 3)) * size)
    return PoseBelief(R @ off, uneven(rng, len(R) if each else None))


def told(recording: Recording, belief: PoseBelief, settings: Settings) -> Problem:
    kinematics = SensorKinematics(Skeleton.default(), recording.joint, recording.placement)
    listener = Listener(Skeleton.default(), kinematics, recording.joint, settings)
    heard = listener.listen(recording, belief)
    return build(recording, Skeleton.default(), settings, kinematics, 0, heard)


@pytest.mark.parametrize("each", [False, True], ids=["one covariance", "one a frame"])
@pytest.mark.parametrize("names", [sensors.SIX, DEVICES], ids=["six", "devices"])
def test_derivatives(rng: np.random.Generator, names: tuple[str, ...], each: bool) -> None:
    recording = synthesis.recording(wavy(8), names, synthesis.Noise(), 1)
    problem = told(recording, near(recording, rng, 0.2, each), Settings(network_doubt=0.5))
    x, R_ref = initial.from_motion(wavy(8), problem.prior)
    x = x + rng.normal(size=x.shape) * 0.3
    point = problem.point(x, R_ref, np.zeros((problem.S, 7)))
    (term,) = (t for t in problem.terms if t.name == "network")
    grad, blank = np.zeros_like(x), Band.zeros(8, problem.reach, problem.n)
    r = term.residual(point)
    term.pullback(point, r, grad, np.zeros((problem.S, 7)))
    term.hessian(point, blank)
    h = 1e-6
    for _ in range(3):
        dx = rng.normal(size=x.shape)
        ends = [problem.point(x + s * dx, R_ref, point.u) for s in (-h, h)]
        dr = (term.residual(ends[1]) - term.residual(ends[0])) / (2 * h)
        change = (term.loss(term.residual(ends[1])) - term.loss(term.residual(ends[0]))) / (2 * h)
        assert np.vdot(grad, dx) == pytest.approx(change, rel=1e-6)
        assert np.vdot(dx, blank.dot(dx, np.zeros(0))[0]) == pytest.approx((dr**2).sum(), rel=1e-6)


@pytest.mark.parametrize("names", [sensors.SIX, DEVICES], ids=["six", "devices"])
def test_a_sure_network_is_believed_and_one_with_nothing_to_say_is_not(
    rng: np.random.Generator, names: tuple[str, ...]
) -> None:
    recording = synthesis.recording(wavy(20), names)
    belief = near(recording, rng, 0.0, False)
    settings = Settings(solver="banded", tolerance=1e-8)
    assert settings.prior_weight == settings.prior_weight_listening
    alone = solve(recording, settings=settings)
    truth = recording.reference
    assert truth is not None
    kinematics = SensorKinematics(truth.skeleton, recording.joint, recording.placement)
    active = list(kinematics.active)

    def off(solution) -> float:
        apart = ori.angle_between(solution.motion.R_parent_joint, truth.R_parent_joint)
        return float(np.rad2deg(apart[:, active].max()))

    sure = PoseBelief(belief.R_parent_joint, np.eye(72) * np.deg2rad(0.01) ** 2)
    assert off(alone) > 5
    assert off(solve(recording, settings=settings, belief=sure)) < 0.2
    silent = PoseBelief(belief.R_parent_joint, belief.covariance, np.zeros(20, bool))
    same = solve(recording, settings=settings, belief=silent)
    assert same.total_cost == pytest.approx(alone.total_cost, rel=1e-6)


def test_only_the_limb_that_contradicts_its_sensor_is_doubted(rng: np.random.Generator) -> None:
    recording = synthesis.recording(wavy(40), sensors.SIX)
    R = np.array(near(recording, rng, 0.0, False).R_parent_joint)
    R[:, 18] = R[:, 18] @ ori.rot_x(1.5)
    kinematics = SensorKinematics(Skeleton.default(), recording.joint, recording.placement)
    listener = Listener(Skeleton.default(), kinematics, recording.joint, Settings())
    belief = PoseBelief(R, np.eye(72) * np.deg2rad(5.0) ** 2)
    heard = listener.listen(recording, belief)
    per_joint = dict(zip(kinematics.active, heard.scale[20].reshape(-1, 3)[:, 0], strict=True))
    full = Settings().network_weight
    assert per_joint[16] == per_joint[18] < full / 5
    assert all(per_joint[j] == pytest.approx(full) for j in (1, 2, 4, 5, 17, 19))


def test_what_honest_errors_look_like_is_not_doubted(rng: np.random.Generator) -> None:
    """Errors drawn from the stated covariance: the mean of d^T P^-1 d / 3 is about one."""
    recording = synthesis.recording(wavy(400), sensors.SIX)
    C = uneven(rng)
    root = np.linalg.cholesky(C)
    off = (rng.normal(size=(400, 72)) @ root.T).reshape(400, 24, 3)
    truth = recording.reference
    assert truth is not None
    settings = Settings(sigma_orientation=1e-4)
    kinematics = SensorKinematics(truth.skeleton, recording.joint, recording.placement)
    listener = Listener(truth.skeleton, kinematics, recording.joint, settings)
    belief = PoseBelief(truth.R_parent_joint @ ori.exp(off), C)
    ratio, there = listener.disagreement(belief, recording.R_world_bone, recording.ori_valid)
    limbs = recording.joint != 0
    assert there[1:-1, limbs].all()
    assert ratio[1:-1, limbs].mean(axis=0) == pytest.approx(1.0, abs=0.25)
