"""The QP against a dense reference solver, and the residual by which it judges itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hybrid.limb_qp import ACCEPTED_KKT, LimbQP, kkt_residual


def problem(
    rng: np.random.Generator, n: int, m: int, width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """M, b, lower, upper of |M x - b|^2 in a box that holds zero or not; units differ by a thousand."""
    unit = 10 ** rng.uniform(-1.5, 1.5, n)
    M = np.vstack([rng.normal(size=(m, n)), 0.3 * np.eye(n)]) * unit
    b = rng.normal(size=m + n)
    centre = rng.normal(size=n) * width / unit
    half = rng.uniform(0, width, n) / unit
    return M, b, centre - half, centre + half


@pytest.mark.parametrize("n", [3, 18, 45])
@pytest.mark.parametrize("width", [0.05, 0.5, 50.0])
def test_agrees_with_a_dense_reference_solver(
    rng: np.random.Generator, n: int, width: float
) -> None:
    qp = LimbQP(n)
    for _ in range(8):
        M, b, lower, upper = problem(rng, n, n // 2 + 1, width)
        answer = qp.solve(M.T @ M, -M.T @ b, lower, upper)
        reference = lsq_linear(M, b, (lower, upper), method="bvls", tol=1e-13, max_iter=1000).x
        assert answer.ok
        scale = 1 / np.sqrt(np.diag(M.T @ M))
        size = np.linalg.eigvalsh((M * scale).T @ (M * scale))
        # For a strongly convex problem |x - x*| <= (1 + L) / mu |residual of the projected gradient|.
        worst = (1 + size[-1]) / size[0] * np.sqrt(n) * 3e-4
        assert np.linalg.norm((answer.x - reference) / scale) < worst
        assert answer.kkt < 3e-4
        cost, best = (np.sum((M @ x - b) ** 2) for x in (answer.x, reference))
        assert cost <= best + 1e-4 * (1 + best)
        assert np.all(answer.x >= lower) and np.all(answer.x <= upper)


def test_without_an_active_bound_it_is_the_newton_step(rng: np.random.Generator) -> None:
    M = rng.normal(size=(30, 12))
    H, g = M.T @ M, rng.normal(size=12)
    answer = LimbQP(12).solve(H, g, np.full(12, -np.inf), np.full(12, np.inf))
    assert np.allclose(answer.x, -np.linalg.solve(H, g), rtol=1e-9)
    assert answer.ok and answer.iterations == 0


def test_earlier_problems_leave_no_trace(rng: np.random.Generator) -> None:
    problems = [problem(rng, 20, 11, 0.2) for _ in range(6)]
    used, answers = LimbQP(20), []
    for M, b, lower, upper in problems:
        answers.append(used.solve(M.T @ M, -M.T @ b, lower, upper).x)
    for (M, b, lower, upper), x in zip(problems, answers, strict=True):
        fresh = LimbQP(20).solve(M.T @ M, -M.T @ b, lower, upper).x
        assert np.array_equal(fresh, x)


@pytest.mark.parametrize("spoilt", ["H", "g", "indefinite", "zero"])
def test_what_is_no_problem_is_refused(spoilt: str) -> None:
    H, g = np.eye(6), np.ones(6)
    if spoilt == "H":
        H[2, 3] = H[3, 2] = np.nan
    elif spoilt == "g":
        g[1] = np.nan
    elif spoilt == "indefinite":
        H[0, 1] = H[1, 0] = 2
    else:
        H[4, 4] = 0
    qp = LimbQP(6)
    assert not qp.solve(H, g, np.full(6, -1.0), np.full(6, 1.0)).ok
    good = qp.solve(np.eye(6), np.ones(6), np.full(6, -0.5), np.full(6, 1.0))
    assert good.ok and np.allclose(good.x, -0.5, atol=1e-4)


def test_a_box_of_one_point_and_an_infinite_one() -> None:
    lower = np.array([0.3, -np.inf, -1.0])
    upper = np.array([0.3, np.inf, -1.0])
    answer = LimbQP(3).solve(np.eye(3), -np.ones(3), lower, upper)
    assert answer.ok and np.allclose(answer.x, [0.3, 1.0, -1.0], atol=1e-4)


def test_an_answer_that_is_not_optimal_is_not_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    """OSQP stopped after one iteration far from the minimum still reports x; the residual refuses it."""
    qp = LimbQP(24)
    rng = np.random.default_rng(5)
    M, b, lower, upper = problem(rng, 24, 13, 0.05)
    qp._solver.update_settings(max_iter=1, check_termination=1)
    answer = qp.solve(M.T @ M, -M.T @ b, lower, upper)
    assert answer.kkt > ACCEPTED_KKT and not answer.ok


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 8))
@settings(max_examples=60, deadline=None)
def test_kkt_residual_is_zero_at_the_minimum_only(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    M, b, lower, upper = problem(rng, n, n + 1, 0.3)
    scale = 1 / np.linalg.norm(M, axis=0)
    M, lower, upper = M * scale, lower / scale, upper / scale
    P, q = M.T @ M, -M.T @ b
    x = lsq_linear(M, b, (lower, upper), method="bvls", tol=1e-13, max_iter=1000).x
    assert kkt_residual(P, q, lower, upper, x) < 1e-7
    i = int(np.argmax(upper - lower))
    other = x.copy()
    other[i] += (
        0.5
        * max(upper[i] - x[i], x[i] - lower[i])
        * (1 if upper[i] - x[i] > x[i] - lower[i] else -1)
    )
    assert kkt_residual(P, q, lower, upper, other) > 1e-9 * (upper[i] - lower[i])
