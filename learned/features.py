"""What the networks read and write: the only normalisation in the project, both ways.

DIP (Huang et al. 2018, 4.3 and appendix C): five sensors relative to the pelvis sensor,
R'_s = R_root^T R_s (eq. 9) and a'_s = R_root^T (a_s - a_root) (eq. 10), flattened row-major to
[45 orientation, 15 acceleration], then zero-mean unit-variance over the training set.

IMUPoser (Mollyn et al. 2023): five places in the global frame, [15 acceleration, 45 orientation], places
without a device zero (4.1); accelerations smoothed over 5 frames and divided by 30 (4.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from learned.kinematics import from_6d, rot_y, to_6d
from mocap.evaluation.metrics import DIP_JOINTS

Normalisation = Literal["root", "first", "heading"]

DEVIATION_FLOOR = 1e-4
"""Least standard deviation of the scaler: a constant channel must not blow up."""

ACC_SCALE = 30.0  # m/s^2, IMUPoser's divisor of accelerations (4.2)
ACC_WINDOW = 5  # frames of the mean over IMUPoser's accelerations (4.2); centred: ours

COMBINATIONS: tuple[tuple[int, ...], ...] = tuple(
    c
    for c in (
        (0,), (1,), (2,), (3,), (4,),
        (0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4),
        (0, 1, 2), (0, 1, 3), (0, 1, 4), (0, 2, 3), (0, 2, 4), (0, 3, 4), (1, 2, 3), (1, 2, 4),
        (1, 3, 4),
    )
)  # fmt: skip
"""IMUPoser's 24 device combinations (its Fig. 3), as indices into `mocap.sensors.FIVE`: all subsets of
one to three places except both pockets with the head."""


@dataclass(frozen=True)
class Scaler:
    """x -> (x - mean) / deviation and back, over the last axis."""

    mean: Tensor
    deviation: Tensor

    @classmethod
    def fit(cls, x: Tensor) -> Scaler:
        """Over all rows of x (...,D); deviations below `DEVIATION_FLOOR` are floored."""
        rows = x.reshape(-1, x.shape[-1]).double()
        mean, dev = rows.mean(0), rows.std(0).clamp_min(DEVIATION_FLOOR)
        return cls(mean.float(), dev.float())

    def scale(self, x: Tensor) -> Tensor:
        """To zero mean and unit variance."""
        return (x - self.mean) / self.deviation

    def unscale(self, x: Tensor) -> Tensor:
        """The inverse of `scale`."""
        return x * self.deviation + self.mean

    def to(self, device: torch.device | str) -> Scaler:
        """On another device."""
        return Scaler(self.mean.to(device), self.deviation.to(device))


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


def project(M: Tensor) -> Tensor:
    """The rotations nearest to matrices (...,3,3) in the Frobenius norm (SVD, det +1)."""
    U, _, Vh = torch.linalg.svd(M)
    flip = torch.ones_like(M[..., 0])
    flip[..., 2] = torch.det(U @ Vh).sign()
    return (U * flip.unsqueeze(-2)) @ Vh


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
