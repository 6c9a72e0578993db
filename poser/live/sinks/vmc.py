"""Poses as messages of the Virtual Motion Capture protocol (VMC), for Unity, Unreal, Blender, VSeeFace.

OSC over UDP, by convention to port 39539 (protocol.vmc.info). Per frame /VMC/Ext/OK (i 1), /VMC/Ext/T
(f seconds), /VMC/Ext/Root/Pos and one /VMC/Ext/Bone/Pos a bone: name, local position x, y, z in m, local
rotation x, y, z, w. Bone names are those of Unity's HumanBodyBones.

Unity is left-handed: x right, y up, z forward; ours x left, y up, z forward. The mirror M = diag(-1,1,1)
takes one to the other: p' = M p, R' = M R M, so a quaternion (x, y, z, w) becomes (x, -y, -z, w). The
humanoid's T-pose is the identity in both, and left stays left. The root object stays at the origin, the
hips carry where the body is. SMPL's hand joints have no bone there: the wrists' rotations are the hands'.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

import numpy as np

from mocap import orientation as ori
from mocap.estimator import Pose
from mocap.orientation import Array
from mocap.skeleton import JOINTS, Skeleton
from poser.live import osc_messages
from poser.live.addresses import Address, parse, resolved
from poser.live.sinks.protocol import Sink, SinkKind, SinkOrder

_SIDED = {"hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes", "collar": "Shoulder",
          "shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand"}  # fmt: skip
BONES: dict[str, str] = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Chest", "spine3": "UpperChest", "neck": "Neck",
    "head": "Head",
} | {f"{side.lower()}_{joint}": side + bone
     for side in ("Left", "Right") for joint, bone in _SIDED.items()}  # fmt: skip
"""HumanBodyBones by joint."""

ROOT, BONE, TIME, OK = "/VMC/Ext/Root/Pos", "/VMC/Ext/Bone/Pos", "/VMC/Ext/T", "/VMC/Ext/OK"
MESSAGES = 12  # of 80 to 100 bytes in a datagram: below an Ethernet frame of 1500
_MIRROR_QUAT = np.array([1.0, -1.0, -1.0, 1.0])  # x, y, z, w


def transforms(pose: Pose, skeleton: Skeleton) -> dict[str, tuple[Array, Array]]:
    """Bone name -> local position (3,) m and quaternion (4,) x, y, z, w, in Unity's axes."""
    p = np.array(skeleton.offsets)
    p[0] = pose.p_world_root
    p[:, 0] *= -1
    q = ori.to_quat(pose.R_parent_joint, scalar_first=False) * _MIRROR_QUAT
    return {BONES[name]: (p[j], q[j]) for j, name in enumerate(JOINTS) if name in BONES}


def datagrams(pose: Pose, skeleton: Skeleton) -> list[bytes]:
    """The OSC bundles of one frame."""
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    def message(address: str, types: str, *values: object) -> object:
        builder = OscMessageBuilder(address)
        for kind, value in zip(types, values, strict=True):
            builder.add_arg(value, kind)  # type: ignore[arg-type]
        return builder.build()

    content = [
        message(OK, "i", 1),
        message(TIME, "f", pose.time_s),
        message(ROOT, "sfffffff", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    ]
    for name, (p, q) in transforms(pose, skeleton).items():
        content.append(message(BONE, "sfffffff", name, *p.tolist(), *q.tolist()))
    bundles = []
    for start in range(0, len(content), MESSAGES):
        bundle = OscBundleBuilder(IMMEDIATELY)
        for part in content[start : start + MESSAGES]:
            bundle.add_content(part)  # type: ignore[arg-type]
        bundles.append(bytes(bundle.build().dgram))
    return bundles


class OscSink:
    """Sends every pose to an address, as the datagrams that `encode` makes of it. failures: datagrams that
    the system refused to send.

    Raises PoserError where the host's name is unknown.
    """

    def __init__(self, kind: str, address: Address, encode: Callable[[Pose], list[bytes]]):
        osc_messages.library()
        self.name = f"{kind}:{address}"
        self._encode = encode
        # Once: a look-up of a name may take as long as many frames.
        family, self._to = resolved(address, self.name, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.sent = self.failures = 0

    def write(self, pose: Pose) -> None:
        for datagram in self._encode(pose):
            try:
                self._socket.sendto(datagram, self._to)
                self.sent += 1
            except OSError:
                # Nobody listens, the network is down, the queue is full: the next frame tries again.
                self.failures += 1

    def close(self) -> dict[str, object]:
        self._socket.close()
        return {"sent": self.sent, "failures": self.failures}


def sink(address: Address, skeleton: Skeleton) -> OscSink:
    """Sends every pose of this body to an address."""
    return OscSink("vmc", address, lambda pose: datagrams(pose, skeleton))


def _make(told: SinkOrder) -> Sink:
    return sink(parse(told.text, "argument --sink"), told.skeleton)


SINK = SinkKind("vmc", "vmc:PORT, vmc:HOST:PORT", "VMC: Unity, Unreal, Blender, VSeeFace", _make)
