"""CasADi, Pinocchio and the vectorised kinematics are one; rotation algebra holds at its corners."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mocap import Motion, Skeleton
from mocap import orientation as ori
from sip import kinematics as kin


@pytest.mark.parametrize("height", [None, 1.95])
def test_casadi_agrees_with_pinocchio(rng: np.random.Generator, height: float | None) -> None:
    skeleton = Skeleton.default(height)
    forward = kin.numeric_forward(skeleton)
    model = skeleton.pin_model
    data = model.createData()
    for _ in range(20):
        theta, p = rng.normal(size=(24, 3)), rng.normal(size=3)
        R_ref = ori.exp(rng.normal(size=3))
        x = np.r_[p, theta.ravel()]
        R, joints = (np.asarray(o.full()) for o in forward(x, R_ref))
        local = ori.exp(theta)
        local[0] = R_ref @ local[0]
        pin.forwardKinematics(model, data, skeleton.pin_configuration(local, p))
        for j, pin_id in enumerate(skeleton.pin_ids):
            assert np.abs(R[:, 3 * j : 3 * j + 3] - data.oMi[pin_id].rotation).max() < 1e-12
            assert np.abs(joints[:, j] - data.oMi[pin_id].translation).max() < 1e-12


def test_vectorised_kinematics_agree_with_pinocchio(rng: np.random.Generator) -> None:
    skeleton = Skeleton.default()
    motion = Motion(60, ori.exp(rng.normal(size=(4, 24, 3))), rng.normal(size=(4, 3)), skeleton)
    data = skeleton.pin_model.createData()
    for t in range(4):
        q = skeleton.pin_configuration(motion.R_parent_joint[t], motion.p_world_root[t])
        pin.forwardKinematics(skeleton.pin_model, data, q)
        for j, pin_id in enumerate(skeleton.pin_ids):
            assert np.allclose(motion.R_world_joint[t, j], data.oMi[pin_id].rotation, atol=1e-12)
            assert np.allclose(motion.p_world_joint[t, j], data.oMi[pin_id].translation, atol=1e-12)


def _function(f: object, *shape: int) -> ca.Function:
    x = ca.SX.sym("x", *shape)
    y = f(x)  # type: ignore[operator]
    return ca.Function("f", [x], [y, ca.jacobian(ca.vec(y), ca.vec(x))])


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-3, 0.03, 1.0, 3.0])
def test_exp_log_and_jacobians(rng: np.random.Generator, size: float) -> None:
    w = rng.normal(size=3)
    w *= size / np.linalg.norm(w)
    exp = _function(kin.exp, 3)
    R, dR = (np.asarray(o.full()) for o in exp(w))
    assert np.allclose(R, ori.exp(w), atol=1e-14)
    assert np.isfinite(dR).all()
    log = _function(kin.log, 3, 3)
    back, d_log = (np.asarray(o.full()) for o in log(R))
    assert np.allclose(back.ravel(), w, atol=1e-9)
    assert np.isfinite(d_log).all()
    for ours, theirs in (
        (kin.right_jacobian, pin.Jexp3),
        (kin.right_jacobian_inv, lambda v: pin.Jlog3(pin.exp3(v))),
    ):
        J = np.asarray(_function(ours, 3)(w)[0].full())
        assert np.allclose(J, theirs(w), atol=1e-9)
    assert np.allclose(ori.right_jacobian(w), pin.Jexp3(w), atol=1e-9)
    assert np.allclose(ori.right_jacobian_inv(w), pin.Jlog3(pin.exp3(w)), atol=1e-9)


def test_log_at_a_half_turn_is_finite() -> None:
    R = ori.exp([np.pi - 1e-9, 0, 0])
    value = np.asarray(_function(kin.log, 3, 3)(R)[0].full()).ravel()
    assert np.isfinite(value).all()


def test_recentre_keeps_the_root(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.normal(size=(5, 6)), np.zeros((5, 3))], axis=1)
    R_ref = ori.exp(rng.normal(size=(5, 3)))
    y, R_new = kin.recentre(x, R_ref)
    assert np.allclose(R_new, R_ref @ ori.exp(x[:, 3:6]))
    assert not y[:, 3:6].any()
