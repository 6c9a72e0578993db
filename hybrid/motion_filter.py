"""Where each sensor should be by its acceleration: one small Kalman filter per sensor.

State: position and velocity of the sensor relative to the pelvis sensor, world axes. Input: difference
of their accelerations. Past solutions enter as measurements with an uncertainty, never as exact: the
extrapolation 2 p_{t-1} - p_{t-2} + a dt^2 has no damping, and turns a network error of centimetres
into metres within a minute.

All axes share one 2x2 covariance per sensor. Model, white acceleration error of density S in m^2/s^3:

    p' = v, v' = a + w,  F = [[1, dt], [0, 1]],  Q = S [[dt^3/3, dt^2/2], [dt^2/2, dt]]
    a linear over the step: dp = v dt + (a_0/3 + a_1/6) dt^2, dv = (a_0 + a_1)/2 dt     (exact)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import checked
from mocap.orientation import Array


@dataclass(frozen=True)
class FilterNoise:
    """Sizes, 1 sigma.

    white: m/s^2 per sample at 60 Hz, of one sensor.
    bias: m/s^2 per axis of one sensor; enters as the white density 2 bias^2 bias_s.
    bias_s: over which the bias forgets itself.
    blind: m/s^2, size of human acceleration: the error where nothing was measured.
    blind_s: its memory.
    solved_m: error of a solved position; as white noise at interval dt it has the variance
    solved_m^2 (1 + 2 solved_s / dt).
    solved_s: over which that error is correlated.
    start_velocity: m/s, at an unknown start.
    widest_m: the position's sigma never exceeds it.
    """

    white: float = 0.35
    bias: float = 0.1
    bias_s: float = 1.0
    blind: float = 5.0
    blind_s: float = 0.1
    solved_m: float = 0.05
    solved_s: float = 1.0
    start_velocity: float = 0.7
    widest_m: float = 0.3

    def __post_init__(self) -> None:
        checked.settings(self, positive=("widest_m",))

    @property
    def density(self) -> float:
        """S in m^2/s^3 of the difference of two sensors."""
        return 2 * (self.white**2 / 60.0 + 2 * self.bias**2 * self.bias_s)

    @property
    def blind_density(self) -> float:
        """S in m^2/s^3 where the acceleration was not measured."""
        return 2 * self.blind**2 * self.blind_s

    def solved_variance(self, dt: float) -> float:
        """Variance in m^2 of a solved position taken as one white measurement every dt s."""
        return self.solved_m**2 * (1 + 2 * self.solved_s / dt)


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """p (S,3) m, v (S,3) m/s; covariance (S,3): the entries pp m^2, pv m^2/s, vv m^2/s^2 of the 2x2
    matrix that all axes share; acc (S,3) m/s^2, the last input.

    A row of NaN in p: this sensor's filter has not started.
    """

    p: Array
    v: Array
    covariance: Array
    acc: Array

    @property
    def running(self) -> np.ndarray:
        """(S,) whether each filter has started."""
        return np.isfinite(self.p[:, 0])


def stopped(sensors: int) -> SensorMotion:
    """Filters that have not started."""
    nan, zero = np.full((sensors, 3), np.nan), np.zeros((sensors, 3))
    return SensorMotion(nan, nan, zero, zero)


def predict(state: SensorMotion, acc: Array, dt: float, noise: FilterNoise) -> SensorMotion:
    """One step of dt s to the time of `acc` (S,3) m/s^2, relative to the pelvis; NaN: not measured."""
    known = np.isfinite(acc.sum(axis=1))
    now = np.where(known[:, None], acc, 0.0)
    before = np.where(known[:, None], state.acc, 0.0)
    p = state.p + state.v * dt + (before / 3 + now / 6) * dt**2
    v = state.v + (before + now) / 2 * dt
    S = np.where(known, noise.density, noise.blind_density)
    pp, pv, vv = state.covariance.T
    pp = pp + 2 * dt * pv + dt**2 * vv + S * dt**3 / 3
    pv = pv + dt * vv + S * dt**2 / 2
    vv = vv + S * dt
    # Too uncertain to be of use: scaling the whole matrix down keeps it positive definite.
    shrink = np.minimum(1.0, noise.widest_m**2 / pp)
    return SensorMotion(p, v, (np.array([pp, pv, vv]) * shrink).T, now)


def update(state: SensorMotion, solved: Array, used: np.ndarray, variance: float) -> SensorMotion:
    """Take solved positions (S,3) m with a variance in m^2 as measurements of the sensors `used` (S,)."""
    pp, pv = state.covariance[:, 0], state.covariance[:, 1]
    gain = np.where(used, 1 / (pp + variance), 0.0)
    error = np.where(used[:, None], solved - state.p, 0.0)
    p = state.p + (gain * pp)[:, None] * error
    v = state.v + (gain * pv)[:, None] * error
    covariance = state.covariance - (gain * np.array([pp * pp, pp * pv, pv * pv])).T
    return SensorMotion(p, v, covariance, state.acc)


def start(
    state: SensorMotion, solved: Array, which: np.ndarray, noise: FilterNoise
) -> SensorMotion:
    """Begin the filters `which` (S,) anew at solved positions (S,3) m, velocity unknown."""
    if not which.any():
        return state
    pick = which[:, None]
    fresh = np.array([noise.solved_m**2, 0.0, noise.start_velocity**2])
    return SensorMotion(
        np.where(pick, solved, state.p),
        np.where(pick, 0.0, state.v),
        np.where(pick, fresh, state.covariance),
        state.acc,
    )
