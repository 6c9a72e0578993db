"""The gate: what counts as a sample, entry by entry."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import gate
from mocap import orientation as ori


def test_what_counts(rng: np.random.Generator) -> None:
    R = ori.exp(rng.normal(size=(8, 3)))
    acc = rng.normal(size=(8, 3))
    valid = np.ones(8, bool)
    R[1, 0, 2] = np.nan
    R[2] *= 1e200
    R[3] = -R[3]  # left-handed
    R[4] = R[4] @ np.diag([1.0, 1.0, 1.01])
    valid[5] = False
    acc[6, 1] = np.inf
    acc[7, 2] = -1.01 * gate.MAX_ACC
    turned, moved, exact = gate.judge(R, acc, valid)
    assert turned.tolist() == [True, False, False, False, False, False, True, True]
    assert moved.tolist() == [True, True, True, True, True, False, False, False]
    assert not exact
    assert gate.is_rotation(R).tolist() == [True, False, False, False, False, True, True, True]


@pytest.mark.parametrize("size", [1e-4, 1e-2])
def test_rounded_rotations_pass_and_are_not_called_exact(
    rng: np.random.Generator, size: float
) -> None:
    R = ori.exp(rng.normal(size=(5, 3)))
    good = gate.judge(R, np.zeros((5, 3)), np.ones(5, bool))
    assert good.turned.all() and good.exact
    R[3, 1, 1] += size
    found = gate.judge(R, np.zeros((5, 3)), np.ones(5, bool))
    assert found.turned.tolist() == [True, True, True, size < gate.ROTATION_TOLERANCE, True]
    assert not found.exact
