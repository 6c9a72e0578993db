"""IMUPoser's model: network, and what it says of its own errors."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from learned.config import Config
from learned.imuposer import combinations
from learned.imuposer.features import imuposer_input, imuposer_pose
from learned.imuposer.loss import loss
from learned.imuposer.network import BiLSTM
from learned.imuposer.specification import COMBINATIONS
from learned.model import Model
from mocap.skeleton import Skeleton


class Imuposer(Model):
    """IMUPoser's network; its validation errors for each of the 24 combinations: `deviation_rad`
    (24,24,3) rad, joint by joint, `error_covariance` (24,72,72) rad^2, all joints together."""

    deviation_rad: Tensor
    error_covariance: Tensor
    offsets: Tensor

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.net: BiLSTM = BiLSTM(hidden=config.hidden, dropout=config.dropout)
        count = len(COMBINATIONS)
        self.register_buffer("deviation_rad", torch.full((count, 24, 3), 0.3))
        self.register_buffer("error_covariance", 0.09 * torch.eye(72).repeat(count, 1, 1))

        # Bone lengths of the loss: no part of the weights.
        offsets = torch.as_tensor(np.array(Skeleton.default().offsets), dtype=torch.float32)
        self.register_buffer("offsets", offsets, persistent=False)

    def drawn(self, rng: np.random.Generator, there: Tensor) -> Tensor:
        """One of the possible combinations for each window, all alike probable."""
        return combinations.drawn(rng, there)

    def in_turn(self, first: int, there: Tensor) -> Tensor:
        """Of the possible combinations one after the other."""
        return combinations.in_turn(first, there)

    def examples(
        self, R_world_bone: Tensor, acc_world: Tensor, R_parent_joint: Tensor, shown: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Inputs (B,T,60); the true rotations (B,T,24,3,3)."""
        return imuposer_input(R_world_bone, acc_world, shown), R_parent_joint

    def loss(self, out: Tensor, target: Tensor, reconstruct_acc: bool = True) -> Tensor:
        """`learned.imuposer.loss.loss`."""
        return loss(out, target, self.offsets)

    def pose(self, out: Tensor, R_world_bone: Tensor) -> Tensor:
        """Local rotations (...,24,3,3); the root's is predicted too."""
        return imuposer_pose(out)

    @property
    def layers(self) -> tuple[nn.Linear, nn.LSTM]:
        """Dense and LSTM."""
        return self.net.dense, self.net.lstm

    def head(self, features: Tensor) -> Tensor:
        """144 numbers of one frame."""
        out: Tensor = self.net.head(features)
        return out
