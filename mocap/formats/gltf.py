"""glTF binary (`.glb`): a motion with its body, for Blender, three.js, Unity, Unreal and Godot.

One skinned mesh, one skeleton of the 24 joints by their SMPL names, one animation. Metres, y up, facing +z,
as glTF has it. Written only: a `.glb` holds a picture of a motion, and other tools export `.bvh`.

The layout is Khronos' glTF 2.0 specification: a JSON chunk that describes one buffer, the BIN chunk.
"""

from __future__ import annotations

import json
import struct
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.body import Look, Skin, skin
from mocap.errors import FormatError, ShapeError
from mocap.formats import Content, Format, written_only
from mocap.formats._files import write_aside
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS, Skeleton

COLOUR = (0.36, 0.53, 0.72, 1.0)
_TYPES = {np.dtype("<f4"): 5126, np.dtype("<u4"): 5125, np.dtype("<u2"): 5123, np.dtype("u1"): 5121}
_SHAPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_VERTICES, _INDICES = 34962, 34963  # targets of buffer views


class _Buffer:
    """The BIN chunk while it grows, with the views and accessors that name its parts."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.length = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """The accessor of an array (N,...). bounds: state its least and largest values, as
        positions and times must."""
        data = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": self.length, "byteLength": len(data)}
        self.views.append(view if target is None else view | {"target": target})
        accessor = {
            "bufferView": len(self.views) - 1, "componentType": _TYPES[values.dtype],
            "count": len(values), "type": _SHAPES[values.shape[1:]],
        }  # fmt: skip
        if bounds:
            low, high = np.atleast_1d(values.min(axis=0)), np.atleast_1d(values.max(axis=0))
            accessor |= {"min": low.tolist(), "max": high.tolist()}
        self.accessors.append(accessor)
        self.parts.append(data + b"\0" * (-len(data) % 4))
        self.length += len(self.parts[-1])
        return len(self.accessors) - 1


def write_motion(path: str | Path, motion: Motion, look: Look | None = None) -> None:
    """Write a motion on its body as glTF binary. look: see `mocap.body.skin`.

    Node k is joint k of `mocap.skeleton.JOINTS`; before the animation plays, the body stands in the T-pose.
    Joints are where the motion has them to a tenth of a millimetre, at every frame; between frames rotations
    and the pelvis' path are interpolated.
    """
    if motion.skeleton.names != JOINTS:
        raise ShapeError("glTF is written of the 24-joint body only")
    buffer = _Buffer()
    body = skin(motion.skeleton, look)
    stand = np.array([0.0, motion.skeleton.standing_height, 0.0])
    mesh = _mesh(buffer, body, stand)
    inverse = np.tile(np.eye(4), (24, 1, 1))
    inverse[:, :3, 3] = -(body.rest + stand)
    # Matrices are stored by columns.
    binds = buffer.add(np.swapaxes(inverse, 1, 2).astype("<f4"))
    document = {
        "asset": {"version": "2.0", "generator": _generator()},
        "scene": 0,
        "scenes": [{"nodes": [0, 24]}],
        "nodes": [*_nodes(motion.skeleton, stand), {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": [mesh],
        "materials": [{
            "name": "body",
            "pbrMetallicRoughness": {
                "baseColorFactor": COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.7,
            },
        }],
        "skins": [{"joints": list(range(24)), "skeleton": 0, "inverseBindMatrices": binds}],
        "animations": [_animation(buffer, motion)],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.length}],
        "extras": {"rate_hz": motion.rate_hz, "start_s": motion.start_s},
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + buffer.length
    if total >= 2**32:
        raise ShapeError("this motion needs more than the 4 GiB that a .glb file can hold")
    with write_aside(path) as aside, aside.open("wb") as f:
        f.write(struct.pack("<4sII", b"glTF", 2, total))
        f.write(struct.pack("<I4s", len(text), b"JSON") + text)
        f.write(struct.pack("<I4s", buffer.length, b"BIN\0"))
        f.writelines(buffer.parts)


def _generator() -> str:
    try:
        return f"poser {version('poser-imu')}"
    except PackageNotFoundError:
        return "poser"


def _mesh(buffer: _Buffer, body: Skin, stand: Array) -> dict[str, Any]:
    joints, weights = body.largest(4)
    count = len(body.vertices)
    attributes = {
        "POSITION": buffer.add((body.vertices + stand).astype("<f4"), _VERTICES, bounds=True),
        "NORMAL": buffer.add(body.normals(body.vertices).astype("<f4"), _VERTICES),
        "JOINTS_0": buffer.add(joints.astype("u1"), _VERTICES),
        "WEIGHTS_0": buffer.add(weights.astype("<f4"), _VERTICES),
    }
    indices = body.faces.ravel().astype("<u2" if count < 2**16 else "<u4")
    primitive = {"attributes": attributes, "indices": buffer.add(indices, _INDICES), "material": 0}
    return {"name": "body", "primitives": [primitive]}


def _nodes(skeleton: Skeleton, stand: Array) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = []
    for j, name in enumerate(JOINTS):
        node: dict[str, Any] = {"name": name}
        node["translation"] = (skeleton.offsets[j] if j else stand).tolist()
        children = [c for c, p in enumerate(skeleton.parents) if p == j]
        nodes.append(node | {"children": children} if children else node)
    return nodes


def _animation(buffer: _Buffer, motion: Motion) -> dict[str, Any]:
    """Rotations of all joints and the pelvis' path, all at the motion's frames."""
    times = buffer.add((np.arange(len(motion)) / motion.rate_hz).astype("<f4"), bounds=True)
    quats = ori.to_quat(motion.R_parent_joint, scalar_first=False)
    # Of the two signs the one nearer to the frame before: players interpolate the four numbers.
    turns = np.sign(np.sum(quats[1:] * quats[:-1], axis=-1))
    quats[1:] *= np.cumprod(np.where(turns < 0, -1.0, 1.0), axis=0)[..., None]
    outputs = [(0, "translation", buffer.add(motion.p_world_root.astype("<f4")))]
    outputs += [(j, "rotation", buffer.add(quats[:, j].astype("<f4"))) for j in range(24)]
    return {
        "name": "motion",
        "samplers": [
            {"input": times, "output": out, "interpolation": "LINEAR"} for _, _, out in outputs
        ],
        "channels": [
            {"sampler": k, "target": {"node": node, "path": what}}
            for k, (node, what, _) in enumerate(outputs)
        ],
    }


def _sniff(path: Path, head: bytes) -> bool:
    return head[:4] == b"glTF"


def _write(path: Path, content: Content) -> None:
    if not isinstance(content, Motion):
        raise FormatError(path, "glTF holds a motion, not a recording")
    write_motion(path, content)


FORMAT = Format(
    "gltf",
    (".glb",),
    _sniff,
    written_only,
    _write,
    kinds=("motion",),
    about="skeleton and body for Blender and three.js",
    sign="glTF",
)
