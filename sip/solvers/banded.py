"""Levenberg-Marquardt on the block band: the solver that does the bulk of the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.errors import SolveError
from mocap.orientation import Array
from sip.kinematics import ROOT_W, recentre
from sip.model import CONSTANTS
from sip.problem import Problem
from sip.solvers.band import Band, Factor, NotPositiveDefinite, factored
from sip.solvers.box import Box, bounded_step, reduced
from sip.terms.base import Point

Progress = Callable[[int, float], None]
_LAMBDA_MAX = 1e10
_NOTHING = 1e-12  # a diagonal entry below this: nothing measures the unknown
# Damping is in units of steps, not of the Hessian's diagonal: that one is ruled by rate^2/sigma_acc and
# would freeze slow drifts of the root, which accelerations hardly see.
_STEP_ROOT, _STEP_ANGLE = 1.0, 0.2  # m, rad
_SLOW = 3  # steps in a row that bring too little
_BEND_LIMIT = 0.75  # a path that bends more than this, relative to its length, is not trusted


@dataclass(frozen=True, eq=False)
class Result:
    """Where a solver ended: the point with Jacobians, iterations, the rule that ended it in words, the
    largest gradient in sigmas (`scaled_norm`).
    """

    point: Point
    iterations: int
    status: str
    converged: bool
    gradient_norm: float


def scaled_norm(grad: Array, grad_u: Array, band: Band) -> float:
    """Largest |g_i| / sqrt(H_ii): the gradient in sigmas, free of units."""
    own = np.abs(grad) / np.sqrt(np.maximum(band.diagonal, _NOTHING))
    shared = np.abs(grad_u) / np.sqrt(np.diag(band.corner))
    return float(max(own.max(), shared.max(initial=0.0)))


def _bend(
    problem: Problem, point: Point, dx: Array, du: Array, factor: Factor
) -> tuple[Array, Array]:
    """Half the geodesic acceleration a of a step d: H a = -J^T W r'', r'' = d^2 r/dt^2 along d.

    Valleys of this cost are curved (an arm's swivel at a measured forearm); the second order of the path
    follows them (Transtrum and Sethna, 2012). r'' by central differences.
    """
    h = 0.1
    values = [
        problem.residuals(problem.point(point.x + t * dx, point.R_ref, point.u + t * du, False))
        for t in (-h, h)
    ]
    here = problem.residuals(point)
    second = [(a + b - 2 * c) / h**2 for a, b, c in zip(*values, here, strict=True)]
    grad, grad_u = problem.pullback(point, second)
    ax, au = factor.solve(-grad, -grad_u)
    return 0.5 * ax, 0.5 * (au.reshape(-1, CONSTANTS) if len(au) else np.zeros_like(point.u))


@dataclass(frozen=True)
class _Promise:
    """What the whole Gauss-Newton step, without damping, promises: g H^-1 g / 2 of the cost, and how far
    it turns any joint, rad. Unknowns that a bound holds stay where they are.

    The gradient alone says little here: directions differ a million times in how well they are known.
    """

    share: float
    turn: float

    def __str__(self) -> str:
        return (
            f"a full step promises {100 * self.share:.2g} % of the cost, "
            f"turning joints by {np.rad2deg(self.turn):.2g} deg at most"
        )


def _promise(
    problem: Problem, band: Band, grad: Array, grad_u: Array, free: NDArray[np.bool_], cost: float
) -> _Promise:
    dx, du = factored(band if free.all() else reduced(band, free)).solve(-grad, -grad_u)
    share = -0.5 * float(np.vdot(grad, dx) + grad_u @ du) / max(cost, _NOTHING)
    turn = np.linalg.norm(dx[problem.fixed :, 3:].reshape(-1, 3), axis=1).max(initial=0.0)
    return _Promise(share, float(turn))


@dataclass
class _Damping:
    """lambda, by Nielsen's rule: it falls after a good step, and grows ever faster after bad ones."""

    value: float = 1e-1
    growth: float = 2.0

    def good(self, gain: float) -> None:
        """gain: actual over predicted decrease of the step that was taken."""
        self.value = max(self.value * max(1 / 10, 1 - (2 * gain - 1) ** 3), 1e-9)
        self.growth = 2.0

    def bad(self) -> None:
        self.value, self.growth = self.value * self.growth, self.growth * 2


@dataclass(frozen=True, eq=False)
class _Here:
    """Where an iteration stands: cost, Gauss-Newton matrix and gradient at the point."""

    problem: Problem
    point: Point
    cost: float
    band: Band
    grad: Array
    grad_u: Array

    def lower(
        self, damping: _Damping, step: Array, box: Box | None, tolerance: float
    ) -> tuple[Point, float] | None:
        """A point of lower cost, and its cost; None where no step is worth taking.

        step (n,): units of the damping, D = 1 / step^2. Steps that promise less than a hundredth of the
        relative tolerance are not worth taking.
        """
        while damping.value < _LAMBDA_MAX:
            try:
                dx, du, factor, settled = self._damped(damping.value, step, box)
            except NotPositiveDefinite:
                damping.bad()
                continue
            Hx, Hu = self.band.dot(dx, du)
            predicted = -(np.vdot(self.grad, dx) + self.grad_u @ du)
            predicted -= 0.5 * (np.vdot(dx, Hx) + du @ Hu)
            if settled and predicted <= tolerance * self.cost * 0.01:
                return None
            constants = du.reshape(-1, CONSTANTS) if len(du) else np.zeros_like(self.point.u)
            if factor is not None:
                ax, au = _bend(self.problem, self.point, dx, constants, factor)
                if np.linalg.norm(ax / step) <= _BEND_LIMIT * np.linalg.norm(dx / step):
                    dx, constants = dx + ax, constants + au
            at = self.point
            trial = self.problem.point(at.x + dx, at.R_ref, at.u + constants)
            new = self.problem.cost(trial)
            gain = (self.cost - new) / predicted if np.isfinite(new) and predicted > 0 else -1.0
            if gain > 1e-4:
                damping.good(float(gain))
                return trial, new
            damping.bad()
        return None

    def _damped(
        self, value: float, step: Array, box: Box | None
    ) -> tuple[Array, Array, Factor | None, bool]:
        """dx (T,n), du (g,) of (H + lambda D) d = -g; the factor where there is no box; whether the box's
        active set has settled.
        """
        D = value / step**2
        if box is not None:
            dx, du, settled = bounded_step(
                self.band, self.grad, self.grad_u, D, value, self.point.x, box
            )
            return dx, du, None, settled
        factor = Factor(self.band, D, value)
        dx, du = factor.solve(-self.grad, -self.grad_u)
        return dx, du, factor, True


def minimise(
    problem: Problem,
    x: Array,
    R_ref: Array,
    u: Array,
    max_iterations: int | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
    box: Box | None = None,
) -> Result:
    """Minimise the cost from x (T,n), R_ref (T,3,3), u (S,7); with a box, among the x inside it.

    Each iteration solves (H + lambda D) d = -g, D fixed, H the Gauss-Newton matrix. A step is taken when the
    true cost falls; lambda follows the ratio of actual to predicted decrease (Nielsen's rule). It has
    converged when a step brings, or no step can bring, a relative decrease of `tolerance`, and the whole step
    without damping promises less than that too. It stops without having converged at max_iterations, after
    three steps that bring less although more is promised, or where only steps too short to matter are left.
    Raises SolveError where no finite cost can be had.
    """
    max_iterations = max_iterations or problem.settings.max_iterations
    tolerance = tolerance or problem.settings.tolerance
    point = problem.point(*recentre(x if box is None else box.clip(x), R_ref), u)
    cost = problem.cost(point)
    if not np.isfinite(cost):
        raise SolveError("the cost at the start is not finite")
    step = np.r_[np.full(3, _STEP_ROOT), np.full(problem.n - 3, _STEP_ANGLE)]
    damping = _Damping()
    iteration, slow, stuck = 0, 0, False
    everything = np.ones(x.shape, bool)
    while True:
        here = _Here(problem, point, cost, problem.hessian(point), *problem.gradient(point))
        free = everything if box is None else box.free(point.x, here.grad)
        if slow or stuck or iteration >= max_iterations:
            inside = np.where(free, here.grad, 0)
            promise = _promise(problem, here.band, inside, here.grad_u, free, cost)
            converged = promise.share <= tolerance
            if converged or stuck or slow >= _SLOW or iteration >= max_iterations:
                break
        found = here.lower(damping, step, box, tolerance)
        if found is None:
            stuck = True
            continue
        point, new = found
        iteration += 1
        slow = slow + 1 if cost - new < tolerance * cost else 0
        cost = new
        if np.abs(point.x[:, ROOT_W]).max() > 1e-6:
            point = problem.point(*recentre(point.x, point.R_ref), point.u)
        if progress:
            progress(iteration, cost)
    if converged:
        rule = "converged"
    elif iteration >= max_iterations:
        rule = f"stopped at the limit of {max_iterations} iterations"
    elif stuck:
        rule = "stalled on steps too short to lower the cost"
    else:
        rule = f"stopped after {_SLOW} steps that each lowered the cost by less than {tolerance:g}"
    norm = scaled_norm(inside, here.grad_u, here.band)
    return Result(point, iteration, f"{rule}: {promise}", converged, norm)
