"""Xsens MVN: bytes of the documented layout, and a simulated suit over the loopback."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors
from mocap.formats import read
from mocap.formats.mvnx import R_OURS_MVN, straightened
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from poser.live.addresses import Address
from poser.live.packets import Packet, Rejected
from poser.live.receiver import Receiver
from poser.live.recorder import Recorder
from poser.live.sources import mvn
from poser.live.sources.mvn import SEGMENTS, Mvn, Suit
from tests.poser.live.sources.conftest import (
    RATE,
    SIX,
    Time,
    accelerations,
    heard,
    same_poses,
    wxyz,
)

STRAIGHT = straightened(Skeleton.default())
JOINT = {
    "Pelvis": 0, "L5": 3, "T12": 6, "T8": 9, "Neck": 12, "Head": 15, "LeftShoulder": 13,
    "RightShoulder": 14, "LeftUpperArm": 16, "RightUpperArm": 17, "LeftForeArm": 18,
    "RightForeArm": 19, "LeftHand": 20, "RightHand": 21, "LeftUpperLeg": 1, "RightUpperLeg": 2,
    "LeftLowerLeg": 4, "RightLowerLeg": 5, "LeftFoot": 7, "RightFoot": 8, "LeftToe": 10, "RightToe": 11,
}  # fmt: skip


def item(segment: int, p: Array, q: list[float]) -> bytes:
    return struct.pack(">i7f", segment, *p, *q)


def datagram(
    sample: int, ms: int, items: list[bytes], who: int = 0, head: bytes = b"MXTP02"
) -> bytes:
    body = b"".join(items)
    return (
        head + struct.pack(">IBBIBBBBHH", sample, 0x80, len(items), ms, who, len(items), 0, 0, 0, len(body))
        + body
    )  # fmt: skip


def suit(motion: Motion, k: int, who: int = 0) -> bytes:
    """All 23 segments of a frame, as MVN streams them: 60 Hz, times in whole ms.

    Segment frames are the world's in the T-pose with straight limbs, our bones' in our rest pose. The pelvis'
    origin is between the hips.
    """
    hips = motion.p_world_joint[k, 1:3].mean(axis=0)
    items = []
    for n, name in enumerate(SEGMENTS, 1):
        j = JOINT.get(name, 6)
        R_world_segment = motion.R_world_joint[k, j] @ STRAIGHT.get(j, np.eye(3)).T
        R = R_OURS_MVN.T @ R_world_segment @ R_OURS_MVN
        p = hips if n == 1 else motion.p_world_joint[k, j]
        items.append(item(n, R_OURS_MVN.T @ p, wxyz(R)))
    return datagram(1000 + k, round(k * 1000 / 60), items, who)


def test_a_datagram_of_the_documented_layout() -> None:
    """The layout byte for byte; then the pelvis at rest speeds up by 1 m/s^2 along x."""
    golden = bytes.fromhex(
        "4d5854503032 00000001 80 01 0000000a 00 01 00 00 0000 0020"
        "00000001 3f800000 00000000 3f800000 3f800000 00000000 00000000 00000000"
    )
    assert datagram(1, 10, [item(1, np.array([1.0, 0, 1]), [1, 0, 0, 0])]) == golden
    decode, found = Mvn(), []
    assert list(decode(golden)) == []
    for k in range(2, 14):
        x = 0.5 * (k / 100) ** 2
        found += list(decode(datagram(k, 10 * k, [item(1, np.array([x, 0, 1]), [1, 0, 0, 0])])))
    last = found[-1]
    assert isinstance(last, Packet) and last.device == "pelvis"
    np.testing.assert_allclose(last.R_world_sensor, np.eye(3), atol=1e-7)
    # x forward of MVN is our z; 1 m/s^2.
    np.testing.assert_allclose(last.acc_world, [0, 0, 1], atol=0.05)
    assert last.seq == 12


def test_segments_turn_as_bones_do() -> None:
    """A left arm hanging: about MVN's x, which is forward, is about our z."""
    q = [float(np.cos(np.pi / 4)), float(np.sin(np.pi / 4)), 0.0, 0.0]
    found = []
    decode = Mvn()
    for k in range(14):
        found += list(decode(datagram(k, 16 * k, [item(14, np.zeros(3), q)])))
    assert {p.device for p in found if isinstance(p, Packet)} == {"left_forearm"}
    expected = ori.rot_z(np.pi / 2) @ STRAIGHT[JOINT["LeftForeArm"]]
    np.testing.assert_allclose(found[-1].R_world_sensor, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"", "not MVN"),
        (b"MXTP02\0\0", "too short"),
        (datagram(1, 1, [item(1, np.zeros(3), [1, 0, 0, 0])])[:-1], "too short"),
        (datagram(1, 1, [], head=b"MXTP01"), "not orientations (MXTP02)"),
        (datagram(1, 1, [item(1, np.zeros(3), [0, 0, 0, 0])]), "not a unit quaternion"),
        (datagram(1, 1, [item(1, np.array([np.nan, 0, 0]), [1, 0, 0, 0])]), "not finite"),
    ],
)
def test_what_does_not_fit_is_refused(bad: bytes, reason: str) -> None:
    [found] = Mvn()(bad)
    assert isinstance(found, Rejected) and found.reason == reason


def test_random_bytes_stop_nothing() -> None:
    rng, decode = np.random.default_rng(3), Mvn()
    for k in range(1000):
        bad = bytearray(datagram(k, k, [item(1, np.zeros(3), [1, 0, 0, 0])]))
        for at in rng.integers(6, len(bad), size=3):
            bad[at] = rng.integers(256)
        for found in decode(bytes(bad)):
            assert isinstance(found, Packet | Rejected)


@pytest.fixture
def motion(worn: Recording) -> Motion:
    assert worn.reference is not None
    return worn.reference


@pytest.fixture
def listening() -> Iterator[tuple[Receiver, Time, socket.socket]]:
    time = Time()
    with (
        closing(Suit(Address("127.0.0.1", 0), time)) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        yield receiver, time, sender


def test_a_simulated_suit_gives_the_poses_of_the_recording(
    worn: Recording, motion: Motion, listening: tuple[Receiver, Time, socket.socket]
) -> None:
    receiver, time, sender = listening
    source, got = heard(
        receiver, time, worn, lambda k: sender.sendto(suit(motion, k), ("127.0.0.1", receiver.port)),
        mvn.SOURCE.worn(SIX) if mvn.SOURCE.worn else None,
    )  # fmt: skip
    # The first packets wait until the time of a sample is known; whole ms cost a fraction of a degree.
    first = round(mvn.ENOUGH) - 2
    same_poses(got, worn, first, within_deg=0.5)
    found, expected = accelerations(got, worn, first)
    error = np.sqrt(np.nanmean((found[5:] - expected[5:]) ** 2))
    assert error < 0.2
    counts = source.facts()["devices"]
    assert all(c["lost"] == c["duplicates"] == 0 for c in counts.values())


def test_loss_reordering_restart_and_a_second_character(
    worn: Recording, motion: Motion, listening: tuple[Receiver, Time, socket.socket]
) -> None:
    receiver, time, sender = listening
    rng = np.random.default_rng(2)

    def send(k: int) -> None:
        to = ("127.0.0.1", receiver.port)
        if rng.random() < 0.02:
            return
        if k == 100:
            sender.sendto(suit(motion, 90), to)
        if k == 120:
            sender.sendto(b"MXTP25" + bytes(100), to)
        if k % 50 == 0:
            sender.sendto(suit(motion, k, who=1), to)
        frame = suit(motion, k)
        if k >= 200:  # MVN was started anew: sample and time begin at 0
            frame = frame[:6] + struct.pack(">I", k - 200) + frame[10:12] + struct.pack(
                ">I", round((k - 200) * 1000 / 60)) + frame[16:]  # fmt: skip
        sender.sendto(frame, to)

    source, got = heard(receiver, time, worn, send)
    facts = source.facts()
    assert facts["rejected"]["out of order"] == 1
    assert facts["rejected"]["not orientations (MXTP02)"] == 1
    valid = np.array([s.valid.all() for s in got])
    t = np.array([s.time_s for s in got])
    assert valid[t < 2.8].mean() > 0.9 and valid[(t > 4.5) & (t < 5.6)].mean() > 0.9
    assert all(d["jumps"] == 1 for d in facts["devices"].values())


def test_what_mvn_has_solved_is_kept_as_the_reference(
    worn: Recording,
    motion: Motion,
    listening: tuple[Receiver, Time, socket.socket],
    tmp_path: Path,
) -> None:
    """With a few datagrams lost: bones and the motion on one clock, in one file."""
    receiver, time, sender = listening
    path = tmp_path / "s.npz"
    recorder = Recorder(path, SIX, RATE, bones=True, reference=motion.skeleton)

    def send(k: int) -> None:
        if k not in (100, 101, 150):
            sender.sendto(suit(motion, k), ("127.0.0.1", receiver.port))

    source, _ = heard(receiver, time, worn, send, recorder=recorder)
    source.close()
    kept = read(path).content
    assert isinstance(kept, Recording) and kept.reference is not None and kept.sensors == SIX
    first = mvn.ENOUGH - 2 + round(kept.start_s * RATE)
    count = len(kept)
    assert count > 0.9 * len(worn)
    R, p = kept.reference.R_world_joint, kept.reference.p_world_joint
    true = motion.slice(first, first + count)
    off = np.rad2deg(ori.angle_between(R, true.R_world_joint[:count]))
    assert off.max() < 1.0 and np.median(off) < 0.05  # the largest across what was lost
    apart = np.linalg.norm(p - true.p_world_joint[:count], axis=-1)
    assert apart.max() < 0.01 and np.median(apart) < 1e-3
    ok = kept.ori_valid
    bones = R[:, kept.joint]
    assert np.rad2deg(ori.angle_between(kept.R_world_bone[ok], bones[ok])).max() < 0.5


def test_a_second_mvn_waits_until_the_first_is_gone(motion: Motion) -> None:
    decode = Mvn()
    for k in range(20):
        assert not any(isinstance(f, Rejected) for f in decode(suit(motion, k), "a", k / RATE))
    [found] = decode(suit(motion, 3), "b", 20 / RATE)
    assert isinstance(found, Rejected) and found.reason == "name taken by another device"
    assert len(list(decode(suit(motion, 20), "a", 20 / RATE))) == len(mvn.PLACES)
    assert list(decode(suit(motion, 3), "b", 20 / RATE + mvn.GONE_S)) == []


def test_places_on_the_same_bone() -> None:
    assert mvn.SOURCE.worn is not None
    assert mvn.SOURCE.worn(("left_wrist", "right_pocket", "head")) == {
        "left_forearm": "left_wrist", "right_thigh": "right_pocket", "head": "head"
    }  # fmt: skip
    assert set(mvn.PLACES.values()) <= set(sensors.PLACES)
    assert mvn.SOURCE.bones
