"""CasADi, Pinocchio and the vectorised kinematics are one; rotation algebra holds at its corners."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mocap import Motion, Skeleton, sensors
from mocap import orientation as ori
from sip import kinematics as kin
from sip.sensor_kinematics import SensorKinematics


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


# Central differences of step h err by h^2 / 6 times a third derivative (some tens, of a chain and a
# logarithm), 1e-9, and by rounding over h, 1e-10; the Jacobians' entries are up to 1.
STEP, TOLERANCE = 1e-5, 1e-8


def _pin_point(
    rng: np.random.Generator, skeleton: Skeleton, theta: np.ndarray, R_ref: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pinocchio's q, and its tangent in the unknowns: x' = B v, (75, nv).

    pin.integrate turns every joint by R Exp(v) and moves the root by R_root v; our unknowns are p and
    rotation vectors, theta' = J_r(theta)^-1 v, by Pinocchio's own Jlog3.
    """
    model = skeleton.pin_model
    local = ori.exp(theta)
    local[0] = R_ref @ local[0]
    q = skeleton.pin_configuration(local, rng.normal(size=3))
    B = np.zeros((75, model.nv))
    B[:3, :3] = local[0]
    for j, pin_id in enumerate(skeleton.pin_ids):
        at = model.joints[pin_id].idx_v + (3 if j == 0 else 0)
        B[3 + 3 * j : 6 + 3 * j, at : at + 3] = pin.Jlog3(pin.exp3(theta[j]))
    return q, B


@pytest.mark.parametrize("size", [0.0, 0.05, 0.7])
@pytest.mark.parametrize("at_measurement", [True, False])
def test_sensor_jacobians_through_pin_integrate(
    rng: np.random.Generator, size: float, at_measurement: bool
) -> None:
    """What all terms and both solvers use, against Pinocchio's kinematics moved by pin.integrate.

    Where the measurement is the bone's own rotation, the orientation's rows are the bone's angular
    Jacobian; elsewhere they hold the logarithm's as well. Mounting and heading are those of a
    self-calibration.
    """
    skeleton = Skeleton.default()
    model, data = skeleton.pin_model, skeleton.pin_model.createData()
    joint, seat = sensors.joints_and_seats(sensors.SUIT)
    k = SensorKinematics(skeleton, joint, seat)
    theta, R_ref = size * rng.normal(size=(24, 3)), ori.exp(rng.normal(size=3))
    passive = [j for j in range(1, 24) if j not in k.active]
    theta[passive] = 0.0
    q, B = _pin_point(rng, skeleton, theta, R_ref)
    u = np.zeros((k.S, 7))
    if not at_measurement:
        u[:, :4] = 0.2 * rng.normal(size=(k.S, 4))

    def measured(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R_y(heading) R_world_bone Exp(mounting), and the sensors' places."""
        pin.forwardKinematics(model, data, q)
        placed = [data.oMi[skeleton.pin_ids[j]] for j in joint]
        R = np.array([M.rotation for M in placed])
        p = np.array([M.translation + M.rotation @ s for M, s in zip(placed, seat, strict=True)])
        return ori.rot_y(u[:, 3]) @ R @ ori.exp(u[:, :3]), p

    R_meas = measured(q)[0]
    if not at_measurement:
        R_meas = R_meas @ ori.exp(0.5 * rng.normal(size=(k.S, 3)))

    def residual(q: np.ndarray) -> np.ndarray:
        R, p = measured(q)
        e = [pin.log3(a.T @ b) for a, b in zip(R_meas, R, strict=True)]
        return np.stack([np.array(e), p])

    rows = np.r_[0:6, [3 + 3 * j + i for j in k.active for i in range(3)]]
    x = np.r_[q[:3], theta.ravel()][rows]
    values = k.evaluate(x[None], R_ref[None], R_meas[None], u, True)
    np.testing.assert_allclose(np.stack(values[:2])[:, 0], residual(q), atol=1e-12)
    jacobian = np.stack(values[2:4])[:, 0] @ B[rows]  # (2, S, 3, nv)
    assert np.abs(jacobian).max() > 0.5
    for i in range(model.nv):
        v = np.zeros(model.nv)
        v[i] = STEP
        ends = [residual(pin.integrate(model, q, s * v)) for s in (-1, 1)]
        numeric = (ends[1] - ends[0]) / (2 * STEP)
        np.testing.assert_allclose(jacobian[..., i], numeric, atol=TOLERANCE)


def test_joint_jacobians_through_pin_integrate(rng: np.random.Generator) -> None:
    """All 24 joints' places and rotations, differentiated by CasADi, moved by pin.integrate."""
    skeleton = Skeleton.default(1.6)
    model, data = skeleton.pin_model, skeleton.pin_model.createData()
    forward = kin.numeric_forward(skeleton)
    x, R_ref = ca.MX.sym("x", 75), ca.MX.sym("R_ref", 3, 3)
    stacked = ca.vertcat(*[ca.vec(out) for out in forward(x, R_ref)])
    derivative = ca.Function("derivative", [x, R_ref], [ca.jacobian(stacked, x)])
    theta, R_ref_value = 0.7 * rng.normal(size=(24, 3)), ori.exp(rng.normal(size=3))
    q, B = _pin_point(rng, skeleton, theta, R_ref_value)

    def joints(q: np.ndarray) -> np.ndarray:
        """Rotations, column by column, then places, joint by joint, as `stacked`."""
        pin.forwardKinematics(model, data, q)
        placed = [data.oMi[i] for i in skeleton.pin_ids]
        R, p = [M.rotation.T.ravel() for M in placed], [M.translation for M in placed]
        return np.r_[np.concatenate(R), np.concatenate(p)]

    J = derivative(np.r_[q[:3], theta.ravel()], R_ref_value).full() @ B
    for i in range(model.nv):
        v = np.zeros(model.nv)
        v[i] = STEP
        ends = [joints(pin.integrate(model, q, s * v)) for s in (-1, 1)]
        np.testing.assert_allclose(J[:, i], (ends[1] - ends[0]) / (2 * STEP), atol=TOLERANCE)


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
