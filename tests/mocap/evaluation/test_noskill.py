"""The rows that need no skill: exact where the truth is in the bank, blind to the world's heading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.errors import ShapeError
from mocap.evaluation.metrics import evaluate
from mocap.evaluation.noskill import mean_pose, nearest_pose
from mocap.motion import Motion
from mocap.sensors import FIVE, SIX
from mocap.skeleton import Skeleton
from mocap.synthesis import recording


@pytest.fixture
def bank(rng):
    """60 random poses whose joints without any effect on the sensors are still."""
    poses = 0.6 * rng.normal(size=(60, 23, 3))
    poses[:, np.array([7, 8, 10, 11, 20, 21, 22, 23]) - 1] = 0
    return poses.reshape(60, 69)


@pytest.fixture
def motion(rng, bank):
    R = np.tile(np.eye(3), (60, 24, 1, 1))
    R[:, 1:] = ori.exp(bank.reshape(60, 23, 3))
    R[:, 0] = ori.exp(rng.normal(size=(60, 3)))
    return Motion(60.0, R, np.zeros((60, 3)), Skeleton.default())


@pytest.mark.parametrize("sensors", [SIX, FIVE], ids=["six", "five"])
def test_nearest_finds_the_truth_in_the_bank(motion, bank, sensors):
    rec = recording(motion, sensors)
    order = np.random.default_rng(1).permutation(60)
    found = nearest_pose(rec, bank[order])
    inner = evaluate(found.slice(1, 59), motion.slice(1, 59))
    assert inner.global_deg == pytest.approx(0, abs=1e-4)


def test_a_turned_world_turns_the_answer(motion, bank):
    rec = recording(motion, SIX)
    a, b = nearest_pose(rec, bank[::3]), nearest_pose(rec.turned(1.0), bank[::3])
    assert np.allclose(a.turned(1.0).R_parent_joint, b.R_parent_joint)


def test_mean_pose_takes_its_root_from_the_pelvis(motion):
    rec = recording(motion, SIX)
    found = mean_pose(rec, np.zeros(69))
    assert np.allclose(found.R_parent_joint[1:-1, 0], motion.R_parent_joint[1:-1, 0])
    assert np.allclose(found.R_parent_joint[:, 1:], np.eye(3))


def test_lost_samples_hold_the_neighbour(motion, bank):
    rec = recording(motion, SIX)
    valid = np.array(rec.valid)
    valid[10:13] = False
    found = nearest_pose(replace(rec, valid=valid), bank)
    assert np.allclose(found.R_parent_joint[12], found.R_parent_joint[9])


def test_one_sensor_and_none_valid(motion, bank):
    rec = recording(motion, ("head",))
    assert len(nearest_pose(rec, bank)) == 60
    blind = replace(rec, valid=np.zeros_like(rec.valid))
    assert len(nearest_pose(blind, bank)) == 60


def test_shape_of_the_bank(motion):
    with pytest.raises(ShapeError, match="69"):
        nearest_pose(recording(motion), np.zeros((3, 72)))
