"""From the source's rate to the network's, sample by sample.

Tick k of the network is k / rate on our own clock (`holding`). Orientations are interpolated geodesically.
Networks are trained on accelerations that are second differences of positions at the network's own rate,
(p(t - T) - 2 p(t) + p(t + T)) / T^2 with T = 1 / rate, which is the acceleration averaged over t - T to
t + T with triangular weights. So is done here: weights max(0, 1 - |t_i - t| / w), w the longer of the two
periods, divided by their sum. Where the source runs n times as fast this gives exactly the second difference
at the network's rate; where it runs slower, linear interpolation; where the rates are equal, the sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from learned.online.holding import Held
from mocap import orientation as ori
from mocap.orientation import Array

_EQUAL = 1e-6  # relative difference of rates below which nothing is resampled
_ROUNDING_S = 1e-9


def equal(rate_hz: float, network_hz: float) -> bool:
    """Whether the source runs at the network's rate."""
    return abs(rate_hz - network_hz) <= _EQUAL * network_hz


def reach_s(rate_hz: float, network_hz: float) -> float:
    """How far around a tick its acceleration is averaged: s to either side."""
    return max(1 / rate_hz, 1 / network_hz)


def look_ahead(rate_hz: float, network_hz: float, future: int) -> int:
    """Samples of the source that must follow a sample before its pose can be interpolated.

    The next tick is up to one period of the network later, its window ends `future` ticks later, and the
    average around that one reaches `reach_s` further.
    """
    if equal(rate_hz, network_hz):
        return future
    wait = (future + 1) / network_hz + reach_s(rate_hz, network_hz)
    return int(np.ceil(wait * rate_hz - 1e-6))


def due(recent: tuple[Held, ...], tick_s: float, reach: float) -> bool:
    """Whether everything that the tick needs has come."""
    return recent[-1].time_s >= tick_s + reach - _ROUNDING_S


def at_tick(recent: tuple[Held, ...], tick_s: float, reach: float) -> tuple[Array, Array]:
    """R_world_bone (S,3,3) and acc_world (S,3) m/s^2 at a tick that is due.

    A sensor's samples before its first orientation hold that one, and the acceleration with it: they measured
    nothing, and what stands for it (`holding.take`) must not be mixed into the first ticks.
    """
    times = np.array([h.time_s for h in recent])
    k = int(np.clip(np.searchsorted(times, tick_s + _ROUNDING_S, side="right") - 1, 0, None))
    seen = np.isfinite([h.seen_s for h in recent])  # (n,S), and from a sensor's first one on
    shown = np.maximum(np.arange(len(recent))[:, None], seen.argmax(0))
    sensor = np.arange(seen.shape[1])
    R_shown = np.stack([h.R_world_bone for h in recent])[shown, sensor]
    acc_shown = np.stack([h.acc_world for h in recent])[shown, sensor]
    R = ori.interpolate(times[k : k + 2], R_shown[k : k + 2], [tick_s])[0]
    if k + 1 < len(times):  # samples further apart than they should be: never between all of them
        reach = max(reach, float(times[k + 1] - times[k]))
    weight = np.maximum(0.0, 1 - np.abs(times - tick_s) / reach)
    return R, np.tensordot(weight / weight.sum(), acc_shown, 1)


def present_at(recent: tuple[Held, ...], tick_s: float) -> NDArray[np.bool_]:
    """(S,): the sensors that were there at the sample nearest to a tick."""
    return min(recent, key=lambda h: abs(h.time_s - tick_s)).present


def needed(recent: tuple[Held, ...], tick_s: float, reach: float) -> tuple[Held, ...]:
    """The samples that this tick and later ones read: from the last one at or before its reach."""
    before = sum(1 for h in recent if h.time_s <= tick_s - reach)
    return recent[max(0, before - 1) :]
