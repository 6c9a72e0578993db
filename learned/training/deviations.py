"""What a network says of its own errors, fitted to the errors that it makes."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from learned.model import Model
from learned.spec import named
from learned.training.validation import Windowed
from mocap import orientation as ori
from mocap.skeleton import MIRROR

SHRINK = 0.1  # of a covariance towards its diagonal: it is estimated from few clips
# Joints that the network holds fixed have errors too small to invert.
LEAST_RAD = float(np.deg2rad(1.0))


def calibrate(model: Model, windows: Windowed, trained: Windowed | None = None) -> None:
    """Fit what the model says of its own errors to its errors on this set.

    Errors are Log(R_estimated^T R_true); every clip counts the same. What is fitted is the network's own
    (`learned.dip.deviations`, `learned.imuposer.deviations`). Left and right are taken for mirror images of
    each other.

    trained: windows of motion that the network has learnt from. Validation people are few, and how errors of
    joints lean against each other differs from person to person: half of a covariance is then that of these
    windows, scaled to the trace of the other half, since on what was learnt errors are less.
    """
    model.eval()
    with torch.inference_mode(False), torch.no_grad():
        named(model.config.specification.deviations)(model, windows, trained)


def both_ways(error: Tensor, weight: Tensor) -> Tensor:
    """`covariance` of the errors and of their mirror images."""
    return (covariance(error, weight) + covariance(mirrored(error), weight)) / 2


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


def errors_of(poses: Tensor, windows: Windowed) -> Tensor:
    """Log(R_estimated^T R_true) (N,24,3) rad of the emitted frames."""
    truth = windows.R_parent_joint[:, windows.emit].double()
    return torch.as_tensor(ori.log((poses.double().mT @ truth).numpy()))
