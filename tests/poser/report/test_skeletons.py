"""The player's data: what the page skins is where the motion has it."""

from __future__ import annotations

import base64

import numpy as np

from mocap import orientation as ori
from mocap.body import mesh_skin
from mocap.orientation import Array
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.report import skeletons


def unpacked(text: str, kind: str, width: int) -> Array:
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, width).astype(float)


def test_the_page_s_skin_is_the_body_s() -> None:
    """Whole mm, quaternions of 16 bits, four weights of a byte: within 8 mm of the skin, most within 2."""
    mesh, tall = skeletons.Mesh(), motions.walk(3.0, rate_hz=30.0).on(Skeleton.default(1.9))
    short = tall.on(Skeleton.default(1.6))
    # The pelvis is in the middle of the floor, as the player has it.
    poses = [skeletons._poses(m, 30.0, m, mesh) for m in (tall, short, tall)]
    data = mesh.data()
    assert [p["body"] for p in poses] == [0, 1, 0] and len(data["bodies"]) == 2
    joints = unpacked(data["joints"], "u1", 4).astype(int)
    weights = unpacked(data["weights"], "u1", 4) / 255
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-9)
    faces = unpacked(data["faces"], "<u2", 3)
    for motion, found in zip((tall, short), poses, strict=False):
        body = data["bodies"][found["body"]]
        rest, at_rest = unpacked(body["rest"], "<i2", 3), unpacked(body["vertices"], "<i2", 3)
        k = 40
        p = unpacked(found["data"], "<i2", 72)[k].reshape(24, 3)
        R = ori.from_quat(unpacked(found["turns"], "<i2", 96)[k].reshape(24, 4))
        hung = np.einsum("vkij,vkj->vki", R[joints], at_rest[:, None] - rest[joints]) + p[joints]
        shown = np.einsum("vk,vki->vi", weights, hung) / 1000
        look = mesh_skin(motion.skeleton)
        np.testing.assert_array_equal(faces, look.faces)
        centre = motion.p_world_joint[k] - motion.p_world_joint[k, 0] * [1, 0, 1]
        apart = np.linalg.norm(shown - look.posed(motion.R_world_joint[k], centre), axis=1)
        assert apart.max() < 0.008 and np.median(apart) < 0.002


def test_several_bodies_are_light() -> None:
    """The mesh is in the page once: about 0.3 MB, and 0.05 MB for each further skeleton."""
    mesh = skeletons.Mesh()
    mesh.index(Skeleton.default())
    one = len(str(mesh.data()))
    mesh.index(Skeleton.default(1.9))
    assert one < 400_000 and len(str(mesh.data())) - one < 60_000
