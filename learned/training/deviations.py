"""What a network says of its own errors, fitted to the errors that it makes (design, hybrid.md)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from learned.devices import possible
from learned.features import COMBINATIONS, DIP_JOINTS
from learned.models import Dip, Model
from learned.training.validation import CHUNK, Windowed, imuposer_poses
from mocap import orientation as ori
from mocap.skeleton import MIRROR

SHRINK = 0.1  # of a covariance towards its diagonal: it is estimated from few clips
# Joints that the network holds fixed have errors too small to invert.
LEAST_RAD = float(np.deg2rad(1.0))
_MIRRORED = (1, 0, 3, 2, 4)  # places of `five` with left and right exchanged


def calibrate(model: Model, windows: Windowed, trained: Windowed | None = None) -> None:
    """Fit what the model says of its own errors to its errors on this set (hybrid.md).

    Errors are Log(R_estimated^T R_true); every clip counts the same. DIP: a scale per joint on the network's
    own deviation (unit variance), the rms error of joints that it does not predict, the covariance of all
    joints' errors. IMUPoser: deviations and covariance per combination; of one that is in no window, nor its
    mirror image, they stay as they were. Left and right are taken for mirror images of each other.

    trained: windows of motion that the network has learnt from. Validation people are few, and how errors of
    joints lean against each other differs from person to person: half of a covariance is then that of these
    windows, scaled to the trace of the other half, since on what was learnt errors are less.
    """
    model.eval()
    with torch.inference_mode(False), torch.no_grad():
        weight = clip_weights(windows.clip)
        if isinstance(model, Dip):
            model.deviation_scale.fill_(1.0)
            error, spread = _dip_errors(model, windows)
            predicted = torch.zeros(24, dtype=torch.bool)
            predicted[list(DIP_JOINTS)] = True
            rms = (weight[:, None, None] * error.square()).sum(0).sqrt().float()
            model.deviation_rad.copy_(torch.where(predicted[:, None], 0.2, rms.clamp_min(1e-3)))
            z = (weight[:, None, None] * (error / spread).square()).sum(0).mean(-1).sqrt()
            model.deviation_scale.copy_(torch.where(predicted, z.float(), 1.0))
            C = _both_ways(error, weight)
            if trained is not None:
                seen, _ = _dip_errors(model, trained)
                C = pooled(C, _both_ways(seen, clip_weights(trained.clip)))
            model.error_covariance.copy_(shrunk(C))
            return
        found = imuposer_covariances(model, windows)
        other = {} if trained is None else imuposer_covariances(model, trained)
        for k, C in found.items():
            model.deviation_rad[k].copy_(shrunk(C).diagonal().sqrt().reshape(24, 3))
            model.error_covariance[k].copy_(shrunk(pooled(C, other[k]) if k in other else C))


def _both_ways(error: Tensor, weight: Tensor) -> Tensor:
    return (covariance(error, weight) + covariance(mirrored(error), weight)) / 2


def imuposer_covariances(model: Model, windows: Windowed) -> dict[int, Tensor]:
    """(72,72) of each combination that windows hold, itself or mirrored: the mean of its own and that of its
    mirror image's mirror image."""
    own, twin = {}, {}
    may = possible(windows.there)
    for k, c in enumerate(COMBINATIONS):
        if may[:, k].any():
            some = windows.only(may[:, k])
            error, weight = _errors(imuposer_poses(model, some, c), some), clip_weights(some.clip)
            own[k] = covariance(error, weight)
            mirror = COMBINATIONS.index(tuple(sorted(_MIRRORED[p] for p in c)))
            twin[mirror] = covariance(mirrored(error), weight)
    both = [[C[k] for C in (own, twin) if k in C] for k in range(len(COMBINATIONS))]
    return {k: torch.stack(C).mean(0) for k, C in enumerate(both) if C}


def pooled(C: Tensor, other: Tensor) -> Tensor:
    """The mean of two covariances, the other one scaled to the trace of the first."""
    return (C + other * (C.trace() / other.trace().clamp_min(1e-12))) / 2


def clip_weights(clip: np.ndarray) -> Tensor:
    """(N,), sum 1: every clip counts the same, whatever its length."""
    _, which, count = np.unique(clip, return_inverse=True, return_counts=True)
    return torch.as_tensor(1.0 / count[which] / len(count))


def covariance(error: Tensor, weight: Tensor) -> Tensor:
    """(72,72) rad^2: the weighted second moment of errors (N,24,3) rad; zero is the mean they should have."""
    e = error.reshape(len(error), -1).double()
    return (weight[:, None] * e).T @ e


def mirrored(error: Tensor) -> Tensor:
    """Rotation vectors (N,24,3) of the body's mirror image (reflection in the plane x = 0)."""
    return error[:, list(MIRROR)] * torch.tensor([1.0, -1.0, -1.0], dtype=error.dtype)


def shrunk(C: Tensor) -> Tensor:
    """(1 - SHRINK) C + SHRINK diag(C), diagonal entries at least `LEAST_RAD`^2: well conditioned."""
    own = C.diagonal()
    return (1 - SHRINK) * C + torch.diag(SHRINK * own + (LEAST_RAD**2 - own).clamp_min(0))


def _dip_errors(model: Dip, windows: Windowed) -> tuple[Tensor, Tensor]:
    """Errors (N,24,3) rad and the stated deviations (N,24,3) rad."""
    t = windows.emit
    poses, spread = [], []
    for i in range(0, len(windows.clip), CHUNK):
        part = slice(i, i + CHUNK)
        R, acc = windows.R_world_bone[part], windows.acc_world[part]
        out = model(model.inputs(R, acc)[0])
        at = out.at(t)
        pose = model.pose(at, R[:, t, 5])
        poses.append(pose)
        spread.append(model.pose_deviation(at, pose))
    return _errors(torch.cat(poses), windows), torch.cat(spread).double()


def _errors(poses: Tensor, windows: Windowed) -> Tensor:
    """Log(R_estimated^T R_true) (N,24,3) rad of the emitted frames."""
    truth = windows.R_parent_joint[:, windows.emit].double()
    return torch.as_tensor(ori.log((poses.double().mT @ truth).numpy()))
