"""The closed forms against those of `mocap.orientation`, from no turn to a half turn."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid import rotations
from mocap import orientation as ori

ANGLES = (0.0, 1e-160, 1e-9, 1e-5, 1e-3, 0.1, 1.0, 2.6, 2.7, 3.14, np.pi - 1e-9)


@pytest.mark.parametrize("angle", ANGLES)
def test_agrees_with_mocap_orientation(rng: np.random.Generator, angle: float) -> None:
    axis = rng.normal(size=(4, 15, 3))
    w = angle * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    R = ori.exp(w)
    assert np.allclose(rotations.exp(w), R, atol=1e-14, rtol=0)
    assert np.allclose(rotations.log(R), w, atol=1e-14, rtol=1e-12)
    assert np.allclose(rotations.right_jacobian(w), ori.right_jacobian(w), atol=1e-13, rtol=0)
    assert np.allclose(
        rotations.right_jacobian_inv(w), ori.right_jacobian_inv(w), atol=1e-13, rtol=0
    )
    assert np.array_equal(rotations.hat(w), ori.hat(w))
    q = rotations.quaternion(R)
    assert np.allclose(ori.from_quat(q, scalar_first=False), R, atol=1e-14, rtol=0)


def test_a_half_turn_among_others(rng: np.random.Generator) -> None:
    R = ori.exp(np.array([[np.pi, 0, 0], [0, 0.3, 0]]))
    assert np.allclose(np.abs(rotations.log(R)), [[np.pi, 0, 0], [0, 0.3, 0]], atol=1e-14)


def test_none_and_one() -> None:
    assert rotations.log(np.zeros((0, 3, 3))).shape == (0, 3)
    assert rotations.exp(np.zeros((0, 3))).shape == (0, 3, 3)
    assert np.array_equal(rotations.log(np.eye(3)), np.zeros(3))
    assert np.array_equal(rotations.exp(np.zeros(3)), np.eye(3))
