"""DIP's training loss."""

from __future__ import annotations

import torch
from torch import Tensor

from learned.dip.network import Gaussian


def negative_log_likelihood(x: Tensor, mean: Tensor, deviation: Tensor) -> Tensor:
    """-log N(x; mean, diag(deviation^2)) without its constant: summed over numbers, mean over frames."""
    z = (x - mean) / deviation
    return (0.5 * z * z + torch.log(deviation)).sum(-1).mean()


def loss(out: Gaussian, pose: Tensor, acc: Tensor, reconstruct_acc: bool = True) -> Tensor:
    """DIP's loss (3.4): eq. 4 (pose) + eq. 5 (reconstruction of the input accelerations), scaled units."""
    total = negative_log_likelihood(pose, out.pose, out.pose_deviation)
    if reconstruct_acc:
        total = total + negative_log_likelihood(acc, out.acc, out.acc_deviation)
    return total
