"""Levenberg-Marquardt on the block band: the solver that does the bulk of the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap.errors import SolveError
from mocap.orientation import Array
from sip.band import Band, Factor, NotPositiveDefinite
from sip.kinematics import ROOT_W, recentre
from sip.problem import CONSTANTS, Problem
from sip.terms.base import Point

Progress = Callable[[int, float], None]
_LAMBDA_MAX = 1e10
_NOTHING = 1e-12  # a diagonal entry below this: nothing measures the unknown
# Damping is in units of steps, not of the Hessian's diagonal: that one is ruled by rate^2/sigma_acc and
# would freeze slow drifts of the root, which accelerations hardly see.
_STEP_ROOT, _STEP_ANGLE = 1.0, 0.2  # m, rad
_BEND_LIMIT = 0.75  # a path that bends more than this, relative to its length, is not trusted


@dataclass(frozen=True, eq=False)
class Result:
    """Where a solver ended: the point with Jacobians, iterations, why it stopped, max |gradient|."""

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


def minimise(
    problem: Problem,
    x: Array,
    R_ref: Array,
    u: Array,
    max_iterations: int | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Result:
    """Minimise the cost from x (T,n), R_ref (T,3,3), u (S,7).

    Each iteration solves (H + lambda D) d = -g, D fixed, H the Gauss-Newton matrix. A step is taken when the
    true cost falls; lambda follows the ratio of actual to predicted decrease (Nielsen's rule). It ends
    when a step promises or brings a relative decrease below `tolerance`, or at max_iterations.
    Raises SolveError where no finite cost can be had.
    """
    max_iterations = max_iterations or problem.settings.max_iterations
    tolerance = tolerance or problem.settings.tolerance
    x, R_ref = recentre(x, R_ref)
    point = problem.point(x, R_ref, u)
    cost = problem.cost(point)
    if not np.isfinite(cost):
        raise SolveError("the cost at the start is not finite")
    step = np.r_[np.full(3, _STEP_ROOT), np.full(problem.n - 3, _STEP_ANGLE)]
    damping: float = 1e-1
    growth = 2.0
    status, converged, iteration = "stopped at the iteration limit", False, 0
    while True:
        band = problem.hessian(point)
        grad, grad_u = problem.gradient(point)
        norm = scaled_norm(grad, grad_u, band)
        if iteration >= max_iterations or converged:
            break
        trial = None
        while trial is None and damping < _LAMBDA_MAX:
            try:
                factor = Factor(band, damping / step**2, damping)
            except NotPositiveDefinite:
                damping, growth = damping * growth, growth * 2
                continue
            dx, du_flat = factor.solve(-grad, -grad_u)
            Hx, Hu = band.dot(dx, du_flat)
            predicted = -(np.vdot(grad, dx) + grad_u @ du_flat)
            predicted -= 0.5 * (np.vdot(dx, Hx) + du_flat @ Hu)
            if predicted <= tolerance * cost * 0.01:
                status, converged = "converged: no step lowers the cost", True
                break
            du = du_flat.reshape(-1, CONSTANTS) if len(du_flat) else np.zeros_like(u)
            ax, au = _bend(problem, point, dx, du, factor)
            if np.linalg.norm(ax / step) <= _BEND_LIMIT * np.linalg.norm(dx / step):
                dx, du = dx + ax, du + au
            trial = problem.point(x + dx, R_ref, u + du)
            new = problem.cost(trial)
            gain = (cost - new) / predicted if np.isfinite(new) else -1.0
            if gain > 1e-4:
                damping = max(damping * max(1 / 10, 1 - (2 * float(gain) - 1) ** 3), 1e-9)
                growth = 2.0
            else:
                trial = None
                damping, growth = damping * growth, growth * 2
        if trial is None:
            if not converged:
                status = "stalled: no step lowers the cost"
            break
        iteration += 1
        decrease = (cost - new) / max(cost, 1e-300)
        cost, u, x, point = new, trial.u, trial.x, trial
        if np.abs(x[:, ROOT_W]).max() > 1e-6:
            x, R_ref = recentre(x, R_ref)
            point = problem.point(x, R_ref, u)
        if progress:
            progress(iteration, cost)
        if decrease < tolerance:
            status, converged = f"converged: cost falls by less than {tolerance:g}", True
    return Result(point, iteration, status, converged, norm)
