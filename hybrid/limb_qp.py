"""The quadratic programme of one frame: dense Hessian, box, OSQP set up once and updated with values.

    minimise 1/2 x^T H x + g^T x   subject to   lower <= x <= upper

In most frames no bound is active and the minimum without the box is the answer; OSQP is asked for the rest.
Variables are scaled to a unit diagonal (z = sqrt(diag H) x), which makes one penalty rho good for every
frame and gives tolerances a meaning: 1e-3 is a thousandth of a posterior sigma of one variable alone.
OSQP's own scaling and the adaptation of rho are off: both remember earlier frames, and a resumed run
would differ from an uninterrupted one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import osqp
import scipy.sparse as sparse
from scipy.linalg.lapack import dpotrf, dpotrs

from mocap.orientation import Array

RHO = 0.3  # by trial over 0.1, 0.3, 1 on random problems of 36 and 45 unknowns: fewest iterations
TOLERANCE = 1e-4  # OSQP's, on scaled variables
EXACT_KKT = 1e-9  # scaled; a start this good is the minimum but for rounding
MAX_ITERATIONS = 400
ACCEPTED_KKT = 1e-3  # scaled; above, the answer is refused
# Below this width OSQP takes a box for an equality and refactorises with another penalty.
NARROWEST = 2e-4


@dataclass(frozen=True, eq=False)
class QPSolution:
    """x (n,), and how well it satisfies the conditions of optimality.

    kkt: largest violation of stationarity, box, sign and complementarity, on scaled variables, computed
    from x itself. ok: finite and kkt small enough. iterations: OSQP's; 0 where it was not asked.
    """

    x: Array
    ok: bool
    kkt: float
    iterations: int


class LimbQP:
    """One problem size, n unknowns; `solve` as often as wanted. Nothing carries over between calls."""

    def __init__(self, n: int) -> None:
        self.n = n
        pattern = sparse.csc_matrix(np.triu(np.ones((n, n))))
        columns = np.repeat(np.arange(n), np.diff(pattern.indptr))
        self._triangle = pattern.indices * n + columns  # where the values of P are in a flat (n,n)
        pattern.data[:] = pattern.indices == columns
        self._solver = osqp.OSQP(algebra="builtin")
        self._solver.setup(
            pattern,
            np.zeros(n),
            sparse.identity(n, format="csc"),
            -np.ones(n),
            np.ones(n),
            verbose=False,
            scaling=0,
            adaptive_rho=False,
            rho=RHO,
            eps_abs=TOLERANCE,
            eps_rel=0.0,
            max_iter=MAX_ITERATIONS,
            check_termination=5,
            check_dualgap=False,
            polishing=False,
        )

    def solve(self, H: Array, g: Array, lower: Array, upper: Array) -> QPSolution:
        """The minimum for H (n,n) symmetric positive definite, g (n,), lower <= upper (n,).

        The start is the minimum without the box, clipped to it. Where that satisfies the conditions of
        optimality (always where no bound is active) it is the answer.
        """
        diagonal = H.diagonal()
        if not (diagonal > 0).all():
            return self._refused()
        scale = 1 / np.sqrt(diagonal)
        P, q = H * scale[:, None] * scale, g * scale
        low, high = lower / scale, upper / scale
        factor, bad = dpotrf(P, lower=0, clean=0)
        if bad or not np.isfinite(q).all():
            return self._refused()
        z, iterations = _clip(-dpotrs(factor, q)[0], low, high), 0
        kkt = kkt_residual(P, q, low, high, z)
        if not kkt <= EXACT_KKT:
            z, iterations = self._by_osqp(P, q, low, high, z)
            kkt = kkt_residual(P, q, low, high, z)
        ok = kkt <= ACCEPTED_KKT  # False where kkt is NaN
        x = _clip(z * scale, lower, upper)  # the scale's rounding
        return QPSolution(x, ok, kkt, iterations)

    def _by_osqp(self, P: Array, q: Array, low: Array, high: Array, z: Array) -> tuple[Array, int]:
        """OSQP's answer within the box, started at z in it, and its iterations; all scaled."""
        y = np.where((z <= low) | (z >= high), -(P @ z + q), 0.0)
        thin = np.maximum(NARROWEST - (high - low), 0) / 2
        solver = self._solver
        solver.update(q=q, l=low - thin, u=high + thin, Px=P.ravel()[self._triangle])
        solver.warm_start(x=z, y=y)
        result = solver.solve(raise_error=False)
        return _clip(result.x, low, high), int(result.info.iter)

    def _refused(self) -> QPSolution:
        """The answer to what is no strictly convex problem."""
        return QPSolution(np.zeros(self.n), False, np.inf, 0)


def kkt_residual(P: Array, q: Array, lower: Array, upper: Array, x: Array) -> float:
    """max |x - clip(x - (P x + q), lower, upper)|: zero exactly at the minimum.

    The fixed point of the projected gradient holds stationarity, feasibility, the multipliers' signs and
    complementarity in one expression.
    """
    return float(np.abs(x - _clip(x - (P @ x + q), lower, upper)).max(initial=0.0))


def _clip(x: Array, lower: Array, upper: Array) -> Array:
    """np.clip, at a third of its cost for arrays this small."""
    return np.minimum(np.maximum(x, lower), upper)
