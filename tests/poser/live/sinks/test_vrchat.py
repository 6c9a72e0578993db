"""VRChat's trackers: Unity's axes and Euler angles, and the datagrams that arrive."""

from __future__ import annotations

import socket
from contextlib import closing

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.estimator import Pose
from mocap.skeleton import JOINTS, Skeleton
from mocap.synthesis import motions
from poser.live import sinks
from poser.live.addresses import Address
from poser.live.sinks import vrchat

BODY = Skeleton.default()
MIRROR = np.diag([-1.0, 1.0, 1.0])


def rest(**turned: np.ndarray) -> Pose:
    R = np.tile(np.eye(3), (24, 1, 1))
    for name, value in turned.items():
        R[JOINTS.index(name)] = value
    return Pose(0.0, R, np.array([0.3, 1.0, 0.2]))


def unity(xyz_deg: np.ndarray) -> np.ndarray:
    """z first, then x, then y."""
    x, y, z = np.deg2rad(xyz_deg)
    return np.asarray(ori.rot_y(y) @ ori.rot_x(x) @ ori.rot_z(z))


def test_euler_angles_give_the_rotation_back() -> None:
    rng = np.random.default_rng(1)
    for R in ori.from_quat(rng.normal(size=(200, 4))):
        np.testing.assert_allclose(unity(vrchat.euler_deg(R)), R, atol=1e-9)
    for up in (np.pi / 2, -np.pi / 2):
        R = ori.rot_y(0.7) @ ori.rot_x(up) @ ori.rot_z(0.2)
        np.testing.assert_allclose(unity(vrchat.euler_deg(R)), R, atol=1e-6)


def test_left_is_left_in_unity() -> None:
    """x is to the right there: the left foot has a negative one; a turn to the left is a negative angle."""
    points = vrchat.points(rest(pelvis=ori.rot_y(0.5)), BODY)
    assert set(points) == {*map(str, range(1, 9)), "head"}
    left, right = points["3"][0], points["4"][0]
    assert left[0] < -0.3 < right[0]
    np.testing.assert_allclose(points["1"][0], [-0.3, 1.0, 0.2])
    np.testing.assert_allclose(points["1"][1], [0, np.rad2deg(-0.5), 0], atol=1e-9)


def test_points_are_those_of_the_body() -> None:
    motion = motions.walk(3.0)
    pose = Pose(0.0, motion.R_parent_joint[50], motion.p_world_root[50])
    R, p = BODY.forward(pose.R_parent_joint, pose.p_world_root)
    for name, (position, angles) in vrchat.points(pose, BODY).items():
        j = JOINTS.index("head" if name == "head" else vrchat.TRACKERS[int(name) - 1])
        np.testing.assert_allclose(MIRROR @ position, p[j])
        np.testing.assert_allclose(MIRROR @ unity(angles) @ MIRROR, R[j], atol=1e-9)


def test_datagrams_arrive() -> None:
    from pythonosc.osc_bundle import OscBundle

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        with closing(vrchat.sink(Address("127.0.0.1", receiver.getsockname()[1]), BODY)) as sink:
            sink.write(rest())
        datagram = receiver.recv(4096)
    assert len(datagram) < 1472  # one packet on an Ethernet
    content = {m.address: m.params for m in OscBundle(datagram)}  # type: ignore[union-attr]
    assert len(content) == 18
    np.testing.assert_allclose(
        content["/tracking/trackers/1/position"], [-0.3, 1.0, 0.2], atol=1e-6
    )
    assert content["/tracking/trackers/head/rotation"] == [0, 0, 0]
    assert sink.sent == 1


@pytest.mark.parametrize(
    ("text", "kind", "rest"),
    [
        ("vrchat", "vrchat", ""),
        ("vrchat:192.168.0.3", "vrchat", "192.168.0.3"),
        ("viewer", "viewer", ""),
        ("vmc:39539", "vmc", "39539"),
        ("lsl", "lsl", ""),
        ("a.bvh", "file", "a.bvh"),
        ("b.RRD", "rerun", "b.RRD"),
        ("odd.txt", "file", "odd.txt"),
    ],
)
def test_words_choose_sinks(text: str, kind: str, rest: str) -> None:
    found, behind = sinks.chosen(text)
    assert (found.name, behind) == (kind, rest)
