"""Limits and rates of the joints as a box on z, the step of the rotation vectors themselves:

theta_j <- theta_j + z_j,  dv_j = J_r(theta_j) z_j
"""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array


def box(
    theta: Array, proposed: Array, lower: Array, upper: Array, centre: Array, reach: float
) -> tuple[Array, Array]:
    """Bounds (F,3) on z, never empty.

    Limits: lower <= theta + z <= upper, rad (F,3), widened where the network's own angle `proposed`
    (F,3) lies outside: the refinement takes no joint further out of its range than it was proposed.
    Rate: |z - centre| <= reach, centre (F,3) the last pose in this chart. Where the two do not meet the
    rate gives way: z may go to the edge of the limits that is nearest to the rate's interval.
    """
    low = np.minimum(lower, proposed) - theta
    high = np.maximum(upper, proposed) - theta
    slow, fast = centre - reach, centre + reach
    return np.minimum(np.maximum(low, slow), high), np.maximum(np.minimum(high, fast), low)


def in_rotation_vectors(H: Array, g: Array, B: Array) -> tuple[Array, Array]:
    """B^T H B and B^T g for the block diagonal B (F,3,3): the same quadratic in z, dv = B z."""
    F = len(B)
    Bt = B.transpose(0, 2, 1)
    half = Bt @ H.reshape(F, 3, 3 * F)
    full = Bt @ half.reshape(3 * F, 3 * F).T.reshape(F, 3, 3 * F)
    return full.reshape(3 * F, 3 * F), (Bt @ g.reshape(F, 3, 1)).ravel()
