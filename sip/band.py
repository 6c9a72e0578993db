"""Symmetric positive definite matrices of T x T blocks with a few block diagonals.

`Band` keeps the lower block diagonals, `Factor` their Cholesky factor. A factorisation costs
T n^3 (k^2 + k + 1/3) operations for block size n and k block diagonals below the main one, all of it in
LAPACK and BLAS calls on contiguous blocks, and is linear in T. A border of dense columns (unknowns that
live through the whole sequence) is eliminated by its Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack

from mocap.errors import SolveError
from mocap.orientation import Array


@dataclass
class Band:
    """H in blocks: blocks[t, d] is H[t+d, t] (n,n), d = 0..k; border (T,n,g) and corner (g,g)."""

    blocks: Array  # (T, k+1, n, n)
    border: Array
    corner: Array

    @classmethod
    def zeros(cls, T: int, k: int, n: int, g: int = 0) -> Band:
        return cls(np.zeros((T, k + 1, n, n)), np.zeros((T, n, g)), np.zeros((g, g)))

    @property
    def diagonal(self) -> Array:
        """(T,n) entries of the main diagonal (a copy)."""
        return np.einsum("tii->ti", self.blocks[:, 0]).copy()

    def dot(self, v: Array, u: Array) -> tuple[Array, Array]:
        """H [v; u] for v (T,n), u (g,)."""
        T, k = self.blocks.shape[0], self.blocks.shape[1] - 1
        out = np.einsum("tij,tj->ti", self.blocks[:, 0], v) + self.border @ u
        for d in range(1, min(k, T - 1) + 1):
            B = self.blocks[: T - d, d]
            out[d:] += np.einsum("tij,tj->ti", B, v[: T - d])
            out[: T - d] += np.einsum("tji,tj->ti", B, v[d:])
        return out, np.einsum("tig,ti->g", self.border, v) + self.corner @ u


class NotPositiveDefinite(ArithmeticError):
    """The matrix has a pivot that is not positive, at block `frame`."""

    def __init__(self, frame: int):
        self.frame = frame
        super().__init__(f"not positive definite at block {frame}")


class Factor:
    """Cholesky factor of a `Band` with `damping` (T,n) added to its diagonal.

    Right-looking over frames: with the window of blocks t..t+k dense, L_tt = chol(A_tt),
    P = A_{t+1..t+k,t} L_tt^-T, A_window -= P P^T.
    """

    def __init__(self, band: Band, damping: Array | float = 0.0, corner_damping: float = 0.0):
        T, k1, n, _ = band.blocks.shape
        k = k1 - 1
        self.T, self.k, self.n = T, k, n
        # Column-major copies: LAPACK works on them without copying. panel[t] stacks L_{t+1..t+k, t}.
        self.diag = np.empty((T, n, n))
        self.panel = np.zeros((T, n, k * n))  # transposed: panel[t].T is (k n, n)
        damp = np.broadcast_to(np.asarray(damping, float), (T, n))
        W = np.zeros(((k + 1) * n, (k + 1) * n), order="F")
        index = np.arange(n)
        # The window starts with the blocks of frames 0..k-1; each step brings in frame t+k.
        for d in range(k):
            self._load(band, W, d, 0, d, T)
        for t in range(T):
            for d in range(k + 1):
                if t + k < T:
                    # Row k of the window: blocks H[t+k, t+d].
                    s = t + d
                    W[k * n :, d * n : (d + 1) * n] = band.blocks[s, k - d]
            A = W[:n, :n]
            A[index, index] += damp[t]
            L, info = lapack.dpotrf(A, lower=1, clean=1, overwrite_a=0)
            if info != 0:
                raise NotPositiveDefinite(t)
            self.diag[t] = L.T
            if k and t + 1 < T:
                m = min(k, T - 1 - t) * n
                P = blas.dtrsm(1.0, L, W[n : n + m, :n], side=1, lower=1, trans_a=1)
                self.panel[t, :, :m] = P.T
                # Schur complement, then the window moves one block up and left.
                S = blas.dgemm(-1.0, P, P, trans_b=1)
                W[:m, :m] = W[n : n + m, n : n + m]
                W[:m, :m] += S
        self.border: Array | None = None
        self.schur: Array | None = None
        if band.corner.shape[0]:
            self.border = self._half_solve(band.border)
            g = band.corner.shape[0]
            flat = self.border.reshape(T * n, g)
            corner = band.corner + corner_damping * np.eye(g) - flat.T @ flat
            S, info = lapack.dpotrf(corner, lower=1, clean=1)
            if info != 0:
                raise NotPositiveDefinite(T)
            self.schur = S

    @staticmethod
    def _load(band: Band, W: Array, row: int, first: int, last: int, T: int) -> None:
        n = band.blocks.shape[2]
        for c in range(first, last + 1):
            if row < T:
                W[row * n : (row + 1) * n, c * n : (c + 1) * n] = band.blocks[c, row - c]

    def _half_solve(self, b: Array) -> Array:
        """L^-1 b for b (T,n,g)."""
        n, k = self.n, self.k
        y = np.array(b)
        for t in range(self.T):
            y[t] = lapack.dtrtrs(self.diag[t], y[t], lower=0, trans=1)[0]
            m = min(k, self.T - 1 - t)
            if m:
                y[t + 1 : t + 1 + m] -= (self.panel[t, :, : m * n].T @ y[t]).reshape(m, n, -1)
        return y

    def _back_solve(self, y: Array) -> Array:
        """L^-T y for y (T,n,g)."""
        n, k = self.n, self.k
        x = np.array(y)
        for t in range(self.T - 1, -1, -1):
            m = min(k, self.T - 1 - t)
            if m:
                x[t] -= self.panel[t, :, : m * n] @ x[t + 1 : t + 1 + m].reshape(m * n, -1)
            x[t] = lapack.dtrtrs(self.diag[t], x[t], lower=0)[0]
        return x

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Solution (v (T,n), u (g,)) of H [v; u] = [b; c]."""
        y = self._half_solve(b[..., None])
        if self.border is None:
            return self._back_solve(y)[..., 0], np.zeros(0)
        u = lapack.dpotrs(self.schur, c - np.einsum("tig,ti->g", self.border, y[..., 0]), lower=1)[
            0
        ]
        return self._back_solve(y - (self.border @ u)[..., None])[..., 0], u

    def log_det(self) -> float:
        """Logarithm of the determinant of the factored matrix."""
        out = 2 * float(np.log(np.einsum("tii->ti", self.diag)).sum())
        if self.schur is not None:
            out += 2 * float(np.log(np.diag(self.schur)).sum())
        return out

    def corner_inverse(self) -> Array:
        """The block (g,g) of H^-1 that belongs to the border: their posterior covariance."""
        inverse = lapack.dpotri(self.schur, lower=1)[0]
        return np.tril(inverse) + np.tril(inverse, -1).T

    def inverse_blocks(self) -> Array:
        """Diagonal blocks (T,n,n) of H^-1: the posterior covariance of each frame.

        Backward over frames, with G = L_{t+1..t+k,t} L_tt^-1 and Z the inverse's window of frames
        t+1..t+k: Z_{window,t} = -Z G, Z_tt = L_tt^-T L_tt^-1 + G^T Z G (Takahashi). Z is carried as a
        square root, Z = S S^T, triangularised by QR at each step: the plain recursion loses all digits
        where some directions are known 1e6 times better than others, as with accelerations. A border adds
        Y S^-1 Y^T, Y the border's columns solved against the band.
        """
        n, k, T = self.n, self.k, self.T
        out = np.empty((T, n, n))
        root = np.zeros((0, 0))
        for t in range(T - 1, -1, -1):
            Linv = lapack.dtrtri(self.diag[t], lower=0)[0].T
            m = min(k, T - 1 - t) * n
            G = self.panel[t, :, :m].T @ Linv
            first = np.hstack([Linv.T, -G.T @ root])
            out[t] = first @ first.T
            keep = min(m, max(k - 1, 0) * n)
            below = np.hstack([np.zeros((keep, n)), root[:keep]])
            if k:
                stacked = np.vstack([first, below]).T
                root = np.asarray(np.linalg.qr(stacked, mode="r")).T
        if self.border is not None:
            Y = self._back_solve(self.border)
            out += np.einsum("tig,gh,tjh->tij", Y, self.corner_inverse(), Y, optimize=True)
        return out


def factored(band: Band) -> Factor:
    """Factor of a positive semidefinite matrix, with as little damping as lets rounding pass.

    At 1000 Hz accelerations know some directions 1e8 times better than the gauge knows the place.
    Raises SolveError.
    """
    largest = float(band.diagonal.max())
    for damping in (1e-12, *(largest * 10.0**e for e in range(-16, -9))):
        try:
            return Factor(band, damping, damping)
        except NotPositiveDefinite:
            continue
    raise SolveError("the Gauss-Newton matrix is not positive definite")
