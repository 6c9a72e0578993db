"""Terms that make gradient and matrix themselves, for speed, and what the base makes of their stencils."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip import initial
from sip.problem import Problem, build, grounded
from sip.settings import Settings
from sip.solvers.band import Band
from sip.terms.acceleration import Acceleration
from sip.terms.base import Point, Stencil, Term
from sip.terms.contact import Contact
from sip.terms.network import NetworkPose
from tests.sip.test_network import near, told


def acceleration(term: Acceleration, point: Point) -> Stencil:
    J, G = term._jacobian(point)
    M, S = term.weight.shape[:2]
    J = J.reshape(len(J), 3 * S, -1)
    weight = np.broadcast_to(term.weight, (M, S, 3)).reshape(M, 3 * S)
    blocks = {0: J[:-2], 1: -2 * J[1:-1], 2: J[2:]}
    return Stencil(blocks, weight=weight, of_sensors=G, constants=slice(3, 7))


def network(term: NetworkPose, point: Point) -> Stencil:
    slopes = np.swapaxes(term._slopes(point), 2, 3) * term.belief.scale.reshape(
        len(point.x), -1, 3, 1
    )
    T, a = slopes.shape[:2]
    J = np.zeros((T, 3 * a, 3 * a))
    for k in range(a):
        J[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = slopes[:, k]
    L = np.broadcast_to(term.belief.L, (T, 3 * a, 3 * a))
    return Stencil({0: np.swapaxes(L, 1, 2) @ J}, term.columns)


def _compare(problem: Problem, point: Point, term: Term, stencil: Stencil) -> None:
    made = type(
        "Plain",
        (Term,),
        {"name": term.name, "reach": term.reach, "stencil": lambda self, point: stencil},
    )()
    v = np.random.default_rng(3).normal(size=term.residual(point).shape)
    grads, bands = [], []
    for one in (term, made):
        grad, grad_u = np.zeros((problem.T, problem.n)), np.zeros((problem.S, 7))
        one.pullback(point, v, grad, grad_u)
        band = Band.zeros(problem.T, problem.reach, problem.n, problem.border)
        one.hessian(point, band)
        grads.append((grad, grad_u))
        bands.append(band.dense())
    for own, base in zip(*grads, strict=True):
        np.testing.assert_allclose(own, base, rtol=1e-9, atol=1e-9 * np.abs(base).max(initial=1))
    np.testing.assert_allclose(bands[0], bands[1], rtol=1e-9, atol=1e-10 * np.abs(bands[1]).max())
    assert np.abs(bands[0]).max() > 0


@pytest.mark.parametrize("calibrating", [False, True])
def test_acceleration(recording: Recording, rng: np.random.Generator, calibrating: bool) -> None:
    """Without robustness, which the base has not."""
    settings = Settings(self_calibration=calibrating, robust_delta=1e9)
    problem = build(recording.slice(0, 12), Skeleton.default(), settings)
    assert recording.reference is not None
    x, R_ref = initial.from_motion(recording.reference.slice(0, 12), problem.prior)
    u = rng.normal(size=(problem.S, 7)) * 0.05 * calibrating
    point = problem.point(x + rng.normal(size=x.shape) * 0.05, R_ref, u)
    (term,) = [t for t in problem.terms if isinstance(t, Acceleration)]
    _compare(problem, point, term, acceleration(term, point))


def test_network(recording: Recording, rng: np.random.Generator) -> None:
    """Its joints are whitened together, and each turns by its own unknowns alone."""
    few = recording.slice(0, 12)
    problem = told(few, near(few, rng, 0.2, True), Settings())
    assert few.reference is not None
    x, R_ref = initial.from_motion(few.reference, problem.prior)
    point = problem.point(x + rng.normal(size=x.shape) * 0.1, R_ref, np.zeros((problem.S, 7)))
    (term,) = [t for t in problem.terms if isinstance(t, NetworkPose)]
    _compare(problem, point, term, network(term, point))


def test_contact(recording: Recording, rng: np.random.Generator) -> None:
    few = recording.slice(0, 12)
    problem = build(few, Skeleton.default(), Settings())
    assert few.reference is not None
    x, R_ref = initial.from_motion(few.reference, problem.prior)
    point = problem.point(x + rng.normal(size=x.shape) * 0.1, R_ref, np.zeros((problem.S, 7)))
    (term,) = [t for t in grounded(problem, point).terms if isinstance(t, Contact)]
    term.weight = rng.uniform(size=term.weight.shape)  # whether or not one of them stands
    J = term._slopes(point)
    J = J.reshape(len(J), 3 * term.soles.P, -1)
    weight = np.repeat(term.weight, 3, axis=2).reshape(len(term.weight), -1)
    _compare(problem, point, term, Stencil({0: -J[:-1], 1: J[1:]}, weight=weight))
