"""The terms of one frame: whitened residual e (m,) and Jacobian J (m,n) with respect to dv.

Each term is |e + J dv|^2; a term knows no other, and `normal_equations` adds them up. Constraints are a
box on z, the step of the rotation vectors themselves: theta_j <- theta_j + z_j, dv_j = J_r(theta_j) z_j.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hybrid import rotations
from hybrid.kinematics import Configuration
from mocap.orientation import Array

# Past this angle the logarithm's gradient points the wrong way as soon as noise crosses the half turn.
MAX_ANGLE = np.deg2rad(150.0)


class Term(NamedTuple):
    """Whitened residual e (m,) and Jacobian J (m,n): cost |e + J dv|^2."""

    e: Array
    J: Array


def orientation(
    at: Configuration, point: np.ndarray, R_measured: Array, sigma: float
) -> tuple[Term, Array]:
    """Log(R_measured^T R_world_bone) / sigma of the points `point`, sigma in rad.

    R(dv) = R Exp(R^T J_rotation dv), so the Jacobian is J_r^-1(Log(R_measured^T R)) R^T J_rotation. Also
    returns the angles (m,) rad; a term whose angle exceeds MAX_ANGLE is left out (zero).
    """
    R = at.R_world_bone[point]
    w = rotations.log(R_measured.mT @ R)
    angle = rotations.norm(w)
    weight = (angle <= MAX_ANGLE) / sigma
    turning = rotations.right_jacobian_inv(w) * weight[:, None, None] @ R.mT
    J = turning @ at.J_rotation[point]
    return Term((w * weight[:, None]).ravel(), J.reshape(-1, J.shape[-1])), angle


def relative_position(at: Configuration, origin: int) -> tuple[Array, Array]:
    """p (S,3) m of all points relative to the point `origin`, world axes, and J (S,3,n)."""
    return at.p_world - at.p_world[origin], at.J_position - at.J_position[origin]


class Position(NamedTuple):
    """The position term, how far off each prediction is in sigmas, and which ones the gate refused."""

    term: Term
    innovation: Array
    refused: np.ndarray


def position(
    p: Array, J: Array, predicted: Array, variance: Array, prior: Array, gate: float, robust: float
) -> Position:
    """(p - predicted) / sqrt(variance) for sensor positions p (m,3) m with Jacobians J (m,3,n).

    predicted (m,3) m, variance (m,) m^2 per axis: the motion filter's. prior (n,): variance in rad^2 of
    dv by the network, from which the innovation's own variance follows: variance + tr(J prior J^T) / 3.
    A prediction more than `gate` sigmas of the innovation away is refused; one more than `robust` sigmas
    of its own away counts linearly (Huber: weight robust / distance).
    """
    distance = rotations.norm(p - predicted)
    spread = variance + (J**2 @ prior).sum(axis=1) / 3
    innovation = distance / np.sqrt(spread)
    refused = ~(innovation <= gate)
    sigmas = distance / np.sqrt(variance)
    weight = np.where(refused, 0.0, np.minimum(1.0, robust / np.maximum(sigmas, 1e-9)))
    root = np.sqrt(weight / variance)
    e = np.where(refused[:, None], 0.0, p - predicted) * root[:, None]
    term = Term(e.ravel(), (J * root[:, None, None]).reshape(-1, J.shape[-1]))
    return Position(term, innovation, refused)


def network(xi: Array, whitener: Array) -> Term:
    """L Log(R_net^T R) of the free joints: xi (F,3) rad now, whitener L (3F,3F), L^T L = Lambda_net.

    R = R_net Exp(xi) and Log(Exp(xi) Exp(dv)) = xi + J_r^-1(xi) dv.
    """
    F = len(xi)
    J = np.zeros((F, 3, F, 3))
    f = np.arange(F)
    J[f, :, f, :] = rotations.right_jacobian_inv(xi)
    return Term(whitener @ xi.ravel(), whitener @ J.reshape(3 * F, 3 * F))


def normal_equations(terms: Sequence[Term]) -> tuple[Array, Array]:
    """H (n,n) and g (n,) of 1/2 sum |e + J dv|^2 = 1/2 dv^T H dv + g^T dv + constant."""
    J = np.concatenate([t.J for t in terms])
    e = np.concatenate([t.e for t in terms])
    return J.T @ J, J.T @ e


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
