"""Kinematics and terms: every Jacobian against finite differences along the manifold, boxes never empty."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.joint_box import box, in_rotation_vectors
from hybrid.limits import ranges
from hybrid.point_kinematics import Kinematics
from hybrid.tasks import Residual, orientation, position, prior
from hybrid.tasks.task import normal_equations
from hybrid.worn import free_joints
from mocap import Skeleton
from mocap import orientation as ori
from mocap import sensors as places

SETS = [
    places.SIX,
    places.FIVE,
    ("head",),
    ("left_wrist", "right_pocket"),
    ("sternum", "left_foot"),
]


def body(names: tuple[str, ...], spine: bool = True) -> Kinematics:
    joint, seat = places.joints_and_seats(names)
    skeleton = Skeleton.default(1.8)
    return Kinematics(skeleton, joint, seat, free_joints(skeleton, joint, spine))


def moved(k: Kinematics, R: np.ndarray, dv: np.ndarray) -> np.ndarray:
    out = R.copy()
    out[list(k.free)] = R[list(k.free)] @ ori.exp(dv.reshape(-1, 3))
    return out


def differences(f: Callable[[np.ndarray], np.ndarray], n: int, h: float = 1e-6) -> np.ndarray:
    """Central differences of f (m,) at zero: (m,n)."""
    return np.stack([(f(h * e) - f(-h * e)) / (2 * h) for e in np.eye(n)], axis=-1)


@pytest.mark.parametrize("names", SETS, ids=lambda s: "+".join(s))
def test_kinematics_agree_with_the_tree_and_jacobians_with_differences(
    rng: np.random.Generator, names: tuple[str, ...]
) -> None:
    k = body(names)
    R = ori.exp(rng.normal(size=(24, 3)))
    at = k.at(R)
    R_world, p_world = k.skeleton.forward(R, np.zeros(3))
    seats = p_world[k.joint] + np.einsum("sij,sj->si", R_world[k.joint], k.seat)
    assert np.allclose(at.R_world_bone, R_world[k.joint], atol=1e-12)
    assert np.allclose(at.p_world, seats, atol=1e-12)
    turned = differences(
        lambda dv: ori.log(
            k.at(moved(k, R, dv)).R_world_bone @ at.R_world_bone.transpose(0, 2, 1)
        ).ravel(),
        k.n,
    )
    assert np.allclose(at.J_rotation.reshape(-1, k.n), turned, atol=1e-8)
    shifted = differences(lambda dv: k.at(moved(k, R, dv)).p_world.ravel(), k.n)
    assert np.allclose(at.J_position.reshape(-1, k.n), shifted, atol=1e-8)


def test_any_point_of_the_body_has_its_pose_and_jacobians(rng: np.random.Generator) -> None:
    k = body(("left_wrist", "right_pocket"))
    R = ori.exp(0.6 * rng.normal(size=(24, 3)))
    at, seat = k.at(R), np.array([0.1, -0.2, 0.05])
    R_world, p_world = k.skeleton.forward(R, np.zeros(3))
    for joint in (0, 6, 15, 20, 8):
        found = at.on(joint, seat)
        assert np.allclose(found.R_world_bone, R_world[joint], atol=1e-12)
        assert np.allclose(found.p_world, p_world[joint] + R_world[joint] @ seat, atol=1e-12)
        turned = differences(
            lambda dv, j=joint, R0=found.R_world_bone: ori.log(  # type: ignore[misc]
                k.at(moved(k, R, dv)).on(j).R_world_bone @ R0.T
            ),
            k.n,
        )
        shifted = differences(lambda dv, j=joint: k.at(moved(k, R, dv)).on(j, seat).p_world, k.n)  # type: ignore[misc]
        assert np.allclose(found.J_rotation, turned, atol=1e-8)
        assert np.allclose(found.J_position, shifted, atol=1e-8)


def test_six_sensors_free_the_limbs_and_five_the_root_too() -> None:
    skeleton = Skeleton.default()
    six = places.joints_and_seats(places.SIX)[0]
    limbs = (1, 2, 4, 5, 12, 13, 14, 15, 16, 17, 18, 19)
    assert free_joints(skeleton, six, spine=False) == limbs
    assert free_joints(skeleton, six, spine=True) == tuple(sorted((*limbs, 3, 6, 9)))
    five = places.joints_and_seats(places.FIVE)[0]
    assert free_joints(skeleton, five, spine=False) == (0, 1, 2, 12, 13, 14, 15, 16, 17, 18, 19)
    assert free_joints(skeleton, np.array([0]), spine=True) == ()
    assert free_joints(skeleton, np.array([6]), spine=False) == (0, 3, 6)


@pytest.mark.parametrize("size", [0.0, 1e-7, 0.5, 2.0])
def test_orientation_jacobian(rng: np.random.Generator, size: float) -> None:
    k = body(places.SIX)
    R = ori.exp(0.5 * rng.normal(size=(24, 3)))
    at = k.at(R)
    axis = rng.normal(size=(6, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    R_measured = at.R_world_bone @ ori.exp(size * axis)
    point = np.arange(6)
    term, angle = orientation.residual(at, point, R_measured, 0.1)
    numeric = differences(
        lambda dv: orientation.residual(k.at(moved(k, R, dv)), point, R_measured, 0.1)[0].e, k.n
    )
    assert np.allclose(angle, size, atol=1e-9)
    assert np.allclose(term.J, numeric, atol=1e-6)


def test_orientation_past_the_limit_is_left_out(rng: np.random.Generator) -> None:
    k = body(places.SIX)
    at = k.at(ori.exp(0.3 * rng.normal(size=(24, 3))))
    R_measured = at.R_world_bone.copy()
    R_measured[2] = R_measured[2] @ ori.rot_x(np.pi - 1e-6)
    term, angle = orientation.residual(at, np.arange(6), R_measured, 0.1)
    assert np.abs(term.e).max() < 1e-12 and not term.J[6:9].any() and term.J[:6].any()
    assert angle[2] > orientation.MAX_ANGLE


def test_network_jacobian_and_mean(rng: np.random.Generator) -> None:
    R_net = ori.exp(rng.normal(size=(5, 3)))
    xi, L = 0.4 * rng.normal(size=(5, 3)), rng.normal(size=(15, 15))
    R = R_net @ ori.exp(xi)

    def residual(dv: np.ndarray) -> np.ndarray:
        now = R @ ori.exp(dv.reshape(-1, 3))
        return L @ ori.log(R_net.transpose(0, 2, 1) @ now).ravel()

    term = prior.residual(xi, L)
    assert np.allclose(term.e, residual(np.zeros(15)), atol=1e-12)
    assert np.allclose(term.J, differences(residual, 15), atol=1e-6)


def test_position_jacobian_weight_and_gate(rng: np.random.Generator) -> None:
    k = body(places.SIX)
    R = ori.exp(0.3 * rng.normal(size=(24, 3)))
    p, J = position.relative(k.at(R), origin=5)
    assert not p[5].any() and not J[5].any()
    numeric = differences(lambda dv: position.relative(k.at(moved(k, R, dv)), 5)[0].ravel(), k.n)
    assert np.allclose(J.reshape(-1, k.n), numeric, atol=1e-8)
    variance, prior = np.full(6, 0.01), np.full(k.n, 1e-6)
    off = np.zeros((6, 3))
    off[:4, 0] = 0.05, 0.2, 0.4, np.nan
    out = position.residual(p, J, p + off, variance, prior, gate=3.0, robust=1.0)
    e = out.term.e.reshape(6, 3)
    assert np.allclose(e[0], [-0.5, 0, 0])  # half a sigma: quadratic
    assert np.allclose(e[1], [-np.sqrt(2.0), 0, 0])  # two sigmas, Huber at one: weight 1/2
    assert out.refused.tolist() == [False, False, True, True, False, False]
    assert not e[2:].any() and not out.term.J[6:12].any()
    assert np.allclose(out.term.J[:3], J[0] / 0.1)


def test_quadratic_in_rotation_vectors_is_the_same_cost(rng: np.random.Generator) -> None:
    F = 4
    terms = [Residual(rng.normal(size=m), rng.normal(size=(m, 3 * F))) for m in (6, 12)]
    H, g = normal_equations(terms)
    B = ori.right_jacobian(rng.normal(size=(F, 3)))
    z = rng.normal(size=3 * F)
    dv = np.einsum("fij,fj->fi", B, z.reshape(F, 3)).ravel()
    direct = sum(0.5 * np.sum((t.e + t.J @ dv) ** 2) - 0.5 * np.sum(t.e**2) for t in terms)
    Hz, gz = in_rotation_vectors(H, g, B)
    assert np.isclose(0.5 * z @ Hz @ z + gz @ z, direct)


number = st.floats(-4, 4)


@given(
    st.lists(st.tuples(number, number, number, number, number), min_size=1, max_size=6),
    st.floats(0, 3),
)
@settings(max_examples=200, deadline=None)
def test_the_box_is_never_empty_and_limits_come_before_rates(
    rows: list[tuple[float, ...]], reach: float
) -> None:
    theta, proposed, a, b, centre = np.array(rows).T[:, :, None]
    lower, upper = np.minimum(a, b), np.maximum(a, b)
    low, high = box(theta, proposed, lower, upper, centre, reach)
    assert np.all(low <= high)
    # Within the limits, or no further out than the network's own angle.
    assert np.all(theta + low >= np.minimum(lower, proposed) - 1e-12)
    assert np.all(theta + high <= np.maximum(upper, proposed) + 1e-12)
    # Where both can be had, both are kept.
    meet = (centre - reach <= np.maximum(upper, proposed) - theta) & (
        centre + reach >= np.minimum(lower, proposed) - theta
    )
    assert np.all((low >= centre - reach - 1e-12)[meet])
    assert np.all((high <= centre + reach + 1e-12)[meet])


def test_limits_are_mirror_images_and_know_which_way_a_knee_bends() -> None:
    from mocap.skeleton import MIRROR

    lower, upper = ranges()
    assert np.all(lower[1:] < upper[1:]) and np.isinf(lower[0]).all()
    flipped = np.array([1, -1, -1])
    assert np.allclose(np.minimum(lower * flipped, upper * flipped), lower[list(MIRROR)])
    skeleton = Skeleton.default()
    for j, angle, axis, moves in (
        (4, 1.0, 2, -1),  # knee: the ankle goes back
        (18, 1.0, 2, 1),  # elbow: the wrist comes forward
    ):
        end = {4: 7, 18: 20}[j]
        way = int(np.argmax(np.maximum(upper[j], -lower[j])))
        sign = 1 if upper[j, way] > -lower[j, way] else -1
        R = np.tile(np.eye(3), (24, 1, 1))
        R[j] = ori.exp(angle * sign * np.eye(3)[way])
        p, rest = (skeleton.forward(r, np.zeros(3))[1] for r in (R, np.tile(np.eye(3), (24, 1, 1))))
        assert np.sign(p[end, axis] - rest[end, axis]) == moves
