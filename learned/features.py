"""What the networks' inputs and outputs have in common: scaling, and rotations of predicted matrices."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

DEVIATION_FLOOR = 1e-4
"""Least standard deviation of the scaler: a constant channel must not blow up."""


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


def project(M: Tensor) -> Tensor:
    """The rotations nearest to matrices (...,3,3) in the Frobenius norm (SVD, det +1)."""
    U, _, Vh = torch.linalg.svd(M)
    flip = torch.ones_like(M[..., 0])
    flip[..., 2] = torch.det(U @ Vh).sign()
    return (U * flip.unsqueeze(-2)) @ Vh
