"""Skins: capsules, the free mesh on any skeleton, SMPL's mesh; and how they bend."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap import orientation as ori
from mocap.body import mesh_skin, skin
from mocap.body.capsules import capsule
from mocap.errors import PoserError
from mocap.formats.smpl import SmplMesh
from mocap.orientation import Array
from mocap.skeleton import JOINTS, Skeleton
from mocap.synthesis import motions
from mocap.synthesis.posing import Score, pose

point = st.lists(st.floats(-2, 2), min_size=3, max_size=3).map(np.array)


@given(point, point, st.floats(0.01, 0.5))
def test_a_capsule_is_all_points_at_its_radius(
    start: np.ndarray, end: np.ndarray, r: float
) -> None:
    vertices, faces = capsule(start, end, r)
    axis = end - start
    along = np.clip((vertices - start) @ axis / max(axis @ axis, 1e-18), 0, 1)
    distance = np.linalg.norm(vertices - (start + along[:, None] * axis), axis=1)
    np.testing.assert_allclose(distance, r, rtol=1e-6, atol=1e-6)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Signed volume by the divergence theorem: positive where faces look outward, and near the capsule's.
    centred = corners - (start + end) / 2
    volume = np.einsum("fi,fi->", centred[:, 0], normals) / 6
    exact = np.pi * r**2 * np.linalg.norm(axis) + 4 / 3 * np.pi * r**3
    assert 0.9 * exact < volume < exact


def test_every_bone_has_its_capsule_and_moves_with_its_joint() -> None:
    body = Skeleton.default(1.9)
    look = skin(body, "capsules")
    assert (look.weights.sum(axis=1) == 1).all()
    assert set(look.weights.argmax(axis=1)) >= set(body.parents) - {-1}
    assert look.faces.max() == len(look.vertices) - 1
    height = np.ptp(look.vertices[:, 1])
    assert height == pytest.approx(1.9, abs=0.08)
    left, right = (look.vertices[:, 0].max(), look.vertices[:, 0].min())
    assert left == pytest.approx(-right, abs=0.02)


def test_the_smpl_mesh_is_taken_where_there_is_one() -> None:
    body = Skeleton.default()
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(24), size=5)
    mesh = SmplMesh(
        rng.normal(size=(5, 3)), body.rest_positions, weights, np.zeros((5, 3, 207)),
        np.array([[0, 1, 2], [2, 3, 4]]),
    )  # fmt: skip
    dressed = Skeleton(body.names, body.parents, body.offsets, body.betas, mesh)
    look = skin(dressed)
    # Moved by bones and weights alone, the skin is where SMPL's own skinning puts the vertices.
    motion = motions.walk(3.0).on(dressed).slice(50, 51)
    R, p = motion.R_world_joint[0], motion.p_world_joint[0]
    np.testing.assert_allclose(look.posed(R, p), mesh.vertices(motion)[0], atol=1e-9)
    assert len(skin(dressed, "mesh").vertices) > 1000
    with pytest.raises(PoserError, match="--smpl"):
        skin(body, "smpl")


def held(**joints: Array) -> Array:
    """Local rotations (24,3,3) of a pose."""
    R = np.tile(np.eye(3), (24, 1, 1))
    for name, rotation in joints.items():
        for k, side in enumerate(("left_", "right_")):
            if name in JOINTS:
                R[JOINTS.index(name)] = rotation
            else:
                # A rotation of the left side's joint, mirrored for the right one.
                mirror = np.diag([-1.0, 1, 1]) if k else np.eye(3)
                R[JOINTS.index(side + name)] = mirror @ rotation @ mirror
    return R


def deg(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Array:
    return np.asarray(ori.exp(np.radians([x, y, z])))


POSES = {
    "t": held(),
    "n": held(shoulder=deg(z=-78), elbow=deg(y=-10)),
    "squat": held(hip=deg(-95) @ deg(z=12), knee=deg(115), ankle=deg(-22), spine2=deg(15)),
    "overhead": held(collar=deg(z=25), shoulder=deg(z=60)),
    "seat": held(hip=deg(-85), knee=deg(85), shoulder=deg(-25) @ deg(z=-72), elbow=deg(y=-70)),
    "twisted": held(
        shoulder=deg(z=-75), elbow=deg(y=-100), wrist=deg(80), spine2=deg(y=30), head=deg(y=50)
    ),
}


def edges(faces: Array) -> Array:
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0)


def lengths(vertices: Array, pairs: Array) -> Array:
    return np.asarray(
        np.linalg.norm(vertices[..., pairs[:, 0], :] - vertices[..., pairs[:, 1], :], axis=-1)
    )


@pytest.mark.parametrize("name", POSES)
def test_no_edge_of_the_mesh_is_stretched(name: str) -> None:
    body = Skeleton.default()
    look = mesh_skin(body)
    pairs = edges(look.faces)
    at_rest = lengths(look.vertices, pairs)
    moved = lengths(look.posed(*body.forward(POSES[name], np.zeros(3))), pairs)
    assert (moved < 2 * at_rest + 0.01).all()
    assert (moved < at_rest + 0.035).all()


LIMITS = {
    "hip": ((-120, 0, 0), (25, 0, 0), (0, 0, 40), (0, 0, -25), (0, 40, 0), (0, -40, 0)),
    "knee": ((140, 0, 0),),
    "ankle": ((-25, 0, 0), (50, 0, 0), (0, 0, 25), (0, 0, -25)),
    "shoulder": ((0, 0, -85), (0, 0, 85), (0, -110, 0), (0, 45, 0), (70, 0, 0), (-70, 0, 0)),
    "collar": ((0, 0, 30), (0, -20, 0), (0, 20, 0)),
    "elbow": ((0, -145, 0),),
    "wrist": ((80, 0, 0), (0, 0, 75), (0, 0, -75)),
    "neck": ((40, 0, 0), (-40, 0, 0), (0, 50, 0), (0, 0, 35)),
    "head": ((35, 0, 0), (-35, 0, 0), (0, 50, 0)),
    "spine1": ((40, 0, 0), (-20, 0, 0), (0, 25, 0), (0, 0, 25)),
    "spine2": ((35, 0, 0), (-15, 0, 0), (0, 25, 0), (0, 0, 25)),
    "spine3": ((30, 0, 0), (-15, 0, 0), (0, 25, 0), (0, 0, 20)),
}
"""About where joints end, deg about x, y and z of the left side, each alone."""


@pytest.mark.parametrize("joint", LIMITS)
def test_no_edge_is_stretched_at_the_limits_of_a_joint(joint: str) -> None:
    body = Skeleton.default()
    look = mesh_skin(body)
    pairs = edges(look.faces)
    at_rest = lengths(look.vertices, pairs)
    for turn in LIMITS[joint]:
        R = held(**{joint: deg(*turn)})
        moved = lengths(look.posed(*body.forward(R, np.zeros(3))), pairs)
        ratio = moved / np.maximum(at_rest, 5e-3)
        assert ratio.max() < 3.0 and np.quantile(ratio, 0.999) < 2.0, (turn, ratio.max())
        assert (moved - at_rest).max() < 0.035, turn


def test_joints_lie_inside_the_mesh() -> None:
    """The skin around each bone surrounds it: seen along the bone there is skin in every quarter."""
    body = Skeleton.default()
    look = mesh_skin(body)
    for j, parent in enumerate(body.parents):
        if parent < 0 or JOINTS[j].endswith(("collar", "hip", "foot", "hand")):
            continue
        start, end = look.rest[parent], look.rest[j]
        along = (end - start) / np.linalg.norm(end - start)
        near = look.vertices - end
        slab = np.abs(near @ along) < 0.03
        across = near[slab & (np.linalg.norm(near, axis=1) < 0.25)]
        across = across - np.outer(across @ along, along)
        side = np.cross(along, [0.3, 0.5, 0.8])
        side /= np.linalg.norm(side)
        angle = np.arctan2(across @ np.cross(along, side), across @ side)
        assert len(set(np.floor(angle / (np.pi / 2)))) == 4, JOINTS[j]


@pytest.mark.parametrize("height", [1.2, 1.7, 2.0])
def test_the_mesh_is_as_tall_as_its_skeleton(height: float) -> None:
    body = Skeleton.default(height)
    look = mesh_skin(body)
    assert np.ptp(look.vertices[:, 1]) == pytest.approx(height, rel=0.01)
    assert look.vertices[:, 1].min() == pytest.approx(-body.standing_height, abs=0.01 * height)
    np.testing.assert_allclose(look.weights.sum(axis=1), 1, atol=1e-12)
    faces = look.vertices[look.faces]
    assert np.einsum("fi,fi->", faces[:, 0], np.cross(faces[:, 1], faces[:, 2])) > 0  # outwards


def test_the_mesh_follows_long_limbs_and_short_ones() -> None:
    table = Skeleton.default()
    offsets = table.offsets.copy()
    offsets[[4, 5]] *= 1.2
    offsets[[18, 19]] *= 0.8
    body = table.with_offsets(offsets)
    look = mesh_skin(body)
    hand = look.weights[:, [20, 22]].sum(axis=1) > 0.99
    shift = look.vertices[hand] / (body.stature / table.stature) - mesh_skin(table).vertices[hand]
    # The hand keeps its shape, and is where the shorter arm ends.
    np.testing.assert_allclose(shift - shift.mean(axis=0), 0, atol=5e-3)
    moved = lengths(look.vertices, edges(look.faces))
    assert (moved < 1.5 * lengths(mesh_skin(table).vertices, edges(look.faces)) + 0.005).all()


def test_soles_stand_on_the_floor() -> None:
    standing = pose(Score.blank(0.1, 60.0))
    look = mesh_skin(standing.skeleton)
    low = look.posed(standing.R_world_joint, standing.p_world_joint)[..., 1].min(axis=1)
    np.testing.assert_allclose(low, 0, atol=0.012)
