"""VMC messages, decoded again as a receiver with Unity's axes would."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from pythonosc.osc_packet import OscPacket

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.estimator import Pose
from mocap.skeleton import JOINTS, Skeleton
from mocap.synthesis import motions
from poser.live import addresses
from poser.live.addresses import Address
from poser.live.sinks import vmc

BODY = Skeleton.default(1.8)
TO_UNITY = np.diag([-1.0, 1.0, 1.0])
UNITY_NAMES = {
    "Hips", "Spine", "Chest", "UpperChest", "Neck", "Head", "LeftShoulder", "LeftUpperArm",
    "LeftLowerArm", "LeftHand", "RightShoulder", "RightUpperArm", "RightLowerArm", "RightHand",
    "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToes", "RightUpperLeg", "RightLowerLeg",
    "RightFoot", "RightToes",
}  # fmt: skip


@pytest.fixture
def pose() -> Pose:
    motion = motions.walk(4.0)
    return Pose(1.25, motion.R_parent_joint[100], motion.p_world_root[100] + [0.3, 0, 0])


def received(datagrams: list[bytes]) -> dict[str, list[list[object]]]:
    found: dict[str, list[list[object]]] = {}
    for datagram in datagrams:
        for m in OscPacket(datagram).messages:
            found.setdefault(m.message.address, []).append(list(m.message.params))
    return found


def test_a_receiver_gets_the_pose_back(pose: Pose) -> None:
    bones = {b[0]: np.array(b[1:]) for b in received(vmc.datagrams(pose, BODY))[vmc.BONE]}
    assert set(bones) == UNITY_NAMES
    for j, joint in enumerate(JOINTS):
        if joint not in vmc.BONES:
            assert joint.endswith("hand")
            continue
        values = bones[vmc.BONES[joint]]
        R_unity = ori.from_quat(values[3:], scalar_first=False)
        back = TO_UNITY @ R_unity @ TO_UNITY
        np.testing.assert_allclose(back, pose.R_parent_joint[j], atol=1e-6)
        p = pose.p_world_root if j == 0 else BODY.offsets[j]
        np.testing.assert_allclose(TO_UNITY @ values[:3], p, atol=1e-6)


def test_unity_chains_the_bones_to_mirrored_joints(pose: Pose) -> None:
    """A left-handed receiver that multiplies local transforms finds the joints where ours are, mirrored."""
    bones = {b[0]: np.array(b[1:]) for b in received(vmc.datagrams(pose, BODY))[vmc.BONE]}
    _, p_ours = BODY.forward(pose.R_parent_joint, pose.p_world_root)
    where: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for j, joint in enumerate(JOINTS[:22]):
        values = bones[vmc.BONES[joint]]
        p, R = values[:3], ori.from_quat(values[3:], scalar_first=False)
        if j:
            above, turn = where[BODY.parents[j]]
            p, R = above + turn @ p, turn @ R
        where[j] = (p, R)
        np.testing.assert_allclose(p, TO_UNITY @ p_ours[j], atol=1e-5)


def test_directions_in_words() -> None:
    """Facing +z, left arm raised forward: in Unity the left hand is at -x and forward, +z."""
    R = np.tile(np.eye(3), (24, 1, 1))
    R[16] = ori.rot_y(-np.pi / 2)  # ours: the left arm from +x to +z
    sent = vmc.transforms(Pose(0.0, R, np.zeros(3)), Skeleton.default())
    assert sent["LeftUpperArm"][0][0] < 0 < sent["RightUpperArm"][0][0]
    turned = ori.from_quat(sent["LeftUpperArm"][1], scalar_first=False)
    arm = turned @ sent["LeftLowerArm"][0]
    assert arm[2] > 0.2 and abs(arm[0]) < 0.05


def test_head_of_a_frame_and_its_size(pose: Pose) -> None:
    datagrams = vmc.datagrams(pose, BODY)
    found = received(datagrams)
    assert found[vmc.OK] == [[1]]
    assert found[vmc.TIME] == [[1.25]]
    assert found[vmc.ROOT] == [["root", 0, 0, 0, 0, 0, 0, 1]]
    assert max(map(len, datagrams)) < 1472


def test_the_sink_sends_and_survives_a_missing_receiver(pose: Pose) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(2.0)
        sink = vmc.sink(Address("127.0.0.1", receiver.getsockname()[1]), BODY)
        sink.write(pose)
        count = len(vmc.datagrams(pose, BODY))
        assert len(received([receiver.recv(4096) for _ in range(count)])[vmc.BONE]) == 22
    for _ in range(3):
        sink.write(pose)
    assert sink.close()["sent"] >= count


def test_a_host_is_looked_up_once(pose: Pose, monkeypatch: pytest.MonkeyPatch) -> None:
    """By its IPv4 address where it has one."""
    asked: list[tuple[object, ...]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(2.0)
        port = receiver.getsockname()[1]

        def found(*args: object, **_: object) -> list[tuple[object, ...]]:
            asked.append(args)
            kinds = (socket.SOCK_DGRAM, socket.IPPROTO_UDP, "")
            six = (socket.AF_INET6, *kinds, ("::1", port, 0, 0))
            return [six, (socket.AF_INET, *kinds, ("127.0.0.1", port))]

        monkeypatch.setattr(socket, "getaddrinfo", found)
        # A name that the system does not know: any other look-up of it would fail.
        sink = vmc.sink(Address("performer.invalid", port), BODY)
        for _ in range(2):
            sink.write(pose)
        count = 2 * len(vmc.datagrams(pose, BODY))
        assert len(received([receiver.recv(4096) for _ in range(count)])[vmc.BONE]) == 44
        assert sink.close() == {"sent": count, "failures": 0}
    assert asked == [("performer.invalid", port)]


def test_a_host_of_ipv6_alone(pose: Pose, monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = (socket.SOCK_DGRAM, socket.IPPROTO_UDP, "")
    entry = (socket.AF_INET6, *kinds, ("::1", 39539, 0, 0))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [entry])
    found = addresses.resolved(Address("six.invalid", 39539), "vmc", socket.SOCK_DGRAM)
    assert found == (socket.AF_INET6, entry[4])


@pytest.mark.parametrize(
    "error", [socket.gaierror(-2, "not known"), UnicodeError("label too long")]
)
def test_an_unknown_host_is_one_sentence(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    with pytest.raises(PoserError, match=r"^vmc:nosuchhost.invalid:39539: the host is unknown$"):
        vmc.sink(Address("nosuchhost.invalid", 39539), BODY)
