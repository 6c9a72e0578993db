"""Arrival: what frames that have left a window say of those that follow them and of the constants."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from mocap.errors import SolveError
from mocap.orientation import Array
from sip.solvers.band import Band
from sip.terms.base import Point, Term


class Arrival(Term):
    """Residual R d + z, d = [x - x_at of the first m frames; u - u_at].

    R (c,c) upper triangular, c = m n + g; z (c,): the square root of a quadratic about the point of
    linearisation, x_at (m,n), u_at (S,7), of which the first g count. H: R^T R.
    """

    name, constant = "arrival", True

    def __init__(self, R: Array, z: Array, x_at: Array, u_at: Array):
        self.R, self.z, self.H = R, z, R.T @ R
        self.x_at, self.u_at = x_at, u_at
        self.reach = max(0, len(x_at) - 1)

    @property
    def _cut(self) -> int:
        """Where the constants begin."""
        return self.x_at.size

    def _offset(self, point: Point) -> Array:
        m, g = len(self.x_at), len(self.z) - self._cut
        frames = (point.x[:m] - self.x_at).ravel()
        return np.concatenate([frames, (point.u - self.u_at).ravel()[:g]])

    def residual(self, point: Point) -> Array:
        return self.R @ self._offset(point) + self.z

    def pullback(self, point: Point, v: Array, grad: Array, grad_u: Array) -> None:
        pulled, m = self.R.T @ v, len(self.x_at)
        grad[:m] += pulled[: self._cut].reshape(self.x_at.shape)
        grad_u.reshape(-1)[: len(pulled) - self._cut] += pulled[self._cut :]

    def hessian(self, point: Point, band: Band) -> None:
        m, cut = len(self.x_at), self._cut
        n = point.x.shape[1]
        for t in range(m):
            rows = slice(t * n, (t + 1) * n)
            for d in range(m - t):
                band.blocks[t, d] += self.H[(t + d) * n : (t + d + 1) * n, rows]
            band.border[t] += self.H[rows, cut:]
        band.corner += self.H[cut:, cut:]


def of_constants(sigma: Array, u: Array, border: int, n: int) -> Arrival:
    """Before any frame has left: the constants are near zero. sigma: (g,); u (S,7): here."""
    root = np.diag(1 / sigma[:border])
    z = root @ u.ravel()[:border]
    return Arrival(root, z, np.zeros((0, n)), u)


def eliminated(
    H: Array, g: Array, frames: int, x: Array, u: Array, kept: float, walk: Array
) -> Arrival:
    """The quadratic d H d / 2 + g d over `frames` frames and the constants, its first frame eliminated.

    Its Cholesky factor, in the order of time with the constants last, holds the answer: what stands behind
    the first frame's columns is the square root of the Schur complement. x (frames,n), u (S,7): where it is
    linearised. Of what is known of the frames, given the constants, the share `kept` is kept:
    linearisation and errors that last make it too sure. The constants themselves walk at random:
    walk (g,) is the variance that they gain. Raises SolveError where H is not finite.
    """
    n = x.shape[1]
    L = _cholesky(H)
    y = lapack.dtrtrs(L, g, lower=1)[0]
    R, z = np.array(L[n:, n:].T), y[n:]
    cut = (frames - 1) * n
    R[:cut] *= np.sqrt(kept)
    z[:cut] *= np.sqrt(kept)
    if len(walk) and walk.any():
        inverse = lapack.dtrtri(R[cut:, cut:], lower=0)[0]
        offset = inverse @ z[cut:]
        covariance = inverse @ inverse.T + np.diag(walk)
        # Upper triangular, R^T R the inverse of the covariance.
        R[cut:, cut:] = _cholesky(np.linalg.inv(covariance)).T
        z[cut:] = R[cut:, cut:] @ offset
    return Arrival(R, z, x[1:], u)


def _cholesky(H: Array) -> Array:
    """Lower factor of a positive semidefinite matrix, with as little damping as lets rounding pass."""
    size = float(np.diag(H).max())
    for damping in (1e-9, *(size * 10.0**e for e in range(-15, -8))):
        L, info = lapack.dpotrf(H + damping * np.eye(len(H)), lower=1, clean=1)
        if info == 0 and np.isfinite(L[-1, -1]):
            return np.asarray(L)
    raise SolveError("what has left the window is not positive definite")
