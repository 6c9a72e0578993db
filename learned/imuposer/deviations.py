"""IMUPoser's deviations and covariances, fitted (`learned.training.deviations.calibrate`)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from learned.imuposer.combinations import possible
from learned.imuposer.features import imuposer_input, imuposer_pose
from learned.imuposer.model import Imuposer
from learned.imuposer.specification import COMBINATIONS
from learned.model import Model
from learned.training.deviations import (
    clip_weights,
    covariance,
    errors_of,
    mirrored,
    pooled,
    shrunk,
)
from learned.training.validation import CHUNK, Windowed

_MIRRORED = (1, 0, 3, 2, 4)  # places of `five` with left and right exchanged


def calibrate(model: Imuposer, windows: Windowed, trained: Windowed | None) -> None:
    """Deviations and covariance per combination; of one that is in no window, nor its mirror image, they stay
    as they were."""
    found = imuposer_covariances(model, windows)
    other = {} if trained is None else imuposer_covariances(model, trained)
    for k, C in found.items():
        model.deviation_rad[k].copy_(shrunk(C).diagonal().sqrt().reshape(24, 3))
        model.error_covariance[k].copy_(shrunk(pooled(C, other[k]) if k in other else C))


def imuposer_covariances(model: Model, windows: Windowed) -> dict[int, Tensor]:
    """(72,72) of each combination that windows hold, itself or mirrored: the mean of its own and that of its
    mirror image's mirror image."""
    own, twin = {}, {}
    may = possible(windows.there)
    for k, c in enumerate(COMBINATIONS):
        if may[:, k].any():
            some = windows.only(may[:, k])
            error, weight = errors_of(imuposer_poses(model, some, c), some), clip_weights(some.clip)
            own[k] = covariance(error, weight)
            mirror = COMBINATIONS.index(tuple(sorted(_MIRRORED[p] for p in c)))
            twin[mirror] = covariance(mirrored(error), weight)
    both = [[C[k] for C in (own, twin) if k in C] for k in range(len(COMBINATIONS))]
    return {k: torch.stack(C).mean(0) for k, C in enumerate(both) if C}


def imuposer_poses(model: Model, windows: Windowed, combination: Sequence[int]) -> Tensor:
    """Local rotations (N,24,3,3) of the emitted frames with these devices worn."""
    worn = torch.zeros(5, dtype=torch.bool)
    worn[list(combination)] = True
    poses = []
    for i in range(0, len(windows.clip), CHUNK):
        R, acc = windows.R_world_bone[i : i + CHUNK], windows.acc_world[i : i + CHUNK]
        x = imuposer_input(R, acc, worn.expand(len(R), 5))
        poses.append(imuposer_pose(model(x)[:, windows.emit]))
    return torch.cat(poses)
