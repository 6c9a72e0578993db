"""What DIP reads and writes (Huang et al. 2018, 4.3 and appendix C).

Five sensors relative to the pelvis sensor, R'_s = R_root^T R_s (eq. 9) and a'_s = R_root^T (a_s - a_root)
(eq. 10), flattened row-major to [45 orientation, 15 acceleration], then zero-mean unit-variance over the
training set.
"""

from __future__ import annotations

import torch
from torch import Tensor

from learned.config import Normalisation
from learned.features import project
from learned.tree import rot_y
from mocap.evaluation.metrics import DIP_JOINTS


def dip_input(
    R_world_bone: Tensor, acc_world: Tensor, normalisation: Normalisation = "root"
) -> Tensor:
    """DIP's input before scaling, of six sensors (...,T,6,3,3) and (...,T,6,3), pelvis last.

    "root": (...,T,60), eq. 9 and 10. "first": relative to the pelvis orientation of the window's first
    frame, all six sensors (...,T,72). "heading": relative to the pelvis sensor's heading, its yaw alone
    removed (...,T,72) (appendix C).
    """
    if normalisation == "root":
        R_root = R_world_bone[..., 5, :, :].transpose(-1, -2).unsqueeze(-3)
        R = R_root @ R_world_bone[..., :5, :, :]
        a = R_root @ (acc_world[..., :5, :] - acc_world[..., 5:, :]).unsqueeze(-1)
    else:
        if normalisation == "first":
            R_frame = R_world_bone[..., :1, 5, :, :].transpose(-1, -2).unsqueeze(-3)
        else:
            M = R_world_bone[..., 5, :, :]
            yaw = torch.atan2(M[..., 0, 2] - M[..., 2, 0], M[..., 0, 0] + M[..., 2, 2])
            R_frame = rot_y(-yaw).unsqueeze(-3)
        R = R_frame @ R_world_bone
        relative = torch.cat(
            [acc_world[..., :5, :] - acc_world[..., 5:, :], acc_world[..., 5:, :]], -2
        )
        a = R_frame @ relative.unsqueeze(-1)
    return torch.cat([R.flatten(-3), a.flatten(-3)], -1)


def dip_target(R_parent_joint: Tensor) -> Tensor:
    """Local rotation matrices of `DIP_JOINTS`, flattened row-major: (...,135) of (...,24,3,3)."""
    return R_parent_joint[..., list(DIP_JOINTS), :, :].flatten(-3)


def dip_pose(prediction: Tensor, R_world_root: Tensor) -> Tensor:
    """Local rotations (...,24,3,3) of DIP's 135 numbers and the pelvis sensor's rotation (...,3,3).

    Each predicted matrix is replaced by the rotation nearest to it (SVD).
    """
    R = torch.eye(3, dtype=prediction.dtype, device=prediction.device)
    R = R.expand(*prediction.shape[:-1], 24, 3, 3).clone()
    R[..., list(DIP_JOINTS), :, :] = project(prediction.unflatten(-1, (15, 3, 3)))
    R[..., 0, :, :] = R_world_root
    return R
