"""Orientations that were written or read the wrong way: transposed, quaternions rolled, another world.

A reading of R_world_sensor is right if gyr is the rate at which it turns and if it turns acc upright, in
the mean. Both say so of the right one alone: transposing or rolling makes the rate another one, except
for sensors that hardly turn, of which nothing is said.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mocap import orientation as ori
from mocap.calibration.checks.axes import from_up, relative
from mocap.calibration.checks.units import TURNING, turning
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import Bool

# Mean square over g^2 of acc's distance from upright, and square of gyr's relative distance from the rate,
# that leave no doubt of the reading given, and that another reading must reach to be named.
WELL_UP, WELL_RATE = 0.03, 0.16
UP, RATE = 0.05, 0.12
MIN_WINDOWS = 4  # the rate tells, too
GAIN = 4.0  # by how much the sum of the two must fall


def _transposed(R: Array) -> Array:
    return np.swapaxes(R, -1, -2)


def _rolled(R: Array, by: int) -> Array:
    """R (...,3,3) if the four numbers of its quaternions (w, x, y, z) are rolled by that many places."""
    out = np.full(R.shape, np.nan)
    has = np.isfinite(R).all((-1, -2))
    out[has] = ori.from_quat(np.roll(ori.to_quat(R[has]), by, axis=-1))
    return out


Mend = Callable[[Array], Array]
MENDS: tuple[tuple[str, str, Mend], ...] = (
    (
        "orientation-transposed",
        "orientation is given as sensor-from-world (transposed), world-from-sensor is expected",
        _transposed,
    ),
    (
        "quaternion-order",
        "quaternions look like x, y, z, w where w, x, y, z was taken for granted",
        lambda R: _rolled(R, 1),
    ),
    (
        "quaternion-order",
        "quaternions look like w, x, y, z that were taken for x, y, z, w",
        lambda R: _rolled(R, -1),
    ),
)
_WORLD = (
    "orientation-world",
    "orientation is given in another world, its up is {} here and must be y (--units y-up or z-up tells "
    "readers of text files)",
)


def check_orientation(
    name: str, gyr: Array, acc: Array, R: Array, has: Bool, rate_hz: float
) -> Finding | None:
    """What explains gyr and acc (T,3) if R (T,3,3) of one sensor does not; None if it does or nothing is.

    Files whose world is z-up were turned into ours, before or instead of what mends them.
    """
    given = _score(gyr, acc, R, has, rate_hz)
    if given is None or (given[0] < WELL_UP and given[1] < WELL_RATE):
        return None
    tried: list[tuple[float, str, str]] = []
    zup = ori.R_YUP_ZUP
    for code, text, mend in MENDS:
        for before in (np.eye(3), zup.T):
            mended = mend(before @ R)
            for after in (np.eye(3), zup):
                tried += _tried(code, text, given, _score(gyr, acc, after @ mended, has, rate_hz))
    for axis, world in (("z", zup), ("-z", zup.T)):
        told = _WORLD[1].format(axis)
        tried += _tried(_WORLD[0], told, given, _score(gyr, acc, world @ R, has, rate_hz))
    if not tried:
        return None
    _, code, text = min(tried)
    up = float(np.degrees(2 * np.arcsin(min(1.0, np.sqrt(given[0]) / 2))))
    head = (
        f"sensor {name}: turned by its orientation, acc is {up:.0f} deg from upright in the mean, and gyr "
        f"is {np.sqrt(given[1]):.0%} off the rate of it: "
    )
    return Finding("error", name, code, head + text, up)


def _score(
    gyr: Array, acc: Array, R: Array, has: Bool, rate_hz: float
) -> tuple[float, float] | None:
    """Mean square over g^2 of acc's distance from upright, square of gyr's relative one from the rate.

    None where the sensor hardly turns, or there is too little of it.
    """
    wanders = from_up(R, acc, has, rate_hz, MIN_WINDOWS)
    w, g = turning(gyr, R, has, rate_hz)
    if wanders is None or (g**2).sum() < TURNING**2 * len(g):
        return None
    return float(wanders[0].mean()), relative(g, w) ** 2


def _tried(
    code: str, text: str, given: tuple[float, float], score: tuple[float, float] | None
) -> list[tuple[float, str, str]]:
    """The reading with the sum of its score, if that explains what `given` does not."""
    if score is None or score[0] > UP or score[1] > RATE or sum(given) < GAIN * sum(score):
        return []
    return [(sum(score), code, text)]
