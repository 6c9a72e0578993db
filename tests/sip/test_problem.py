"""The built problem: derivatives against finite differences, the truth as a stationary point."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mocap import Recording, Skeleton, sensors, synthesis
from mocap import orientation as ori
from mocap.orientation import Array
from sip import Settings, initial
from sip import kinematics as kin
from sip.problem import Problem, build, reference_root
from sip.sensor_kinematics import SensorKinematics
from sip.terms.base import Point, Stencil, Term
from tests.sip.conftest import wavy

VARIANTS = [
    {},
    {"terms": "sop"},
    {"smooth_order": 3, "smooth_angle": 500.0, "smooth_root": 500.0, "smooth_position": 100.0},
    {"self_calibration": True},
    {"robust_delta": 0.5},
    {"self_calibration": True, "smooth_order": 0},
    {"extra": (lambda recording, kinematics: Bent(7),)},
]


class Bent(Term):
    """A term of one's own: residual (T-1,) sin x[t] - 2 x[t+1] of one column, which couples two frames."""

    name, reach = "bent", 1

    def __init__(self, column: int) -> None:
        self.column = column

    def residual(self, point: Point) -> Array:
        x = point.x[:, self.column]
        return np.sin(x[:-1]) - 2 * x[1:]

    def stencil(self, point: Point) -> Stencil:
        slope = np.cos(point.x[:-1, self.column])
        return Stencil({0: slope[:, None, None], 1: np.full((1, 1, 1), -2.0)}, [self.column])


def away(
    recording: Recording,
    settings: Settings,
    rng: np.random.Generator,
    size: float = 0.05,
    fixed: int = 0,
) -> tuple[Problem, Point]:
    """A problem, and a random point near the truth."""
    assert recording.reference is not None
    problem = build(recording, Skeleton.default(), settings, fixed=fixed)
    x, R_ref = initial.from_motion(recording.reference, problem.prior)
    u = np.zeros((problem.S, 7))
    if settings.self_calibration:
        u = rng.normal(size=u.shape) * size
    return problem, problem.point(x + rng.normal(size=x.shape) * size, R_ref, u)


# By the settings' names: the text of a function differs from process to process.
@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: "+".join(v) or "default")
@pytest.mark.parametrize("names", [sensors.SIX, ("head",), ("left_wrist", "right_pocket", "head")])
def test_gradient_and_gauss_newton_matrix(
    rng: np.random.Generator, wide, variant: dict, names: tuple[str, ...]
) -> None:
    motion = wavy(12)
    recording = synthesis.recording(motion, names, synthesis.Noise(), 1)
    problem, point = away(recording, Settings(prior=wide, **variant), rng)
    grad, grad_u = problem.gradient(point)
    band = problem.hessian(point)
    h = 1e-6
    for _ in range(4):
        dx = rng.normal(size=point.x.shape)
        du = rng.normal(size=point.u.shape) if problem.border else np.zeros_like(point.u)
        ends = [problem.point(point.x + s * dx, point.R_ref, point.u + s * du) for s in (-h, h)]
        numeric = (problem.cost(ends[1]) - problem.cost(ends[0])) / (2 * h)
        analytic = np.vdot(grad, dx) + grad_u @ du.ravel()[: problem.border]
        assert analytic == pytest.approx(numeric, rel=1e-6, abs=1e-4)
        flat = du.ravel()[: problem.border]
        Hx, Hu = band.dot(dx, flat)
        numeric = 0.0
        for term in problem.terms:
            dr = (term.residual(ends[1]) - term.residual(ends[0])) / (2 * h)
            weight = 1.0
            if term.name == "acceleration":
                weight = 1 / term._robust(term.residual(point))[..., None]
            numeric += float(np.sum(weight * dr**2))
        assert np.vdot(dx, Hx) + Hu @ flat == pytest.approx(numeric, rel=1e-6)


@pytest.mark.parametrize("variant", [{}, {"self_calibration": True}, {"smooth_order": 3}], ids=str)
def test_derivatives_where_the_first_frames_are_given(
    rng: np.random.Generator, wide, variant: dict
) -> None:
    """A window's past: it enters the cost, and nothing moves it."""
    fixed = 3
    recording = synthesis.recording(wavy(12), sensors.SIX, synthesis.Noise(), 1)
    settings = Settings(prior=wide, **variant)
    problem, point = away(recording, settings, rng, fixed=fixed)
    grad, grad_u = problem.gradient(point)
    band = problem.hessian(point)
    assert not grad[:fixed].any()
    h = 1e-6
    for _ in range(4):
        dx = rng.normal(size=point.x.shape)
        dx[:fixed] = 0
        du = rng.normal(size=point.u.shape) if problem.border else np.zeros_like(point.u)
        ends = [problem.point(point.x + s * dx, point.R_ref, point.u + s * du) for s in (-h, h)]
        numeric = (problem.cost(ends[1]) - problem.cost(ends[0])) / (2 * h)
        flat = du.ravel()[: problem.border]
        assert np.vdot(grad, dx) + grad_u @ flat == pytest.approx(numeric, rel=1e-6, abs=1e-4)
        # The matrix of the free frames is that of the whole problem; the given ones are cut off from it.
        whole = build(recording, Skeleton.default(), settings).hessian(point)
        assert np.allclose(band.dot(dx, flat)[0][fixed:], whole.dot(dx, flat)[0][fixed:])
        assert np.allclose(band.dot(dx, flat)[1], whole.dot(dx, flat)[1])
    past = np.zeros_like(point.x)
    past[:fixed] = rng.normal(size=(fixed, problem.n))
    moved, pulled = band.dot(past, np.zeros(problem.border))
    assert np.allclose(moved, past)
    assert not pulled.any()


def test_geometric_jacobians_against_automatic_ones(rng: np.random.Generator) -> None:
    joint, seat = sensors.joints_and_seats(sensors.SUIT)
    k = SensorKinematics(Skeleton.default(), joint, seat)
    inputs = [ca.MX.sym(f"i{i}", *k.values.function.size_in(i)) for i in range(4)]
    ep = k.values.function(*inputs)
    auto = ca.Function("auto", inputs, [ca.jacobian(ca.vec(ep), inputs[0])])
    x = rng.normal(size=(1, k.n)) * 0.6
    R_ref, R_meas = ori.exp(rng.normal(size=(1, 3))), ori.exp(rng.normal(size=(1, k.S, 3)))
    u = rng.normal(size=(k.S, 7)) * 0.2
    _, _, e_x, p_x, _ = k.evaluate(x, R_ref, R_meas, u, True)
    J = auto(x[0], R_ref[0], np.hstack(R_meas[0]), u[:, :4].T).full()
    assert np.allclose(e_x.reshape(3 * k.S, -1), J[: 3 * k.S], atol=1e-10)
    assert np.allclose(p_x.reshape(3 * k.S, -1), J[3 * k.S :], atol=1e-10)


@pytest.mark.parametrize("rate", [25.0, 60.0, 100.0])
def test_truth_is_a_stationary_point(bare: Settings, rate: float) -> None:
    recording = synthesis.recording(wavy(30, rate), sensors.SIX)
    problem = build(recording, Skeleton.default(), bare)
    x, R_ref = initial.from_motion(recording.reference, problem.prior)
    point = problem.point(x, R_ref, np.zeros((problem.S, 7)))
    for term, r in zip(problem.terms, problem.residuals(point), strict=True):
        # Rounding of a second difference: 1e-16 m rate^2 / sigma.
        assert np.abs(r).max() < 1e-8, term.name
    grad, _ = problem.gradient(point)
    assert np.abs(grad / np.sqrt(problem.hessian(point).diagonal + 1e-9)).max() < 1e-6


def test_invalid_samples_have_no_influence(rng: np.random.Generator, wide) -> None:
    clean = synthesis.recording(wavy(20), sensors.SIX)
    valid = np.array(clean.valid)
    valid[5:9, 2] = False
    valid[11] = False
    R, acc = np.array(clean.R_world_bone), np.array(clean.acc_world)
    costs = []
    for junk in (0.0, 1.0):
        R[~valid] = ori.exp(rng.normal(size=3) * junk)
        acc[~valid] = junk * 100
        recording = replace(clean, R_world_bone=R, acc_world=acc, valid=valid)
        problem = build(recording, Skeleton.default(), Settings(prior=wide))
        x, _ = initial.from_motion(clean.reference, problem.prior)
        R_ref = reference_root(clean)
        costs.append(problem.cost(problem.point(x, R_ref, np.zeros((6, 7)))))
    assert costs[0] == costs[1]


def test_sop_is_sip_without_accelerations(recording: Recording, wide) -> None:
    names = {
        terms: [t.name for t in build(recording, Skeleton.default(), s).terms]
        for terms in ("sop", "sip")
        for s in [Settings(prior=wide, terms=terms)]
    }
    assert [n for n in names["sip"] if n != "acceleration"] == names["sop"]


def test_unknowns_are_the_joints_above_sensors() -> None:
    joint, seat = sensors.joints_and_seats(("left_shank", "head"))
    k = SensorKinematics(Skeleton.default(), joint, seat)
    assert k.active == (1, 3, 4, 6, 9, 12, 15)
    assert k.n == 6 + 3 * 7


def test_coarse_accelerations_are_exact_second_differences() -> None:
    motion = wavy(61)
    fine = synthesis.recording(motion, sensors.SIX)
    coarse = initial.coarsened(fine, 4)
    direct = synthesis.recording(
        replace(
            motion,
            rate_hz=15.0,
            R_parent_joint=motion.R_parent_joint[::4],
            p_world_root=motion.p_world_root[::4],
        ),
        sensors.SIX,
    )
    assert coarse.rate_hz == 15.0
    assert np.allclose(coarse.acc_world[1:-1], direct.acc_world[1:-1], atol=1e-9)


def test_passive_joints_follow_from_the_prior(rng: np.random.Generator) -> None:
    """The conditional mean is what minimises the prior's cost over the passive angles."""
    A = rng.normal(size=(69, 69))
    prior = Settings().prior
    prior = replace(prior, covariance=A @ A.T / 69, lower=np.full(69, -9.0), upper=np.full(69, 9.0))
    given = prior.given((1, 2, 4, 5), np.deg2rad(3.0))
    theta = given.complete(given.mean + rng.normal(size=(1, 12)))[0]
    floor = np.deg2rad(3.0) ** 2 * np.diag(np.isin(np.arange(69), given.active).astype(float))
    gradient = np.linalg.solve(prior.covariance + floor, theta - prior.mean)
    assert np.abs(gradient[given.passive]).max() < 1e-6 * np.abs(gradient).max()
    assert kin.BODY.start == 6
