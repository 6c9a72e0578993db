"""The built problem: the terms, the mapped CasADi kinematics, cost, gradient and Gauss-Newton matrix.

Building and solving are two steps; the solvers (`sip.solvers.banded`, `sip.solvers.ipopt`) see only this.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip import kinematics as kin
from sip.over_frames import OverFrames
from sip.prior import Conditioned
from sip.settings import Settings
from sip.solvers.band import Band
from sip.solvers.box import Box
from sip.terms.acceleration import Acceleration
from sip.terms.anthropometric import Limits, PosePrior
from sip.terms.base import Point, Term
from sip.terms.calibration import SensorConstants
from sip.terms.orientation import Orientation
from sip.terms.smoothness import Gauge, LinearSmoothness, RootSmoothness

CONSTANTS = 7  # per sensor: mounting (3), heading (1), bias (3)


class SensorKinematics:
    """Orientation residual and position of every sensor in one frame, with Jacobians, mapped over frames.

    CasADi expressions of the skeleton. The Jacobians are written out in their geometric form, which is
    some fifty times cheaper to evaluate than those of automatic differentiation (a test holds one against
    the other): a change d of the rotation vector theta_j turns everything below joint j by
    A_j d, A_j = R_world_j J_r(theta_j), about the joint's place, so that
        de/dtheta_j = J_l^-1(e) R_meas^T R_y A_j,    dp/dtheta_j = -hat(p - p_j) A_j.
    active: the body joints above any sensor, in the order of their columns of x; n = 6 + 3 len(active).
    """

    def __init__(self, skeleton: Skeleton, joint: NDArray[np.int64], placement: Array):
        S = len(joint)
        self.S = S
        chains = [skeleton.ancestors(int(j)) for j in joint]
        self.active = tuple(sorted({j for chain in chains for j in chain} - {0}))
        self.n = n = 6 + 3 * len(self.active)
        at = {0: 3} | {j: 6 + 3 * i for i, j in enumerate(self.active)}
        x, R_ref = ca.SX.sym("x", n), ca.SX.sym("R_ref", 3, 3)
        R_meas, u = ca.SX.sym("R_meas", 3, 3 * S), ca.SX.sym("u", 4, S)
        R, p = kin.forward(skeleton, x, R_ref, self.active)
        A = {j: R[j] @ kin.right_jacobian(x[c : c + 3]) for j, c in at.items()}
        e, seats = [], []
        e_x, p_x, e_u = ca.SX(3 * S, n), ca.SX(3 * S, n), ca.SX(3, 4 * S)
        for s in range(S):
            j, rows = int(joint[s]), slice(3 * s, 3 * s + 3)
            mounting = kin.exp(u[:3, s])
            to_sensor = R_meas[:, rows].T @ kin.exp(ca.vertcat(0, u[3, s], 0))
            e.append(kin.log(to_sensor @ R[j] @ mounting))
            seats.append(p[j] + R[j] @ ca.DM(placement[s]))
            J = kin.right_jacobian_inv(e[s])
            left = J.T @ to_sensor  # J_l^-1(e) = J_r^-1(e)^T
            p_x[rows, :3] = ca.SX.eye(3)
            for i in chains[s]:
                columns = slice(at[i], at[i] + 3)
                e_x[rows, columns] = left @ A[i]
                p_x[rows, columns] = -kin.hat(seats[s] - p[i]) @ A[i]
            e_u[:, 4 * s : 4 * s + 3] = J @ kin.right_jacobian(u[:3, s])
            e_u[:, 4 * s + 3] = J.T @ R_meas[:, rows].T @ ca.vertcat(0, 1, 0)
        inputs = [x, R_ref, R_meas, u]
        values = ca.horzcat(ca.vertcat(*e), ca.vertcat(*seats))
        self.values = OverFrames(ca.Function("values", inputs, [values], {"cse": True}))
        full = [values, ca.densify(e_x.T), ca.densify(p_x.T), ca.densify(e_u)]
        self.full = OverFrames(ca.Function("full", inputs, full, {"cse": True}))

    def evaluate(
        self, x: Array, R_ref: Array, R_meas: Array, u: Array, jacobian: bool
    ) -> tuple[Array, ...]:
        """e, p (T,S,3) and, with `jacobian`, e_x, p_x (T,S,3,n) and e_u (T,S,3,4)."""
        T, S, n = len(x), self.S, self.n
        inputs = (
            x,
            np.swapaxes(R_ref, -1, -2),
            np.swapaxes(R_meas, -1, -2),
            np.broadcast_to(u[:, :4], (T, S, 4)),
        )
        values, *rest = (self.full if jacobian else self.values)(*inputs)
        e, p = values.reshape(T, 2, S, 3).swapaxes(0, 1)
        if not jacobian:
            return e, p
        e_x, p_x = (a.reshape(T, S, 3, n) for a in rest[:2])
        return e, p, e_x, p_x, np.swapaxes(rest[2].reshape(T, S, 4, 3), -1, -2)


@dataclass
class Problem:
    """A sequence, as seen by a solver.

    x (T,n) with R_ref (T,3,3) as in `sip.kinematics`; u (S,7) sensor constants (zero unless
    `self_calibration`). fixed: the first frames of x that are given, not solved for (a window's past).
    """

    skeleton: Skeleton
    recording: Recording
    settings: Settings
    kinematics: SensorKinematics
    terms: list[Term]
    R_meas: Array
    prior: Conditioned
    fixed: int = 0

    @property
    def T(self) -> int:
        return len(self.R_meas)

    @property
    def S(self) -> int:
        return self.kinematics.S

    @property
    def n(self) -> int:
        """Unknowns per frame."""
        return self.kinematics.n

    @property
    def border(self) -> int:
        """Number of unknowns that live through the whole sequence."""
        return CONSTANTS * self.S if self.settings.self_calibration else 0

    @cached_property
    def box(self) -> Box:
        """The joint limits as bounds; what is given is not bounded."""
        lower = np.full((self.T, self.n), -np.inf)
        upper = np.full((self.T, self.n), np.inf)
        lower[self.fixed :, kin.BODY] = self.prior.lower
        upper[self.fixed :, kin.BODY] = self.prior.upper
        return Box(lower, upper)

    @cached_property
    def reach(self) -> int:
        """Frames that a term reaches at most: the number of block diagonals below the main one."""
        return max(t.reach for t in self.terms)

    @property
    def dense_reach(self) -> int:
        """Frames apart that any two unknowns may couple (accelerations), beyond constant terms."""
        return max(
            t.reach for t in self.terms if not isinstance(t, LinearSmoothness | RootSmoothness)
        )

    def point(self, x: Array, R_ref: Array, u: Array, jacobian: bool = True) -> Point:
        """The kinematics at these unknowns."""
        out = self.kinematics.evaluate(x, R_ref, self.R_meas, u, jacobian)
        return Point(x, R_ref, u, *out)

    def cost(self, point: Point) -> float:
        """The total."""
        return sum(t.loss(t.residual(point)) for t in self.terms)

    def pullback(self, point: Point, residuals: list[Array]) -> tuple[Array, Array]:
        """J^T W v for v per term: (T,n) (zero for fixed frames) and (g,)."""
        grad, grad_u = np.zeros((self.T, self.n)), np.zeros((self.S, CONSTANTS))
        for term, v in zip(self.terms, residuals, strict=True):
            term.pullback(point, v, grad, grad_u)
        grad[: self.fixed] = 0
        return grad, grad_u.ravel()[: self.border]

    def residuals(self, point: Point) -> list[Array]:
        """Whitened residuals of each term."""
        return [t.residual(point) for t in self.terms]

    def gradient(self, point: Point) -> tuple[Array, Array]:
        """d cost/dx (T,n) (zero for fixed frames) and d cost/du (g,)."""
        return self.pullback(point, self.residuals(point))

    @cached_property
    def _constant(self) -> Band:
        band = Band.zeros(self.T, self.reach, self.n, self.border)
        nothing = np.zeros(0)
        dummy = Point(np.zeros((self.T, self.n)), nothing, nothing, nothing, nothing)
        for term in self.terms:
            if term.constant:
                term.hessian(dummy, band)
        return band

    def hessian(self, point: Point) -> Band:
        """The Gauss-Newton matrix with the robust weights; fixed frames have the identity."""
        c = self._constant
        band = Band(c.blocks.copy(), c.border.copy(), c.corner.copy())
        for term in self.terms:
            if not term.constant:
                term.hessian(point, band)
        f = self.fixed
        if f:
            for d in range(self.reach + 1):
                # Every block with a column or row before frame f couples to a constant.
                band.blocks[:f, d] = 0
            band.blocks[:f, 0] = np.eye(self.n)
            band.border[:f] = 0
        return band


def overcount(rate_hz: float, settings: Settings) -> float:
    """How many frames count as one piece of evidence on the sensors' constants."""
    return max(1.0, rate_hz * settings.correlation_s)


def sanitised(recording: Recording) -> Array:
    """R_world_bone with the identity where it may not be used."""
    return np.where(recording.ori_valid[..., None, None], recording.R_world_bone, np.eye(3))


def build(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    kinematics: SensorKinematics | None = None,
    fixed: int = 0,
) -> Problem:
    """The problem of this recording. Terms as in the design's table; SOP has no acceleration term."""
    k = kinematics or SensorKinematics(skeleton, recording.joint, recording.placement)
    s, rate = settings, recording.rate_hz
    prior = settings.prior.given(k.active, s.prior_floor)
    R_meas = sanitised(recording)
    border = s.self_calibration
    terms: list[Term] = [
        Orientation(s.sigma_orientation, recording.ori_valid, border),
        Gauge(s.sigma_gauge),
    ]
    if s.terms == "sip":
        acc = np.nan_to_num(recording.acc_world)
        terms.append(
            Acceleration(
                s.sigma_acceleration, s.robust_delta, rate, acc,
                # A bias lies in the sensor's frame: without an orientation nothing is known of it.
                np.where(recording.ori_valid[..., None, None], R_meas, 0.0),
                recording.acc_valid, border,
            )
        )  # fmt: skip
    weight = s.prior_weight_calibrating if border else s.prior_weight
    if weight > 0:
        terms.append(PosePrior(prior.mean, prior.covariance, s.prior_floor, weight))
    if s.sigma_limits > 0:
        terms.append(Limits(prior.lower, prior.upper, s.sigma_limits))
    if s.smooth_order:
        order = s.smooth_order
        body = s.smooth_angle * prior.roughness
        terms += [
            LinearSmoothness("smoothness", kin.BODY, order, body, rate),
            LinearSmoothness("smoothness", kin.ROOT_P, order, np.full(3, s.smooth_position), rate),
            RootSmoothness(order, s.smooth_root, rate),
        ]
    if border:
        sigma = np.r_[[s.sigma_mounting] * 3, s.sigma_heading, [s.sigma_bias] * 3]
        sigma = sigma / np.sqrt(overcount(rate, s))
        terms.append(SensorConstants(sigma))
    terms += [make(recording, k) for make in s.extra]
    terms = [t for t in terms if t.reach < len(recording)]
    return Problem(skeleton, recording, s, k, terms, R_meas, prior, fixed)


def reference_root(recording: Recording) -> Array | None:
    """R_ref (T,3,3): the pelvis measurement, slerped over gaps; None where no pelvis sensor works."""
    at = np.flatnonzero(recording.joint == 0)
    if not len(at):
        return None
    s = at[0]
    ok = recording.ori_valid[:, s]
    if not ok.any():
        return None
    times = np.arange(len(recording), dtype=float)
    return ori.interpolate(times[ok], recording.R_world_bone[ok, s], times)
