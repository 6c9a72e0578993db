"""Steps between bounds against SciPy's bounded least squares, and the solver that takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from mocap import Skeleton, sensors, synthesis
from sip import Settings, initial
from sip.problem import build
from sip.solvers import banded, box
from tests.sip.conftest import wavy
from tests.sip.solvers.test_band import dense, random_band


@pytest.mark.parametrize("g", [0, 3])
def test_step_minimises_within_the_box(rng: np.random.Generator, g: int) -> None:
    """min |L^T d + L^-1 grad|^2 / 2 over the box, L L^T = H + D, is the same problem."""
    T, n = 8, 3
    for _ in range(20):
        band = random_band(rng, T, 2, n, g)
        grad, grad_u = rng.normal(size=(T, n)) * 30, rng.normal(size=g) * 30
        edges = np.full((T, n), 0.5)
        edges[:, 2] = np.inf
        x = rng.uniform(-0.5, 0.5, size=(T, n))
        x[0, 0] = 0.5
        damping = rng.uniform(1, 2, size=n)
        limits = box.Box(-edges, edges)
        dx, du, settled = box.bounded_step(band, grad, grad_u, damping, 0.7, x, limits)
        assert settled
        H = dense(band) + np.diag(np.r_[np.tile(damping, T), np.full(g, 0.7)])
        L = np.linalg.cholesky(H)
        free = np.full(g, np.inf)
        bounds = (np.r_[(-edges - x).ravel(), -free], np.r_[(edges - x).ravel(), free])
        ours = np.r_[grad.ravel(), grad_u]
        best = lsq_linear(L.T, -np.linalg.solve(L, ours), bounds, tol=1e-14)
        assert np.allclose(np.r_[dx.ravel(), du], best.x, atol=1e-6)
        assert 2 < (np.abs(x + dx) == 0.5).sum() < T * n


def test_bounded_minimum_is_stationary() -> None:
    """Inside the box nothing pulls, on it everything pushes outward: the conditions of a minimum."""
    frames = 10
    recording = synthesis.recording(wavy(frames), sensors.FIVE)
    narrow = replace(Settings().prior, lower=np.full(69, -0.1), upper=np.full(69, 0.1))
    problem = build(recording, Skeleton.default(), Settings(prior=narrow, tolerance=1e-11))
    x, R_ref = initial.from_prior(recording, Skeleton.default(), problem.prior, 0, frames)
    result = banded.minimise(problem, x, R_ref, np.zeros((problem.S, 7)), box=problem.box)
    limits, point = problem.box, result.point
    assert (point.x >= limits.lower).all() and (point.x <= limits.upper).all()
    grad, _ = problem.gradient(point)
    grad /= np.sqrt(problem.hessian(point).diagonal)
    low, high = point.x == limits.lower, point.x == limits.upper
    assert (low | high).sum() > 30
    assert np.abs(grad[~low & ~high]).max() < 1e-4
    assert grad[low].min() > -1e-4
    assert grad[high].max() < 1e-4
    assert result.gradient_norm < 1e-4
