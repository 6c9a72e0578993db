"""IMUPoser's training loss."""

from __future__ import annotations

import torch
from torch import Tensor

from learned.imuposer.features import imuposer_pose, imuposer_target
from learned.tree import positions, rotations


def loss(out: Tensor, R_parent_joint: Tensor, offsets: Tensor) -> Tensor:
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
