"""Where sensors on bones are, and how they accelerate."""

from __future__ import annotations

import numpy as np

from mocap.motion import Motion
from mocap.orientation import Array


def sensor_positions(motion: Motion, joint: np.ndarray, placement: Array) -> Array:
    """Positions (T,S,3) m in the world of seats (S,3) m on the bones `joint` (S,)."""
    R, p = motion.R_world_joint[:, joint], motion.p_world_joint[:, joint]
    return p + np.einsum("tsij,sj->tsi", R, placement)


def second_difference(p: Array, rate_hz: float) -> Array:
    """(p_{t-1} - 2 p_t + p_{t+1}) rate^2 along axis 0; NaN at both ends."""
    acc = np.full_like(p, np.nan)
    acc[1:-1] = (p[:-2] - 2 * p[1:-1] + p[2:]) * rate_hz**2
    return acc
