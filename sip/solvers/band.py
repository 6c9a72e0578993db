"""Symmetric positive definite matrices of T x T blocks with a few block diagonals.

`Band` keeps the lower block diagonals, `Factor` their Cholesky factor. A factorisation costs
T n^3 (k^2 + k + 1/3) operations for block size n and k block diagonals below the main one, all of it
in LAPACK, and is linear in T. A border of dense columns (unknowns that
live through the whole sequence) is eliminated by its Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
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
        """T blocks of n x n with k diagonals below the main one, and a border of g columns."""
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

    def dense(self) -> Array:
        """H as a matrix, its blocks in the order of time and the border last."""
        T, k1, n, _ = self.blocks.shape
        g = len(self.corner)
        H = np.zeros((T * n + g, T * n + g))
        for t in range(T):
            here = slice(t * n, (t + 1) * n)
            for d in range(min(k1, T - t)):
                there = slice((t + d) * n, (t + d + 1) * n)
                H[there, here] = self.blocks[t, d]
                if d:
                    H[here, there] = self.blocks[t, d].T
            H[T * n :, here] = self.border[t].T
            H[here, T * n :] = self.border[t]
        H[T * n :, T * n :] = self.corner
        return H


class NotPositiveDefinite(ArithmeticError):
    """The matrix has a pivot that is not positive, at block `frame`."""

    def __init__(self, frame: int):
        self.frame = frame
        super().__init__(f"not positive definite at block {frame}")


class Factor:
    """Cholesky factor of a `Band` with `damping` (T,n) added to its diagonal.

    LAPACK's banded one, kept in its storage: entry (i, j) of L, i >= j, lies at columns[j, i - j]. Blocks of
    it are views: diag[t] is L_tt^T (n,n) and panel[t] is L_{t+1..t+k, t}^T (n, k n).
    """

    def __init__(self, band: Band, damping: Array | float = 0.0, corner_damping: float = 0.0):
        T, k1, n, _ = band.blocks.shape
        k, rows, g = k1 - 1, k1 * n, len(band.corner)
        self.T, self.k, self.n = T, k, n
        # One diagonal more than the band has: the strided views of blocks then overlap in zeros alone.
        storage = np.zeros(T * n * (rows + 1))
        self._columns = storage.reshape(T * n, rows + 1).T
        skewed = as_strided(storage, (T, n, rows), (8 * n * (rows + 1), 8 * rows, 8))
        self.diag, self.panel = skewed[..., :n], skewed[..., n:]
        self.border: Array | None = None
        self.schur: Array | None = None
        damping = np.broadcast_to(np.asarray(damping, float), (T, n))
        if not g:
            self._factor(band, damping)
            return
        corner = self._factor_with_border(band, damping)
        S, info = lapack.dpotrf(corner + corner_damping * np.eye(g), lower=1, clean=1)
        if info != 0:
            raise NotPositiveDefinite(T)
        self.schur = S

    def _factor(self, band: Band, damping: Array) -> None:
        T, k, n = self.T, self.k, self.n
        np.multiply(np.swapaxes(band.blocks[:, 0], 1, 2), np.triu(np.ones((n, n))), self.diag)
        for d in range(1, min(k, T - 1) + 1):
            self.panel[: T - d, :, (d - 1) * n : d * n] = np.swapaxes(band.blocks[: T - d, d], 1, 2)
        self._columns[0] += damping.ravel()
        self._columns, info = lapack.dpbtrf(self._columns, lower=1, overwrite_ab=1)
        if info != 0:
            raise NotPositiveDefinite((info - 1) // n)

    def _factor_with_border(self, band: Band, damping: Array) -> Array:
        """Frame by frame, the border among the rows below; gives what is left of the corner."""
        T, k, n = self.T, self.k, self.n
        kn, index = k * n, np.arange(n)
        border = self.border = np.empty(band.border.shape)
        # What frames so far leave of the k frames that follow and of the corner (lower triangle).
        left, after = (np.zeros((kn + len(band.corner),) * 2, order="F") for _ in range(2))
        left[kn:, kn:] = band.corner
        P = np.empty((len(left), n), order="F")
        for t in range(T):
            own = band.blocks[t, 0] + left[:n, :n] if k else band.blocks[t, 0].copy()
            own[index, index] += damping[t]
            L, info = lapack.dpotrf(own.T, lower=0, clean=1, overwrite_a=1)
            if info != 0:
                raise NotPositiveDefinite(t)
            for d in range(1, k + 1):
                P[(d - 1) * n : d * n] = band.blocks[t, d] if t + d < T else 0
            P[kn:] = band.border[t].T
            if k:
                P[: kn - n] += left[n:kn, :n]
                P[kn:] += left[kn:, :n]
                after[: kn - n, : kn - n] = left[n:kn, n:kn]
                after[kn - n : kn, :kn] = 0
                after[kn:, : kn - n] = left[kn:, n:kn]
                after[kn:, kn - n : kn] = 0
            after[kn:, kn:] = left[kn:, kn:]
            P = blas.dtrsm(1.0, L, P, side=1, lower=0, trans_a=0, overwrite_b=1)
            after = blas.dsyrk(-1.0, P, beta=1.0, c=after, lower=1, overwrite_c=1)
            left, after = after, left
            self.diag[t], self.panel[t], border[t] = L, P[:kn].T, P[kn:].T
        return left[kn:, kn:]

    def _half_solve(self, b: Array, first: int = 0) -> Array:
        """L^-1 b for b (T,n,g); without the frames before the first, where b is zero."""
        n, k = self.n, self.k
        if b.shape[-1] == 1 and not first:
            return lapack.dtbtrs(self._columns, b.reshape(-1, 1), uplo="L")[0].reshape(b.shape)
        # LAPACK takes the columns one by one; by blocks, many go through the factor at once.
        y = np.array(b)
        for i, t in enumerate(range(first, self.T)):
            y[i] = lapack.dtrtrs(self.diag[t], y[i], lower=0, trans=1)[0]
            m = min(k, self.T - 1 - t)
            if m:
                y[i + 1 : i + 1 + m] -= (self.panel[t, :, : m * n].T @ y[i]).reshape(m, n, -1)
        return y

    def _back_solve(self, y: Array) -> Array:
        """L^-T y for y (T,n,g)."""
        n, k = self.n, self.k
        if y.shape[-1] == 1:
            x = lapack.dtbtrs(self._columns, y.reshape(-1, 1), uplo="L", trans="T")[0]
            return x.reshape(y.shape)
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

    def corner_inverse(self) -> Array:
        """The block (g,g) of H^-1 that belongs to the border: their posterior covariance."""
        inverse = lapack.dpotri(self.schur, lower=1)[0]
        return np.tril(inverse) + np.tril(inverse, -1).T

    def inverse_block(self, t: int) -> Array:
        """The diagonal block (n,n) of H^-1 of one frame: its posterior covariance."""
        unit = np.zeros((self.T - t, self.n, self.n))
        unit[0] = np.eye(self.n)
        y = self._half_solve(unit, t).reshape(-1, self.n)
        out = y.T @ y
        if self.border is not None:
            through = self.border[t:].reshape(len(y), -1).T @ y
            w = lapack.dtrtrs(self.schur, through, lower=1)[0]
            out += w.T @ w
        return np.asarray(out)

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
