"""Ten Adam steps against autograd and torch's own Adam."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch

from learned import kinematics as kin
from learned.imuposer.adam import CHAINS, AdamEstimator, AdamSettings, refine
from mocap import Skeleton
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.estimator import Pose, Sample
from mocap.orientation import Array

JOINTS = [(18,), (18, 19, 15), (1, 2, 15), (2, 19)]


def by_torch(R0: Array, joints: tuple[int, ...], measured: Array, settings: AdamSettings) -> Array:
    """The same steps by autograd through the whole tree, and torch.optim.Adam."""
    R = torch.tensor(R0)
    M = torch.tensor(measured)
    moving = [j for joint in joints for j in CHAINS[joint]]
    d = torch.zeros(len(moving), 3, dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([d], lr=settings.learning_rate)
    for _ in range(settings.steps):
        turned = [R[j] @ kin.exp(d[moving.index(j)]) if j in moving else R[j] for j in range(24)]
        found = kin.rotations(torch.stack(turned))[list(joints)]
        adam.zero_grad()
        torch.mean((found - M) ** 2).backward()
        adam.step()
        with torch.no_grad():
            for k, j in enumerate(moving):
                R[j] = R[j] @ torch.tensor(ori.exp(d[k].numpy()))
            d.zero_()  # the next step starts where this one ended
    return R.numpy()


@pytest.mark.parametrize("joints", JOINTS)
def test_the_steps_are_adams(joints: tuple[int, ...], rng: np.random.Generator) -> None:
    R = ori.exp(rng.normal(size=(24, 3)))
    measured = ori.exp(rng.normal(size=(len(joints), 3)))
    settings = AdamSettings(learning_rate=0.07)
    np.testing.assert_allclose(
        refine(R, joints, measured, settings), by_torch(R, joints, measured, settings), atol=1e-9
    )


def test_it_moves_towards_what_was_measured_and_leaves_other_joints(
    rng: np.random.Generator,
) -> None:
    body = Skeleton.default()
    for joints in JOINTS:
        R = ori.exp(0.5 * rng.normal(size=(24, 3)))
        wrong = ori.exp(np.deg2rad(20) * np.eye(3)[rng.integers(3, size=len(joints))])
        measured = body.rotations(R)[list(joints)] @ wrong
        out = refine(R, joints, measured, AdamSettings())
        after = ori.angle_between(body.rotations(out)[list(joints)], measured)
        assert (after < np.deg2rad(10)).all()
        still = [j for j in range(24) if j not in {k for j in joints for k in CHAINS[j]}]
        assert np.array_equal(out[still], R[still])


def test_a_pose_that_agrees_stays(rng: np.random.Generator) -> None:
    R = ori.exp(rng.normal(size=(24, 3)))
    measured = Skeleton.default().rotations(R)[[18, 1]]
    # Adam divides by the gradient's own size: rounding alone would move a full step, were epsilon not there.
    out = refine(R, (18, 1), measured, AdamSettings())
    assert ori.angle_between(R, out).max() < 1e-3
    assert np.array_equal(refine(R, (), measured[:0], AdamSettings()), R)
    assert np.array_equal(refine(R, (18,), measured[:1], AdamSettings(steps=0)), R)


class Late:
    """The rest pose, two samples late."""

    rate_hz, sensors, look_ahead_frames = 25.0, ("left_wrist", "head"), 2

    def init(self) -> tuple[float, ...]:
        return ()

    def step(self, state: tuple[float, ...], s: Sample) -> tuple[tuple[float, ...], Pose | None]:
        state = (*state, s.time_s)[-3:]
        if len(state) < 3:
            return state, None
        return state, Pose(state[0], np.tile(np.eye(3), (24, 1, 1)), np.zeros(3))


def test_poses_meet_the_samples_of_their_time(rng: np.random.Generator) -> None:
    estimator = AdamEstimator(Late(), (18, 15))
    state = estimator.init()
    R = ori.exp(0.3 * rng.normal(size=(12, 2, 3)))
    R[5, 1] = np.nan
    valid = np.ones((12, 2), bool)
    valid[7, 0] = False
    for t in range(12):
        state, pose = estimator.step(state, Sample(t / 25, R[t], np.zeros((2, 3)), valid[t]))
        state = pickle.loads(pickle.dumps(state))
        if pose is None:
            assert t < 2
            continue
        k = t - 2
        assert pose.time_s == k / 25
        use = [s for s in range(2) if (k, s) not in ((5, 1), (7, 0))]
        joints = tuple((18, 15)[s] for s in use)
        want = refine(np.tile(np.eye(3), (24, 1, 1)), joints, R[k, use], AdamSettings())
        assert np.array_equal(pose.R_parent_joint, want)


def test_what_cannot_be() -> None:
    with pytest.raises(PoserError, match="head"):
        AdamEstimator(Late(), (18, 9))
    with pytest.raises(PoserError, match=r"one sensor a bone, not left_wrist \(left_elbow\), head"):
        AdamEstimator(Late(), (18, 18))
    with pytest.raises(PoserError, match="rate"):
        AdamSettings(learning_rate=0.0)
