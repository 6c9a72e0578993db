"""What leaves a window: against the dense Schur complement, the Kalman filter and the fixed-lag smoother."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import Skeleton, sensors, synthesis
from mocap.orientation import Array
from sip import Horizon, HorizonSettings, Settings
from sip.model import Evidence
from sip.solvers.band import Band
from sip.terms.arrival import Arrival, eliminated
from sip.terms.base import Point
from tests.sip.conftest import wavy

NOTHING = np.zeros(0)


def quadratic(rng: np.random.Generator, size: int) -> tuple[Array, Array]:
    A = rng.normal(size=(size, size + 5))
    return A @ A.T, rng.normal(size=size)


def gradient(arrival: Arrival, x: Array, u: Array) -> tuple[Array, Array]:
    grad, grad_u = np.zeros_like(x), np.zeros_like(u)
    point = Point(x, NOTHING, u, NOTHING, NOTHING)
    arrival.pullback(point, arrival.residual(point), grad, grad_u)
    return grad, grad_u


@pytest.mark.parametrize("sensors_", [0, 2])
def test_elimination_is_the_dense_schur_complement(rng: np.random.Generator, sensors_: int) -> None:
    n, frames, g = 4, 3, 7 * sensors_
    H, b = quadratic(rng, n * frames + g)
    x, u = rng.normal(size=(frames, n)), rng.normal(size=(max(1, sensors_), 7))
    a = eliminated(H, b, frames, x, u, 1.0, np.zeros(g))
    schur = H[n:, n:] - H[n:, :n] @ np.linalg.solve(H[:n, :n], H[:n, n:])
    assert np.allclose(a.H, schur)
    left = b[n:] - H[n:, :n] @ np.linalg.solve(H[:n, :n], b[:n])
    grad, grad_u = gradient(a, x[1:], u)
    assert np.allclose(grad.ravel(), left[: 2 * n])
    assert np.allclose(grad_u.ravel()[:g], left[2 * n :])
    band = Band.zeros(frames, 2, n, g)
    a.hessian(Point(x, NOTHING, u, NOTHING, NOTHING), band)
    assert np.allclose(band.dense()[: 2 * n, : 2 * n], schur[: 2 * n, : 2 * n])
    assert np.allclose(band.dense()[3 * n :, : 2 * n], schur[2 * n :, : 2 * n])


def test_the_discount_widens_the_frames_and_the_walk_the_constants(
    rng: np.random.Generator,
) -> None:
    n, frames, g = 4, 3, 7
    H, b = quadratic(rng, n * frames + g)
    x, u, walk = rng.normal(size=(frames, n)), rng.normal(size=(1, 7)), rng.uniform(1, 2, 7)
    whole = eliminated(H, b, frames, x, u, 1.0, np.zeros(g))
    faded = eliminated(H, b, frames, x, u, 0.5, walk)
    cut = 2 * n
    # Given the constants the frames are half as sure; the constants' own variance grows by the walk.
    assert np.allclose(faded.H[:cut, :cut], 0.5 * whole.H[:cut, :cut])
    own = [np.linalg.inv(a.H)[cut:, cut:] for a in (whole, faded)]
    assert np.allclose(own[1], own[0] + np.diag(walk))
    # What is most likely does not move.
    best = [np.linalg.solve(a.H, a.R.T @ a.z) for a in (whole, faded)]
    assert np.allclose(best[0], best[1])


def test_constants_that_walk_are_a_kalman_filter(rng: np.random.Generator) -> None:
    """A constant measured every frame: the filter's mean and variance, step by step."""
    q, r = 0.3, 2.0
    mean, variance = 0.0, 4.0
    walk = np.r_[q, np.zeros(6)]
    a = Arrival(np.diag(np.r_[0.5, np.ones(6)]), np.zeros(7), np.zeros((0, 1)), np.zeros((1, 7)))
    for y in rng.normal(size=30):
        H = np.eye(8)
        H[1:, 1:] = a.H
        g = np.r_[0.0, a.R.T @ a.residual(Point(np.zeros((1, 1)), *[np.zeros((1, 7))] * 4))]
        H[1, 1] += 1 / r
        g[1] -= y / r
        a = eliminated(H, g, 1, np.zeros((1, 1)), np.zeros((1, 7)), 1.0, walk)
        gain = variance / (variance + r)
        mean, variance = mean + gain * (y - mean), (1 - gain) * variance + q
        assert np.linalg.inv(a.H)[0, 0] == pytest.approx(variance)
        assert -np.linalg.solve(a.H, a.R.T @ a.z)[0] == pytest.approx(mean)


def test_a_linear_problem_is_the_fixed_lag_smoother(rng: np.random.Generator) -> None:
    """x_t = 2 x_{t-1} - x_{t-2} + w, measured with noise: the Rauch-Tung-Striebel smoother of each window."""
    T, N, q, r, first = 40, 6, 0.2, 1.5, 10.0
    y = np.cumsum(rng.normal(size=T)) * 0.3
    F, Q = np.array([[2.0, -1.0], [1.0, 0.0]]), np.diag([q, 0.0])
    at_zero = np.zeros((1, 7))
    arrival = Arrival(np.eye(2) / np.sqrt(first), np.zeros(2), np.zeros((2, 1)), at_zero)
    means, variances = [], []
    m, P = np.zeros(2), np.eye(2) * first
    for t in range(1, T):
        if t > 1:
            m, P = F @ m, F @ P @ F.T + Q
        for k in (0,) if t > 1 else (1, 0):  # state: (x_t, x_{t-1})
            h = np.eye(2)[k]
            gain = P @ h / (h @ P @ h + r)
            m, P = m + gain * (y[t - k] - h @ m), P - np.outer(gain, h @ P)
        means.append(m)
        variances.append(P)
    for begin in range(T - N):
        # Window begin..begin+N-1: what the arrival knows, its measurements and its dynamics.
        H, g = np.eye(N) / r, -y[begin : begin + N] / r
        for t in range(N - 2):
            d = np.zeros(N)
            d[t : t + 3] = 1, -2, 1
            H += np.outer(d, d) / q
        H[:2, :2] += arrival.H
        g[:2] += arrival.R.T @ arrival.z
        window = -np.linalg.solve(H, g)
        last = begin + N - 2  # of `means`: the state of the window's last frame
        assert window[-1] == pytest.approx(means[last][0])
        s = means[last]
        S = variances[last]
        for k in range(last - 1, last - 3, -1):
            ahead = F @ variances[k] @ F.T + Q
            back = variances[k] @ F.T @ np.linalg.inv(ahead)
            s = means[k] + back @ (s - F @ means[k])
            S = variances[k] + back @ (S - ahead) @ back.T
            assert window[k - begin + 1] == pytest.approx(s[0])
            assert np.linalg.inv(H)[k - begin + 1, k - begin + 1] == pytest.approx(S[0, 0])
        lead, pull = np.eye(3)[0] / r, np.zeros((3, 3))
        pull[0] = lead
        d = np.array([1.0, -2.0, 1.0])
        pull += np.outer(d, d) / q
        pull[:2, :2] += arrival.H
        b = np.r_[arrival.R.T @ arrival.z, 0.0]
        b[0] -= y[begin] / r
        arrival = eliminated(pull, b, 3, np.zeros((3, 1)), at_zero, 1.0, np.zeros(0))


def test_what_leaves_is_taken_from_the_whole(rng: np.random.Generator) -> None:
    """The window's matrix without its oldest frame, plus what that frame left, is the Schur complement of the
    window's matrix with it: nothing is counted twice or lost.
    """
    recording = synthesis.recording(wavy(12), sensors.FIVE, synthesis.Noise(), 1)
    how = HorizonSettings(
        seconds=10 / 60, memory_s=np.inf, walk_mounting=0, walk_heading=0, walk_bias=0
    )
    settings = Settings(self_calibration=True)
    horizon = Horizon(Skeleton.default(), recording.joint, recording.placement, 60.0, settings, how)
    evidence, state = Evidence.of(recording), horizon.init()
    for t in range(11):
        state = horizon.step(state, evidence.slice(t, t + 1))
    assert state.point is not None
    before = horizon.problem(state).hessian(state.point).dense()
    n = horizon.kinematics.n
    schur = before[n:, n:] - before[n:, :n] @ np.linalg.solve(before[:n, :n], before[:n, n:])
    after = horizon.without_oldest(state)
    assert after.point is not None and len(after) == 9
    dense = horizon.problem(after).hessian(after.point).dense()
    size = np.sqrt(np.outer(np.diag(schur), np.diag(schur)))
    assert np.abs((dense - schur) / size).max() < 1e-7
