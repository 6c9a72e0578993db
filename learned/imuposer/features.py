"""What IMUPoser reads and writes (Mollyn et al. 2023, 4.1 and 4.2).

Five places in the global frame, [15 acceleration, 45 orientation], places without a device zero (4.1);
accelerations smoothed over 5 frames and divided by 30 (4.2).
"""

from __future__ import annotations

import torch
from torch import Tensor

from learned.tree import from_6d, to_6d

ACC_SCALE = 30.0  # m/s^2, divisor of accelerations (4.2)
ACC_WINDOW = 5  # frames of the mean over accelerations (4.2); centred: ours


def smooth(acc: Tensor, window: int = ACC_WINDOW) -> Tensor:
    """Centred mean over `window` frames of acc (...,T,S,3); at both ends over the frames there are."""
    T, half = acc.shape[-3], window // 2
    total = torch.cat([torch.zeros_like(acc[..., :1, :, :]), acc.cumsum(-3)], -3)
    t = torch.arange(T, device=acc.device)
    low, high = (t - half).clamp_min(0), (t + half + 1).clamp_max(T)
    span = (total.index_select(-3, high) - total.index_select(-3, low)).movedim(-3, 0)
    mean = span / (high - low).to(acc.dtype).reshape(-1, *[1] * (span.ndim - 1))
    return mean.movedim(0, -3)


def imuposer_input(R_world_bone: Tensor, acc_world: Tensor, worn: Tensor) -> Tensor:
    """IMUPoser's input (...,T,60) of five places (...,T,5,3,3), (...,T,5,3); worn (...,T,5) or (...,5).

    Accelerations are smoothed (`smooth`) before the places that are not worn are blanked, and what these
    hold, NaN too, has no influence.
    """
    mask = worn if worn.shape[:-1] == acc_world.shape[:-2] else worn.unsqueeze(-2)
    mask = mask.expand(acc_world.shape[:-1]).unsqueeze(-1)
    # A device that comes or goes within the mean's frames counts by the frames it was worn.
    share = smooth(mask.to(acc_world.dtype)).clamp_min(1e-6)
    acc = smooth(torch.where(mask, acc_world, 0.0)) / share / ACC_SCALE
    acc = torch.where(mask, acc, 0.0)
    R = torch.where(mask, R_world_bone.flatten(-2), 0.0)
    return torch.cat([acc.flatten(-2), R.flatten(-2)], -1)


def imuposer_target(R_parent_joint: Tensor) -> Tensor:
    """24 joints x 6D of local rotations (root: global): (...,144) of (...,24,3,3)."""
    return to_6d(R_parent_joint).flatten(-2)


def imuposer_pose(prediction: Tensor) -> Tensor:
    """Local rotations (...,24,3,3) of IMUPoser's 144 numbers; the inverse of `imuposer_target`."""
    return from_6d(prediction.unflatten(-1, (24, 6)))
