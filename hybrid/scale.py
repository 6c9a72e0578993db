"""How sure of itself a network may be: its deviations against its errors on validation motion.

For a network that states deviations, one factor per joint makes the whitened errors of unit variance; for
one that states none, the root mean square of its errors per joint takes their place (for IMUPoser, one set
per combination of devices). Both go into `TrackerSettings`. Never computed on test motion.
"""

from __future__ import annotations

import numpy as np

from mocap import orientation as ori
from mocap.errors import ShapeError
from mocap.orientation import Array

SMALLEST_DEG = 0.5  # a joint that the network holds fixed has no error to learn a deviation from


def errors(R_network: Array, R_true: Array) -> Array:
    """Log(R_network^T R_true) (N,24,3) rad of local rotations (N,24,3,3): what `std_rad` describes."""
    R_network, R_true = np.asarray(R_network, float), np.asarray(R_true, float)
    if R_network.shape != R_true.shape or R_network.shape[1:] != (24, 3, 3):
        raise ShapeError(
            f"errors: rotations must be (N,24,3,3) twice, got {R_network.shape} and {R_true.shape}"
        )
    return ori.log(np.swapaxes(R_network, -1, -2) @ R_true)


def network_sigma_deg(error_rad: Array) -> tuple[float, ...]:
    """24 deviations per axis in degrees, of errors (N,24,3) rad: sqrt(mean over N and axes of e^2)."""
    sigma = np.rad2deg(np.sqrt(np.mean(np.square(error_rad), axis=(0, 2))))
    return tuple(float(s) for s in np.maximum(sigma, SMALLEST_DEG))


def network_scale(error_rad: Array, std_rad: Array) -> tuple[float, ...]:
    """24 factors on the stated deviations (N,24,3) rad: sqrt(mean of (e / std)^2) per joint."""
    factor = np.sqrt(np.mean(np.square(error_rad / std_rad), axis=(0, 2)))
    return tuple(float(f) for f in np.where(factor > 0, factor, 1.0))
