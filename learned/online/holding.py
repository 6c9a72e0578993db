"""Samples as they come: what cannot be used is replaced by the last value that could.

What counts is decided by `mocap.gate`. Clocks of live sources stutter and jump. `Held.time_s` is a clock
of our own that always advances: by what the time stamps say where that is plausible, else by one nominal
period.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap import gate
from mocap.estimator import Sample
from mocap.orientation import Array
from mocap.recording import Recording

HOLD_S = 0.5  # a loss up to this long holds the last value; after it the sensor counts as lost
GAP_S = 0.5  # a step of the clock beyond this is a jump: no motion is invented for it


@dataclass(frozen=True, eq=False)
class Held:
    """S sensors now: time_s on our clock; R_world_bone (S,3,3), acc_world (S,3) m/s^2, last valid ones.

    seen_s (S,): time of each sensor's last valid orientation, -inf where there was none. stamp_s: the
    sample's own time. jumped: the source's clock jumped just before this sample.
    """

    time_s: float
    stamp_s: float
    R_world_bone: Array
    acc_world: Array
    seen_s: Array
    jumped: bool

    @property
    def present(self) -> NDArray[np.bool_]:
        """(S,): sent a valid orientation within `HOLD_S`."""
        out: NDArray[np.bool_] = self.time_s - self.seen_s <= HOLD_S + 1e-9
        return out


def take(before: Held | None, sample: Sample, rate_hz: float) -> Held:
    """The sensors after `sample`. Before a sensor's first valid value: identity and zero.

    Orientation and acceleration are held separately: a sample may lack one of them.
    """
    S = len(sample.valid)
    R, acc = np.array(sample.R_world_bone, float), np.array(sample.acc_world, float)
    valid = np.asarray(sample.valid, bool)
    turned, moved, _ = gate.judge(R, acc, valid)
    if before is None:
        start_s = sample.time_s if np.isfinite(sample.time_s) else 0.0
        before = Held(
            -1 / rate_hz, start_s - 1 / rate_hz, np.tile(np.eye(3), (S, 1, 1)),
            np.zeros((S, 3)), np.full(S, -np.inf), False,
        )  # fmt: skip
    dt = sample.time_s - before.stamp_s
    jumped = bool(abs(dt) > GAP_S)
    if not 0 < dt <= GAP_S:  # NaN too
        dt = 1 / rate_hz
    now = before.time_s + dt
    stamp = sample.time_s if np.isfinite(sample.time_s) else before.stamp_s + dt
    return Held(
        now,
        stamp,
        np.where(turned[:, None, None], R, before.R_world_bone),
        np.where(moved[:, None], acc, before.acc_world),
        np.where(turned, now, before.seen_s),
        jumped,
    )


def there(recording: Recording) -> NDArray[np.bool_]:
    """(T,S): the sensors that the online runner takes for worn (`Held.present`):
    with a valid orientation in the `HOLD_S` before; or the first one in those after, which stands for
    what was before it.
    """
    ok, hold = recording.ori_valid, HOLD_S * recording.rate_hz + 1e-6
    t = np.arange(len(ok))[:, None]
    last = np.maximum.accumulate(np.where(ok, t, -np.inf), axis=0)
    first = np.where(ok.any(0), ok.argmax(0), np.inf)
    out: NDArray[np.bool_] = (t - last <= hold) | ((first > t) & (first - t <= hold))
    return out
