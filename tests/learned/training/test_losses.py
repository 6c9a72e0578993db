"""The papers' losses against torch.distributions and closed forms."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.distributions import Normal

from learned.dip.network import Gaussian
from learned.features import imuposer_target
from learned.training import losses
from mocap import orientation as ori
from mocap.skeleton import PARENTS, Skeleton

OFFSETS = torch.as_tensor(np.array(Skeleton.default().offsets), dtype=torch.float64)


def gaussian(batch: int = 3, frames: int = 4) -> Gaussian:
    def draw(n: int) -> torch.Tensor:
        return torch.randn(batch, frames, n, dtype=torch.float64)

    return Gaussian(draw(135), draw(135).exp(), draw(15), draw(15).exp())


def test_likelihood_is_the_normal_density_without_its_constant() -> None:
    torch.manual_seed(0)
    out, x = gaussian(), torch.randn(3, 4, 135, dtype=torch.float64)
    density = Normal(out.pose, out.pose_deviation).log_prob(x).sum(-1).mean()
    found = losses.negative_log_likelihood(x, out.pose, out.pose_deviation)
    constant = 135 * 0.5 * math.log(2 * math.pi)
    torch.testing.assert_close(found + constant, -density, rtol=0, atol=1e-10)


def test_reconstruction_of_accelerations_is_added_or_not() -> None:
    torch.manual_seed(1)
    out = gaussian()
    pose, acc = torch.randn(3, 4, 135).double(), torch.randn(3, 4, 15).double()
    with_acc, without = losses.dip(out, pose, acc), losses.dip(out, pose, acc, False)
    density = Normal(out.acc, out.acc_deviation).log_prob(acc).sum(-1).mean()
    constant = 15 * 0.5 * math.log(2 * math.pi)
    torch.testing.assert_close(with_acc - without + constant, -density, rtol=0, atol=1e-10)


def test_without_reconstruction_the_acceleration_heads_get_no_gradient() -> None:
    out = gaussian()
    out.pose.requires_grad_(True)
    out.acc.requires_grad_(True)
    losses.dip(out, torch.zeros(3, 4, 135), torch.zeros(3, 4, 15), False).backward()
    assert out.pose.grad is not None and out.acc.grad is None


def test_imuposer_is_zero_at_the_truth(rng: np.random.Generator) -> None:
    R = torch.as_tensor(ori.exp(rng.normal(size=(2, 3, 24, 3))))
    assert float(losses.imuposer(imuposer_target(R), R, OFFSETS)) < 1e-24


def test_imuposer_of_one_joint_turned() -> None:
    """The left elbow turned by a about z from the rest pose: both terms in closed form.

    Pose: two columns of that joint move by |col - col'|^2 = 2 - 2 cos a each (both lie in the xy plane).
    Positions: wrist and hand move on circles, chord 2 sin(a/2) times their distance from the axis.
    """
    a, elbow = 0.4, 18
    R = torch.eye(3, dtype=torch.float64).expand(1, 1, 24, 3, 3)
    guess = R.clone()
    guess[0, 0, elbow] = torch.as_tensor(ori.rot_z(a))
    pose = 2 * (2 - 2 * math.cos(a)) / 144
    wrist = OFFSETS[20].numpy()
    hand = wrist + OFFSETS[22].numpy()
    assert PARENTS[20] == elbow and PARENTS[22] == 20
    moved = sum((2 * math.sin(a / 2)) ** 2 * (v[0] ** 2 + v[1] ** 2) for v in (wrist, hand))
    found = losses.imuposer(imuposer_target(guess), R, OFFSETS)
    assert math.isclose(float(found), pose + moved / (24 * 3), rel_tol=1e-9)
