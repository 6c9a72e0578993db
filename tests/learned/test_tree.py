"""The torch kinematics against the numpy ones and Pinocchio, and its rotations against `mocap`'s."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from learned import tree as kin
from mocap import orientation as ori
from mocap.skeleton import Skeleton

BODY = Skeleton.default(height=1.9)
vectors = arrays(float, (4, 3), elements=st.floats(-3, 3))


def torch_forward(R: np.ndarray, p: np.ndarray, dtype: torch.dtype) -> tuple[np.ndarray, ...]:
    offsets = torch.as_tensor(np.array(BODY.offsets), dtype=dtype)
    world = kin.rotations(torch.as_tensor(R, dtype=dtype))
    return world.numpy(), kin.positions(world, torch.as_tensor(p, dtype=dtype), offsets).numpy()


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 3e-6)])
def test_equals_the_numpy_tree_and_pinocchio(
    rng: np.random.Generator, dtype: torch.dtype, tolerance: float
) -> None:
    R, p = ori.exp(rng.normal(size=(5, 24, 3))), rng.normal(size=(5, 3))
    R_torch, p_torch = torch_forward(R, p, dtype)
    R_numpy, p_numpy = BODY.forward(R, p)
    np.testing.assert_allclose(R_torch, R_numpy, atol=tolerance)
    np.testing.assert_allclose(p_torch, p_numpy, atol=tolerance)
    model = BODY.pin_model
    data = model.createData()
    for k in range(len(R)):
        pin.forwardKinematics(model, data, BODY.pin_configuration(R[k], p[k]))
        placed = [data.oMi[j] for j in BODY.pin_ids]
        np.testing.assert_allclose(R_torch[k], [m.rotation for m in placed], atol=tolerance)
        np.testing.assert_allclose(p_torch[k], [m.translation for m in placed], atol=tolerance)


def test_offsets_of_each_window(rng: np.random.Generator) -> None:
    """Offsets (B,1,24,3) give each window its own body."""
    R = ori.exp(rng.normal(size=(2, 3, 24, 3)))
    offsets = np.array(BODY.offsets) * rng.uniform(0.8, 1.2, (2, 1, 24, 1))
    world = kin.rotations(torch.as_tensor(R))
    p = kin.positions(world, torch.zeros(3), torch.as_tensor(offsets)).numpy()
    for b in range(2):
        _, want = BODY.with_offsets(offsets[b, 0]).forward(R[b], np.zeros((3, 3)))
        np.testing.assert_allclose(p[b], want, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(vectors)
def test_exponential(w: np.ndarray) -> None:
    np.testing.assert_allclose(kin.exp(torch.as_tensor(w)).numpy(), ori.exp(w), atol=1e-9)


def test_exponential_is_differentiable_at_zero() -> None:
    w = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(kin.exp, w)
    for k in range(3):
        np.testing.assert_allclose(jacobian[..., k].numpy(), ori.hat(np.eye(3)[k]), atol=1e-9)


def test_quaternions_and_yaw(rng: np.random.Generator) -> None:
    R = ori.exp(rng.normal(size=(6, 3)))
    q = torch.as_tensor(3.0 * ori.to_quat(R))  # any length: it is normalised
    np.testing.assert_allclose(kin.from_quat(q).numpy(), R, atol=1e-12)
    a = rng.normal(size=6)
    np.testing.assert_allclose(kin.rot_y(torch.as_tensor(a)).numpy(), ori.rot_y(a), atol=1e-12)


def test_six_numbers(rng: np.random.Generator) -> None:
    """There and back; and numbers that are no columns of a rotation give a rotation all the same."""
    R = torch.as_tensor(ori.exp(rng.normal(size=(6, 3))))
    assert torch.equal(kin.to_6d(R)[:, 3:], R[:, :, 1])
    torch.testing.assert_close(kin.from_6d(kin.to_6d(R)), R)
    found = kin.from_6d(torch.as_tensor(rng.normal(size=(20, 6)))).numpy()
    assert ori.is_rotation(found, 1e-9).all()


def test_angles(rng: np.random.Generator) -> None:
    axis = rng.normal(size=(5, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    for angle in (0.0, 1e-6, 0.3, np.pi - 1e-3):
        R = torch.as_tensor(ori.exp(angle * axis))
        eye = torch.eye(3, dtype=torch.float64).expand(5, 3, 3)
        np.testing.assert_allclose(kin.angle_between(eye, R).numpy(), angle, atol=1e-9)
