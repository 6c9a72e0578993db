"""IPOPT over the built problem: the same cost, gradient and Gauss-Newton matrix, limits as hard bounds.

CasADi's `nlpsol` calls IPOPT; the three oracles are CasADi callbacks onto `sip.problem`, so the banded
solver and IPOPT cannot disagree about the problem.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix

from mocap.errors import SolveError
from mocap.orientation import Array
from sip.model import CONSTANTS
from sip.problem import Problem
from sip.solvers.band import Band
from sip.solvers.banded import Progress, Result, scaled_norm
from sip.terms.base import Point

_WORDS = {
    "Solve_Succeeded": "optimal within the tolerance",
    "Solved_To_Acceptable_Level": "optimal within ten times the tolerance",
    "Maximum_Iterations_Exceeded": "stopped at the iteration limit",
}


class _Oracle:
    """Evaluates the problem at IPOPT's vector once, however many callbacks ask.

    IPOPT sees unknowns in sigmas, z = scale * x with scale the root of the Gauss-Newton diagonal (median
    over frames): its tolerances then mean the same for metres and radians.
    """

    def __init__(self, problem: Problem, point: Point):
        self.problem, self.x0, self.R_ref = problem, point.x, point.R_ref
        band = problem.hessian(point)
        column = np.sqrt(np.median(band.diagonal[problem.fixed :], axis=0))
        self.frames = problem.T - problem.fixed
        self.scale = np.r_[np.tile(column, self.frames), np.sqrt(np.diag(band.corner))]
        self.key: bytes | None = None
        self.jacobian = False
        self.interrupted: BaseException | None = None

    def split(self, z: Array) -> tuple[Array, Array]:
        """x (T,n) and u (S,7) of IPOPT's vector: the free frames, then the sensor constants."""
        p = self.problem
        values = z / self.scale
        cut = self.frames * p.n
        x = self.x0.copy()
        x[p.fixed :] = values[:cut].reshape(-1, p.n)
        u = values[cut:].reshape(-1, CONSTANTS) if p.border else np.zeros((p.S, CONSTANTS))
        return x, u

    def join(self, x: Array, tail: Array) -> Array:
        """IPOPT's vector of x (T,n) and the sensor constants (g,)."""
        return np.r_[x[self.problem.fixed :].ravel(), tail] * self.scale

    def at(self, z: Array, jacobian: bool) -> Point:
        key = z.tobytes()
        if key != self.key or (jacobian and not self.jacobian):
            x, u = self.split(z)
            self.point = self.problem.point(x, self.R_ref, u, jacobian)
            self.key, self.jacobian = key, jacobian
        return self.point

    def slope(self, z: Array) -> Array:
        """Gradient of the cost with respect to z."""
        g, gu = self.problem.gradient(self.at(z, True))
        return np.r_[g[self.problem.fixed :].ravel(), gu] / self.scale


class _Callback(ca.Callback):
    """A CasADi function whose numbers come from Python; an exception is kept and raised afterwards."""

    def __init__(
        self, name: str, oracle: _Oracle, inputs: list[Any], outputs: list[Any], call: Any
    ):
        ca.Callback.__init__(self)
        self._owner, self._inputs, self._outputs, self._run = oracle, inputs, outputs, call
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: Any, res: Any) -> int:
        if self._owner.interrupted is not None:
            return 1
        try:
            self._run(np.frombuffer(arg[0], dtype=float), res)
        except BaseException as e:  # IPOPT is C: the exception must not cross it
            self._owner.interrupted = e
            return 1
        return 0


@contextmanager
def _interruptible(oracle: _Oracle) -> Iterator[None]:
    """Ctrl-C in this block makes the next evaluation fail, which ends IPOPT.

    CasADi looks for signals between evaluations too, and drops the exception that Python's own handler
    raises there. Only the main thread receives signals, so elsewhere nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def keep(number: int, frame: Any) -> None:
        oracle.interrupted = KeyboardInterrupt()

    before = signal.getsignal(signal.SIGINT)
    # Ignored on purpose (nohup, a shell's background job), or not set from Python: leave it.
    if before is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, keep)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _write(buffer: Any, values: Array) -> None:
    if buffer is not None:
        np.frombuffer(buffer, dtype=float)[:] = values


class _Triangle:
    """Upper triangle of the Gauss-Newton matrix in CasADi's column order, gathered from the band."""

    def __init__(self, problem: Problem, scale: Array):
        T, k, f, g, N = problem.T, problem.reach, problem.fixed, problem.border, problem.n
        F = T - f
        rows, cols, take = [], [], []
        self.sparsity = ca.Sparsity(F * N, F * N)
        _, constant = problem.model.constant(T, k)
        for d in range(min(k, F - 1) + 1):
            # Constant terms touch what they touch; accelerations couple all within two frames, the root's
            # smoothness only the root.
            used = (constant.blocks[:, d] != 0).any(axis=0)
            if d <= problem.dense_reach:
                used[:] = True
            used[3:6, 3:6] = True
            # blocks[t, d][i, j] = H[(t+d) i, t j]: upper entry (row t j, column (t+d) i).
            i, j = np.nonzero(used if d else np.tril(used))
            t = np.arange(f, T - d)
            rows.append(((t[:, None] - f) * N + j).ravel())
            cols.append(((t[:, None] + d - f) * N + i).ravel())
            take.append((((t[:, None] * (k + 1) + d) * N + i) * N + j).ravel())
            # The pattern is made of small ones: millions of indices take seconds to pass to CasADi.
            frames = ca.Sparsity.triplet(F, F, list(range(F - d)), list(range(d, F)))
            block = ca.Sparsity.triplet(N, N, j.tolist(), i.tolist())
            self.sparsity += ca.kron(frames, block)
        row, col, self.index = (np.concatenate(a) for a in (rows, cols, take))
        self.f, self.g = f, g
        self.corner = np.triu_indices(g)
        if g:
            r, c = np.meshgrid(np.arange(F * N), F * N + np.arange(g), indexing="ij")
            row = np.concatenate([row, r.ravel(), F * N + self.corner[0]])
            col = np.concatenate([col, c.ravel(), F * N + self.corner[1]])
            wide = ca.horzcat(self.sparsity, ca.Sparsity.dense(F * N, g))
            last = ca.horzcat(ca.Sparsity(g, F * N), ca.Sparsity.upper(g))
            self.sparsity = ca.vertcat(wide, last)
        n = F * N + g
        # Sorting by columns, then rows; linear in the number of entries.
        ordered = csc_matrix((np.arange(len(row)), (row, col)), shape=(n, n))
        ordered.sort_indices()
        self.order = ordered.data
        self.unscale = (1 / (scale[row] * scale[col]))[self.order]

    def gather(self, band: Band) -> Array:
        values = band.blocks.reshape(-1)[self.index]
        if self.g:
            tail = [band.border[self.f :].reshape(-1), band.corner[self.corner]]
            values = np.concatenate([values, *tail])
        return values[self.order] * self.unscale


def _options(warm: bool, max_iterations: int, tolerance: float) -> dict[str, Any]:
    ipopt: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": max_iterations,
        "tol": tolerance,
        "acceptable_tol": 10 * tolerance,
        "acceptable_iter": 3,
        "linear_solver": "mumps",
        "mumps_pivot_order": 0,
        "mumps_mem_percent": 100,
        "nlp_scaling_method": "none",
        "mu_strategy": "adaptive" if not warm else "monotone",
        "honor_original_bounds": "yes",
    }
    if warm:
        # The banded solution is all but optimal: start the barrier where it would end.
        ipopt |= {
            "mu_init": tolerance**2,
            "warm_start_init_point": "yes",
            "warm_start_bound_push": 1e-16,
            "warm_start_bound_frac": 1e-16,
            "warm_start_mult_bound_push": 1e-16,
        }
    plain = {"print_time": False, "error_on_fail": False, "no_nlp_grad": True, "calc_lam_p": False}
    return {"ipopt": ipopt, **plain}


def _central(z: Array, slope: Array, lower: Array, upper: Array, mu: float) -> tuple[Array, Array]:
    """The point near z on the barrier's central path, and the bounds' multipliers there.

    On the path slack * multiplier = mu and the multiplier balances the slope of the cost: at an active
    bound the slack is mu / slope (at most sqrt(mu), where there is next to none), elsewhere the multiplier is
    mu / slack. A start on the bounds themselves would let IPOPT take tiny steps only.
    """
    pushed = np.sqrt(mu)
    below = np.minimum(mu / np.maximum(slope, pushed), (upper - lower) / 2)
    above = np.minimum(mu / np.maximum(-slope, pushed), (upper - lower) / 2)
    z = np.clip(z, lower + below, upper - above)
    at_lower = z - lower < upper - z
    return z, np.where(at_lower, -mu / (z - lower), mu / (upper - z))


def _solver(
    oracle: _Oracle, warm: bool, max_iterations: int, tolerance: float, progress: Progress | None
) -> tuple[Any, list[_Callback]]:
    """IPOPT over the oracle's problem, and the callbacks, which must live as long as it does."""
    problem = oracle.problem
    triangle = _Triangle(problem, oracle.scale)
    size = len(oracle.scale)
    vector, scalar, none = ca.Sparsity.dense(size), ca.Sparsity.dense(1), ca.Sparsity(0, 1)
    count = 0

    def cost(z: Array, res: Any) -> None:
        _write(res[0], np.array([problem.cost(oracle.at(z, False))]))

    def slope(z: Array, res: Any) -> None:
        _write(res[0], np.array([problem.cost(oracle.at(z, True))]))
        _write(res[1], oracle.slope(z))

    def matrix(z: Array, res: Any) -> None:
        nonlocal count
        point = oracle.at(z, True)
        count += 1
        if progress:
            progress(count, problem.cost(point))
        _write(res[0], triangle.gather(problem.hessian(point)))

    f = _Callback("f", oracle, [vector], [scalar], cost)
    g = _Callback("grad_f", oracle, [vector, none], [scalar, vector], slope)
    h = _Callback("hess_lag", oracle, [vector, none, scalar, none], [triangle.sparsity], matrix)
    z = ca.MX.sym("z", size)
    options = _options(warm, max_iterations, tolerance) | {"grad_f": g, "hess_lag": h}
    return ca.nlpsol("sip", "ipopt", {"x": z, "f": f(z)}, options), [f, g, h]


def minimise(
    problem: Problem,
    x: Array,
    R_ref: Array,
    u: Array,
    warm: bool,
    max_iterations: int = 200,
    progress: Progress | None = None,
) -> Result:
    """Minimise from x (T,n), R_ref (T,3,3), u (S,7) with lower <= body angles <= upper as bounds.

    warm: the start is a solution of the same problem without hard bounds. IPOPT's `tol` is in sigmas, the
    root of the settings' relative tolerance: no unknown could win more than half of that in cost.
    KeyboardInterrupt and errors inside the oracles are raised from here; SolveError without a finite point.
    """
    box = problem.box
    oracle = _Oracle(problem, problem.point(box.clip(x), R_ref, u))
    tolerance = np.sqrt(problem.settings.tolerance)
    solver, _alive = _solver(oracle, warm, max_iterations, tolerance, progress)
    free = np.full(problem.border, np.inf)
    lower, upper = oracle.join(box.lower, -free), oracle.join(box.upper, free)
    start = oracle.join(oracle.x0, u.ravel()[: problem.border])
    multipliers = np.zeros(len(start))
    if warm:
        start, multipliers = _central(start, oracle.slope(start), lower, upper, tolerance**2)
    with _interruptible(oracle):
        out = solver(x0=start, lam_x0=multipliers, lbx=lower, ubx=upper)
    if oracle.interrupted is not None:
        raise oracle.interrupted
    stats = solver.stats()
    end = out["x"].full().ravel()
    if not np.isfinite(end).all():
        raise SolveError(f"IPOPT ended without a finite point: {stats['return_status']}")
    xs, us = oracle.split(end)
    point = problem.point(box.clip(xs), R_ref, us)
    grad, grad_u = problem.gradient(point)
    # On an active bound the multiplier balances the gradient.
    balance = out["lam_x"].full().ravel() * oracle.scale
    own = oracle.frames * problem.n
    grad[problem.fixed :] += balance[:own].reshape(-1, problem.n)
    norm = scaled_norm(grad, grad_u, problem.hessian(point))
    status = str(stats["return_status"])
    good = status in ("Solve_Succeeded", "Solved_To_Acceptable_Level")
    words = _WORDS.get(status, status)
    return Result(point, int(stats["iter_count"]), f"IPOPT: {words}", good, norm)
