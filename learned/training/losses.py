"""The papers' training losses."""

from __future__ import annotations

import torch
from torch import Tensor

from learned.dip.network import Gaussian
from learned.features import imuposer_pose, imuposer_target
from learned.kinematics import positions, rotations


def negative_log_likelihood(x: Tensor, mean: Tensor, deviation: Tensor) -> Tensor:
    """-log N(x; mean, diag(deviation^2)) without its constant: summed over numbers, mean over frames."""
    z = (x - mean) / deviation
    return (0.5 * z * z + torch.log(deviation)).sum(-1).mean()


def dip(out: Gaussian, pose: Tensor, acc: Tensor, reconstruct_acc: bool = True) -> Tensor:
    """DIP's loss (3.4): eq. 4 (pose) + eq. 5 (reconstruction of the input accelerations), scaled units."""
    loss = negative_log_likelihood(pose, out.pose, out.pose_deviation)
    if reconstruct_acc:
        loss = loss + negative_log_likelihood(acc, out.acc, out.acc_deviation)
    return loss


def imuposer(out: Tensor, R_parent_joint: Tensor, offsets: Tensor) -> Tensor:
    """IMUPoser's loss (4.3): MSE of the 6D pose + MSE of joint positions (m, root at the origin), these by
    forward kinematics (4.1).

    out (B,T,144); R_parent_joint (B,T,24,3,3); offsets (24,3) m.
    """
    pose = torch.mean((out - imuposer_target(R_parent_joint)) ** 2)
    root = torch.zeros(3, dtype=out.dtype, device=out.device)
    with torch.no_grad():
        p_true = positions(rotations(R_parent_joint), root, offsets)
    p = positions(rotations(imuposer_pose(out)), root, offsets)
    return pose + torch.mean((p - p_true) ** 2)
