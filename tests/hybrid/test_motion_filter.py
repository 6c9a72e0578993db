"""The sensors' filters: exact steps, the known steady state, and an hour without drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid import motion_filter as mf
from hybrid.motion_filter import FilterNoise, SensorMotion

QUIET = FilterNoise(white=0.0, bias=0.0)


def at_rest(sensors: int = 1, noise: FilterNoise = QUIET) -> SensorMotion:
    return mf.start(mf.stopped(sensors), np.zeros((sensors, 3)), np.ones(sensors, bool), noise)


def test_a_step_is_exact_for_acceleration_linear_in_time() -> None:
    """a = 2 + 3 t: p = t^2 + t^3 / 2, v = 2 t + 3 t^2 / 2, whatever the steps."""
    state = replace(at_rest(), acc=np.full((1, 3), 2.0))
    t = 0.0
    for dt in (0.1, 0.35, 0.02, 0.7):
        t += dt
        state = mf.predict(state, np.full((1, 3), 2 + 3 * t), dt, QUIET)
    assert np.allclose(state.p, t**2 + t**3 / 2) and np.allclose(state.v, 2 * t + 1.5 * t**2)


def test_covariance_of_two_half_steps_is_that_of_one() -> None:
    noise = FilterNoise(widest_m=100.0)
    acc = np.zeros((1, 3))
    one = mf.predict(at_rest(noise=noise), acc, 0.2, noise).covariance
    two = mf.predict(
        mf.predict(at_rest(noise=noise), acc, 0.08, noise), acc, 0.12, noise
    ).covariance
    assert np.allclose(one, two, rtol=1e-12)


def test_steady_state_is_the_closed_form() -> None:
    """Double integrator with acceleration density S, position density r: the Riccati equation gives
    P11 = sqrt(2) S^(1/4) r^(3/4), P12 = sqrt(S r), P22 = sqrt(2) S^(3/4) r^(1/4).
    """
    noise, dt = FilterNoise(widest_m=10.0), 1e-3
    r = 4e-4
    state = at_rest(noise=noise)
    for _ in range(8000):
        state = mf.predict(state, np.zeros((1, 3)), dt, noise)
        state = mf.update(state, np.zeros((1, 3)), np.array([True]), r / dt)
    S = noise.density
    P11, P12, P22 = (np.sqrt(2) * S**0.25 * r**0.75, np.sqrt(S * r), np.sqrt(2) * S**0.75 * r**0.25)
    assert np.allclose(state.covariance[0], [P11, P12, P22], rtol=5e-3)


def test_an_update_is_bayes_rule() -> None:
    """Prior N(0, P), measurement of the position: the posterior's information is the sum."""
    prior = np.array([[0.04, 0.01], [0.01, 0.09]])
    state = replace(at_rest(), covariance=np.array([[0.04, 0.01, 0.09]]))
    out = mf.update(state, np.full((1, 3), 0.5), np.array([True]), 0.02)
    information = np.linalg.inv(prior) + np.diag([1 / 0.02, 0])
    posterior = np.linalg.inv(information)
    assert np.allclose(out.covariance[0], posterior[[0, 0, 1], [0, 1, 1]])
    mean = np.linalg.inv(information) @ [0.5 / 0.02, 0]
    assert np.allclose(out.p, mean[0]) and np.allclose(out.v, mean[1])


def test_what_is_not_used_stays_and_what_is_not_measured_grows_uncertain() -> None:
    noise = FilterNoise()
    state = at_rest(2, noise)
    acc = np.array([[1.0, 0, 0], [np.nan, 0, 0]])
    ahead = mf.predict(state, acc, 0.02, noise)
    assert ahead.covariance[1, 0] > ahead.covariance[0, 0] and not ahead.v[1].any()
    kept = mf.update(ahead, np.full((2, 3), np.nan), np.zeros(2, bool), 0.01)
    assert np.array_equal(kept.p, ahead.p) and np.array_equal(kept.covariance, ahead.covariance)
    gone = mf.stopped(2)
    assert not gone.running.any() and mf.start(gone, acc, np.array([1, 0], bool), noise).running[0]


@pytest.mark.parametrize(("rate_hz", "minutes"), [(10.0, 60), (60.0, 3)])
def test_an_hour_with_a_biased_network_does_not_drift(rate_hz: float, minutes: int) -> None:
    """Positions from a network that errs by 5 cm, slowly changing, and an accelerometer with bias.

    The solve is the one-dimensional QP: the mean of prediction and network, weighted by their
    variances. Extrapolating past answers as exact, p = 2 p_1 - p_2 + a dt^2 with sigma_acc dt^2, has
    drifted by metres after a minute of the same input.
    """
    noise, dt, net_variance = FilterNoise(), 1 / rate_hz, 0.05**2
    rng = np.random.default_rng(3)
    T = int(60 * minutes * rate_hz)
    t = np.arange(T)[:, None] * dt
    speed = 2 * np.pi * np.array([0.4, 1.0, 2.0])  # rad/s, one axis each
    truth, acc = 0.3 * np.sin(speed * t), -0.3 * speed**2 * np.sin(speed * t)
    measured = acc + 0.14 + rng.normal(size=(T, 3)) * 0.5 * np.sqrt(rate_hz / 60)
    network = truth + 0.03 + 0.05 * np.sin(2 * np.pi * t / 7)
    solved, variance = network.copy(), np.zeros(T)
    one = np.array([True])
    state = mf.start(mf.stopped(1), network[:1], one, noise)
    for k in range(1, T):
        state = mf.predict(state, measured[k : k + 1], dt, noise)
        P = variance[k] = state.covariance[0, 0]
        solved[k] = (state.p[0] / P + network[k] / net_variance) / (1 / P + 1 / net_variance)
        state = mf.update(state, solved[k : k + 1], one, noise.solved_variance(dt))
    error = np.abs(solved - truth).max(axis=1)
    assert variance.max() < 0.2**2
    assert error.max() < 0.25
    # No growth: the last fifth is as good as the second.
    fifth = T // 5
    assert error[-fifth:].mean() < 1.1 * error[fifth : 2 * fifth].mean()
    naive = list(network[:2])
    weight = np.array([1 / (0.5 * dt**2) ** 2, 1 / net_variance])
    for k in range(2, int(60 * rate_hz)):
        predicted = 2 * naive[-1] - naive[-2] + measured[k - 1] * dt**2
        naive.append((weight[0] * predicted + weight[1] * network[k]) / weight.sum())
    assert np.abs(np.array(naive) - truth[: len(naive)]).max() > 5 * error.max()
