"""DIP's deviations and covariance, fitted (`learned.training.deviations.calibrate`)."""

from __future__ import annotations

import torch
from torch import Tensor

from learned.dip.model import Dip
from learned.training.deviations import both_ways, clip_weights, errors_of, pooled, shrunk
from learned.training.validation import CHUNK, Windowed
from mocap.evaluation.metrics import DIP_JOINTS


def calibrate(model: Dip, windows: Windowed, trained: Windowed | None) -> None:
    """A scale per joint on the network's own deviation (unit variance), the rms error of joints that it does
    not predict, the covariance of all joints' errors."""
    weight = clip_weights(windows.clip)
    model.deviation_scale.fill_(1.0)
    error, spread = _errors(model, windows)
    predicted = torch.zeros(24, dtype=torch.bool)
    predicted[list(DIP_JOINTS)] = True
    rms = (weight[:, None, None] * error.square()).sum(0).sqrt().float()
    model.deviation_rad.copy_(torch.where(predicted[:, None], 0.2, rms.clamp_min(1e-3)))
    z = (weight[:, None, None] * (error / spread).square()).sum(0).mean(-1).sqrt()
    model.deviation_scale.copy_(torch.where(predicted, z.float(), 1.0))
    C = both_ways(error, weight)
    if trained is not None:
        seen, _ = _errors(model, trained)
        C = pooled(C, both_ways(seen, clip_weights(trained.clip)))
    model.error_covariance.copy_(shrunk(C))


def _errors(model: Dip, windows: Windowed) -> tuple[Tensor, Tensor]:
    """Errors (N,24,3) rad and the stated deviations (N,24,3) rad."""
    t = windows.emit
    poses, spread = [], []
    for i in range(0, len(windows.clip), CHUNK):
        part = slice(i, i + CHUNK)
        R, acc = windows.R_world_bone[part], windows.acc_world[part]
        at = model(model.inputs(R, acc)[0])[:, t]
        pose = model.pose(at, R[:, t])
        poses.append(pose)
        spread.append(model.pose_deviation(at, pose))
    return errors_of(torch.cat(poses), windows), torch.cat(spread).double()
