"""A library user's own SMPL motion: the prior must not pull it into another convention."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import sip
from mocap import Motion, sensors, synthesis
from mocap import orientation as ori
from mocap.formats import amass
from mocap.skeleton import Skeleton

RATE_HZ = 30.0
TRUNK = {"neck": 12, "head": 15, "left collar": 13, "right collar": 14, "chest": 9}


def walking(seconds: float = 3.0) -> Motion:
    """SMPL's rest pose with the arms down and legs and arms that swing; the trunk as in the rest pose."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    swing = 0.4 * np.sin(2 * np.pi * 0.9 * t)
    R = np.tile(np.eye(3), (len(t), 24, 1, 1))
    for hip, knee, shoulder, side in ((1, 4, 16, 1.0), (2, 5, 17, -1.0)):
        R[:, hip] = ori.rot_x(-side * swing)
        R[:, knee] = ori.rot_x(0.3 + 0.3 * np.sin(2 * np.pi * 0.9 * t + side))
        R[:, shoulder] = ori.rot_x(side * swing) @ ori.rot_z(-side * np.deg2rad(75.0))
    p = np.stack([0 * t, 0.95 + 0 * t, 1.1 * t], axis=1)
    return Motion(RATE_HZ, R, p, Skeleton.default())


def test_an_upright_neck_and_level_collars_stay(tmp_path: Path) -> None:
    path = tmp_path / "user_poses.npz"
    amass.write_motion(path, walking())
    truth = amass.read_motion(path)
    recording = synthesis.recording(truth, sensors.SIX)
    found = sip.solve(recording, settings=sip.Settings(solver="banded")).motion
    apart = np.rad2deg(ori.angle_between(found.R_world_joint, truth.R_world_joint)).mean(axis=0)
    for name, joint in TRUNK.items():
        assert apart[joint] < 10, name
    assert apart[[1, 2, 4, 5, 16, 17, 18, 19]].mean() < 10


@pytest.mark.parametrize("joint", TRUNK.values(), ids=TRUNK)
def test_the_priors_mean_is_near_the_rest_pose_in_the_trunk(joint: int) -> None:
    mean = sip.Settings().prior.mean.reshape(23, 3)[joint - 1]
    assert np.rad2deg(np.linalg.norm(mean)) < 15
