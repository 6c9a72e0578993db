"""glTF read back as a player reads it: nodes, animation and skin by the specification, not by our writer."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from mocap.body import skin
from mocap.errors import FormatError
from mocap.formats import gltf, read
from mocap.motion import Motion
from mocap.skeleton import JOINTS, Skeleton
from mocap.synthesis import motions

SHAPES = {"SCALAR": (), "VEC3": (3,), "VEC4": (4,), "MAT4": (4, 4)}
TYPES = {5126: "<f4", 5125: "<u4", 5123: "<u2", 5121: "u1"}


class Asset:
    """A .glb file by the specification."""

    def __init__(self, path: Path):
        data = path.read_bytes()
        magic, number, total = struct.unpack_from("<4sII", data)
        assert (magic, number, total) == (b"glTF", 2, len(data))
        length, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and length % 4 == 0
        self.json: dict[str, Any] = json.loads(data[20 : 20 + length])
        size, kind = struct.unpack_from("<I4s", data, 20 + length)
        assert kind == b"BIN\0" and size % 4 == 0
        self.bin = data[28 + length :]
        assert len(self.bin) == size == self.json["buffers"][0]["byteLength"]

    def array(self, k: int) -> np.ndarray:
        accessor = self.json["accessors"][k]
        view = self.json["bufferViews"][accessor["bufferView"]]
        shape = (accessor["count"], *SHAPES[accessor["type"]])
        start = view["byteOffset"]
        part = self.bin[start : start + view["byteLength"]]
        values = np.frombuffer(part, TYPES[accessor["componentType"]]).reshape(shape)
        if "min" in accessor:
            np.testing.assert_array_equal(values.min(axis=0), np.squeeze(accessor["min"]))
            np.testing.assert_array_equal(values.max(axis=0), np.squeeze(accessor["max"]))
        return values

    def globals_at(self, time: float) -> np.ndarray:
        """(N,4,4) of all nodes at a time of the animation."""
        nodes = [dict(n) for n in self.json["nodes"]]
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            times, values = self.array(sampler["input"]), self.array(sampler["output"])
            now = [np.interp(time, times, values[:, c]) for c in range(values.shape[1])]
            nodes[channel["target"]["node"]][channel["target"]["path"]] = now
        local = np.tile(np.eye(4), (len(nodes), 1, 1))
        for k, node in enumerate(nodes):
            local[k, :3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
            local[k, :3, 3] = node.get("translation", [0, 0, 0])
        out = local.copy()

        def down(k: int) -> None:
            for c in nodes[k].get("children", []):
                out[c] = out[k] @ local[c]
                down(c)

        for root in self.json["scenes"][self.json["scene"]]["nodes"]:
            down(root)
        return out

    def vertices_at(self, time: float) -> np.ndarray:
        attributes = self.json["meshes"][0]["primitives"][0]["attributes"]
        (held,) = self.json["skins"]
        binds = np.swapaxes(self.array(held["inverseBindMatrices"]), 1, 2)
        joints = self.globals_at(time)[held["joints"]] @ binds
        v = self.array(attributes["POSITION"])
        index, weight = self.array(attributes["JOINTS_0"]), self.array(attributes["WEIGHTS_0"])
        blended = np.einsum("vk,vkab->vab", weight, joints[index])
        return np.asarray(np.einsum("vab,vb->va", blended, np.c_[v, np.ones(len(v))])[:, :3])


@pytest.fixture(scope="module")
def motion() -> Motion:
    return motions.walk(3.0, rate_hz=50.0).on(Skeleton.default(1.8))


@pytest.fixture(scope="module")
def path(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gltf") / "walk.glb"
    gltf.write_motion(path, motion)
    return path


def test_joints_are_within_a_millimetre_at_every_frame(path: Path, motion: Motion) -> None:
    asset = Asset(path)
    names = [n["name"] for n in asset.json["nodes"]]
    (held,) = asset.json["skins"]
    assert [names[k] for k in held["joints"]] == list(JOINTS)
    for t in range(len(motion)):
        joints = asset.globals_at(t / motion.rate_hz)[held["joints"]]
        assert np.linalg.norm(joints[:, :3, 3] - motion.p_world_joint[t], axis=1).max() < 1e-3
        np.testing.assert_allclose(joints[:, :3, :3], motion.R_world_joint[t], atol=1e-5)


def test_between_frames_nothing_jumps(path: Path, motion: Motion) -> None:
    asset = Asset(path)
    for t in range(20, 40):
        middle = asset.globals_at((t + 0.5) / motion.rate_hz)[:24, :3, 3]
        straight = motion.p_world_joint[t : t + 2].mean(axis=0)
        assert np.linalg.norm(middle - straight, axis=1).max() < 5e-3


def test_the_skin_moves_as_ours(path: Path, motion: Motion) -> None:
    asset = Asset(path)
    look = skin(motion.skeleton)
    for t in (0, 37, 99):
        ours = look.posed(motion.R_world_joint[t], motion.p_world_joint[t])
        assert np.linalg.norm(asset.vertices_at(t / motion.rate_hz) - ours, axis=1).max() < 1e-3


def test_without_its_animation_a_body_stands_on_the_floor(path: Path) -> None:
    scene = trimesh.load(path)
    assert scene.bounds[0][1] == pytest.approx(0.0, abs=0.02)
    assert scene.bounds[1][1] == pytest.approx(1.8, abs=0.03)
    (mesh,) = scene.geometry.values()
    assert len(mesh.faces) == len(skin(Skeleton.default()).faces)
    # Counter-clockwise faces look outwards, and so do the normals.
    assert mesh.volume > 0.04
    centre = mesh.vertices[:, [0, 2]].mean(axis=0)
    waist = np.abs(mesh.vertices[:, 1] - 1.05) < 0.05
    waist &= np.abs(mesh.vertices[:, 0]) < 0.25
    outward = mesh.vertices[waist][:, [0, 2]] - centre
    assert (np.sum(mesh.vertex_normals[waist][:, [0, 2]] * outward, axis=1) > 0).mean() > 0.9


def test_one_frame_and_capsules(tmp_path: Path, motion: Motion) -> None:
    gltf.write_motion(tmp_path / "one.glb", motion.slice(5, 6), "capsules")
    asset = Asset(tmp_path / "one.glb")
    np.testing.assert_allclose(asset.globals_at(0)[:24, :3, 3], motion.p_world_joint[5], atol=1e-3)


def test_it_is_not_read(path: Path) -> None:
    with pytest.raises(
        FormatError, match=r"walk\.glb.*writes such files, and reads none.*export BVH"
    ):
        read(path)
