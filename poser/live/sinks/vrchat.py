"""Poses as VRChat's OSC trackers: eight points of the body and the head, over UDP, by convention port 9000.

/tracking/trackers/1/position .. 8 and head, three floats each: m in Unity's world, and Euler angles in
degrees which Unity applies z first, then x, then y: R = R_y R_x R_z. VRChat finds out by itself which
tracker is which part of the body. As for VMC the mirror M = diag(-1,1,1) makes Unity's axes of ours:
p' = M p, R' = M R M. See docs.vrchat.com, "OSC Trackers".
"""

from __future__ import annotations

import numpy as np

from mocap.estimator import Pose
from mocap.orientation import Array
from mocap.skeleton import JOINTS, Skeleton
from poser.live.addresses import Address, parse_host
from poser.live.sinks.protocol import Sink, SinkKind, SinkOrder
from poser.live.sinks.vmc import OscSink

PORT = 9000
TRACKERS = (
    "pelvis", "spine3", "left_ankle", "right_ankle", "left_knee", "right_knee", "left_elbow",
    "right_elbow",
)  # fmt: skip
"""The joints of trackers 1 to 8."""
_MIRROR = np.diag([-1.0, 1.0, 1.0])


def euler_deg(R: Array) -> Array:
    """Unity's Euler angles (3,) x, y, z in degrees of a rotation in its axes: R = R_y(y) R_x(x) R_z(z)."""
    x = np.arcsin(np.clip(-R[1, 2], -1.0, 1.0))
    if abs(R[1, 2]) < 1 - 1e-9:
        y, z = np.arctan2(R[0, 2], R[2, 2]), np.arctan2(R[1, 0], R[1, 1])
    else:  # looking straight up or down: only one of the two turns counts
        y, z = np.arctan2(-R[2, 0], R[0, 0]), 0.0
    return np.rad2deg(np.array([x, y, z]))


def points(pose: Pose, skeleton: Skeleton) -> dict[str, tuple[Array, Array]]:
    """Tracker -> position (3,) m and Euler angles (3,) deg in Unity's axes, in the world."""
    R, p = skeleton.forward(pose.R_parent_joint, pose.p_world_root)
    joints = {str(k + 1): JOINTS.index(n) for k, n in enumerate(TRACKERS)}
    joints["head"] = JOINTS.index("head")
    return {n: (_MIRROR @ p[j], euler_deg(_MIRROR @ R[j] @ _MIRROR)) for n, j in joints.items()}


def datagrams(pose: Pose, skeleton: Skeleton) -> list[bytes]:
    """The OSC bundle of one frame."""
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    bundle = OscBundleBuilder(IMMEDIATELY)
    for name, values in points(pose, skeleton).items():
        for what, xyz in zip(("position", "rotation"), values, strict=True):
            message = OscMessageBuilder(f"/tracking/trackers/{name}/{what}")
            for value in xyz.tolist():
                message.add_arg(value, "f")
            bundle.add_content(message.build())  # type: ignore[arg-type]
    return [bytes(bundle.build().dgram)]


def sink(address: Address, skeleton: Skeleton) -> OscSink:
    """Sends every pose of this body to an address."""
    return OscSink("vrchat", address, lambda pose: datagrams(pose, skeleton))


def _make(told: SinkOrder) -> Sink:
    return sink(parse_host(told.text, PORT, "argument --sink"), told.skeleton)


SINK = SinkKind("vrchat", "vrchat[:HOST[:PORT]]", "VRChat's OSC trackers", _make)
