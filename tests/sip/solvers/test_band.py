"""The block band against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from sip.solvers.band import Band, Factor, NotPositiveDefinite

CASES = [(7, 2, 3, 0), (8, 3, 2, 4), (2, 3, 2, 1), (1, 2, 3, 0), (5, 0, 3, 2), (6, 1, 4, 3)]


def random_band(rng: np.random.Generator, T: int, k: int, n: int, g: int) -> Band:
    band = Band.zeros(T, k, n, g)
    band.blocks[:] = rng.normal(size=band.blocks.shape)
    band.blocks[:, 0] += np.swapaxes(band.blocks[:, 0], 1, 2) + 30 * np.eye(n)
    for d in range(1, k + 1):
        band.blocks[max(T - d, 0) :, d] = 0
    band.border[:] = rng.normal(size=band.border.shape)
    band.corner[:] = 30 * np.eye(g)
    return band


def dense(band: Band) -> np.ndarray:
    T, k1, n, _ = band.blocks.shape
    g = len(band.corner)
    H = np.zeros((T * n + g, T * n + g))
    for t in range(T):
        for d in range(min(k1, T - t)):
            rows, cols = slice((t + d) * n, (t + d + 1) * n), slice(t * n, (t + 1) * n)
            H[rows, cols], H[cols, rows] = band.blocks[t, d], band.blocks[t, d].T
    H[: T * n, T * n :] = band.border.reshape(T * n, g)
    H[T * n :, : T * n] = H[: T * n, T * n :].T
    H[T * n :, T * n :] = band.corner
    return H


@pytest.mark.parametrize(("T", "k", "n", "g"), CASES)
def test_against_dense(rng: np.random.Generator, T: int, k: int, n: int, g: int) -> None:
    band = random_band(rng, T, k, n, g)
    H, factor = dense(band), Factor(band)
    b = rng.normal(size=T * n + g)
    v, u = factor.solve(b[: T * n].reshape(T, n), b[T * n :])
    assert np.allclose(np.r_[v.ravel(), u], np.linalg.solve(H, b))
    assert np.allclose(np.concatenate([a.ravel() for a in band.dot(v, u)]), b)
    inverse = np.linalg.inv(H)
    for t, block in enumerate(factor.inverse_blocks()):
        assert np.allclose(block, inverse[t * n : (t + 1) * n, t * n : (t + 1) * n])


def test_damping_adds_to_the_diagonal(rng: np.random.Generator) -> None:
    band = random_band(rng, 4, 2, 3, 0)
    damping = rng.uniform(1, 2, size=3)
    b = rng.normal(size=(4, 3))
    v, _ = Factor(band, damping).solve(b, np.zeros(0))
    H = dense(band) + np.diag(np.tile(damping, 4))
    assert np.allclose(v.ravel(), np.linalg.solve(H, b.ravel()))


def test_indefinite_names_the_block(rng: np.random.Generator) -> None:
    band = random_band(rng, 5, 1, 2, 0)
    band.blocks[3, 0] = -np.eye(2)
    with pytest.raises(NotPositiveDefinite, match="block 3"):
        Factor(band)


def test_inverse_blocks_keep_their_digits_where_directions_differ(rng: np.random.Generator) -> None:
    """Second differences known to 1e-4, positions to 100: the plain recursion would blow up."""
    T, n = 300, 2
    band = Band.zeros(T, 2, n)
    for offsets, weight in (({0: 1.0}, 1e-2), ({0: 1.0, 1: -2.0, 2: 1.0}, 1e4)):
        for b, cb in offsets.items():
            for a, ca in offsets.items():
                if a >= b:
                    count = T - max(offsets)
                    band.blocks[b : b + count, a - b] += np.eye(n) * ca * cb * weight**2
    blocks = Factor(band).inverse_blocks()
    assert (np.einsum("tii->ti", blocks) > 0).all()
    # Far from the ends each frame is known as well as the next, and time may run backward.
    assert np.allclose(blocks[:150], blocks[::-1][:150], rtol=1e-3)
