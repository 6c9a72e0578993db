"""DIP's model: network, scalers, and what it says of its own errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from learned.config import Config
from learned.dip.features import dip_input, dip_pose, dip_target
from learned.dip.loss import loss
from learned.dip.network import ACC, POSE, BiRNN, FeedForward, Gaussian, WaveNet
from learned.features import Scaler
from learned.model import Model
from mocap.errors import ShapeError
from mocap.evaluation.metrics import DIP_JOINTS

if TYPE_CHECKING:
    from learned.training.virtual_windows import Batch

SCALER_BATCHES = 40  # of 64 windows, that the scalers are fitted to


class Dip(Model):
    """DIP's network with its scalers; deviations: see `pose_deviation`."""

    in_mean: Tensor
    in_deviation: Tensor
    out_mean: Tensor
    out_deviation: Tensor
    deviation_scale: Tensor
    deviation_rad: Tensor
    error_covariance: Tensor

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        sensors = 5 if config.normalisation == "root" else 6
        self.n_orientation = 9 * sensors
        inputs = self.n_orientation + (3 * sensors if config.use_acc else 0)
        if config.architecture in ("birnn", "rnn"):
            directions = 2 if config.architecture == "birnn" else 1
            self.net = BiRNN(inputs, config.hidden, config.dropout, directions)
        elif config.architecture == "feedforward":
            self.net = FeedForward(inputs, config.dropout)
        else:
            self.net = WaveNet(inputs, dropout=config.dropout)
        width = self.n_orientation + 3 * sensors
        for name, size in (("in", width), ("out", POSE)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_deviation", torch.ones(size))
        # Joint by joint, what the network's own deviations are multiplied with so that validation errors
        # have unit variance; and the deviation of joints that it does not predict.
        self.register_buffer("deviation_scale", torch.ones(24))
        self.register_buffer("deviation_rad", torch.full((24, 3), 0.2))
        # Of all joints' errors together (72,72) rad^2: `learned.training.deviations.calibrate`.
        self.register_buffer("error_covariance", 0.04 * torch.eye(72))

    @property
    def input_scaler(self) -> Scaler:
        return Scaler(self.in_mean, self.in_deviation)

    @property
    def output_scaler(self) -> Scaler:
        return Scaler(self.out_mean, self.out_deviation)

    def fit_scalers(self, R_world_bone: Tensor, acc_world: Tensor, R_parent_joint: Tensor) -> None:
        """Zero mean, unit variance of inputs and targets over these windows (appendix C)."""
        x = dip_input(R_world_bone, acc_world, self.config.normalisation)
        for name, scaler in (
            ("in", Scaler.fit(x)),
            ("out", Scaler.fit(dip_target(R_parent_joint))),
        ):
            getattr(self, f"{name}_mean").copy_(scaler.mean)
            getattr(self, f"{name}_deviation").copy_(scaler.deviation)

    def inputs(self, R_world_bone: Tensor, acc_world: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled input (B,T,D) and the scaled accelerations (B,T,15) that it is asked to reconstruct."""
        x = dip_input(R_world_bone, acc_world, self.config.normalisation)
        x = self.input_scaler.scale(x)
        acc = x[..., self.n_orientation : self.n_orientation + ACC]
        return (x if self.config.use_acc else x[..., : self.n_orientation]), acc

    def fit(self, draw: Callable[[int], Batch]) -> None:
        """The scalers."""
        batches = [draw(64) for _ in range(SCALER_BATCHES)]
        self.fit_scalers(
            torch.cat([b.R_world_bone for b in batches]),
            torch.cat([b.acc_world for b in batches]),
            torch.cat([b.R_parent_joint for b in batches]),
        )

    def untaught(self, reconstruct_acc: bool) -> list[nn.Module]:
        """Layers that the loss does not depend on."""
        found: list[nn.Module] = self.net.untaught(reconstruct_acc)  # type: ignore[operator]
        return found

    def examples(
        self, R_world_bone: Tensor, acc_world: Tensor, R_parent_joint: Tensor, shown: Tensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Inputs (B,T,D); targets (B,T,135) and (B,T,15), scaled."""
        x, acc = self.inputs(R_world_bone, acc_world)
        return x, (self.output_scaler.scale(dip_target(R_parent_joint)), acc)

    def loss(
        self, out: Gaussian, target: tuple[Tensor, Tensor], reconstruct_acc: bool = True
    ) -> Tensor:
        """`learned.dip.loss.loss`."""
        return loss(out, *target, reconstruct_acc)

    def pose(self, out: Gaussian, R_world_bone: Tensor) -> Tensor:
        """Local rotations (...,24,3,3), the root's that of the pelvis sensor."""
        if R_world_bone.ndim < 3 or R_world_bone.shape[-3] != len(self.config.sensors):
            raise ShapeError(f"R_world_bone must be (...,6,3,3), got {tuple(R_world_bone.shape)}")
        return self.pose_under(out, R_world_bone[..., 5, :, :])

    def pose_under(self, out: Gaussian, R_world_root: Tensor) -> Tensor:
        """Local rotations (...,24,3,3) of the prediction and the pelvis sensor's rotation (...,3,3)."""
        return dip_pose(self.output_scaler.unscale(out.pose), R_world_root)

    def pose_deviation(self, out: Gaussian, R_parent_joint: Tensor) -> Tensor:
        """Standard deviation (...,24,3) rad of each joint's rotation vector (right tangent).

        With E the error of the predicted matrix M = R + E, its entries independent of deviations
        sigma_cb, the projection onto SO(3) moves R by d = vee(skew(R^T E)), so that
        var d_1 = 1/4 sum_c (R_c3^2 sigma_c2^2 + R_c2^2 sigma_c3^2), and cyclic; times the calibrated scale.
        """
        sigma = (out.pose_deviation * self.out_deviation).unflatten(-1, (15, 3, 3))
        R = R_parent_joint[..., list(DIP_JOINTS), :, :]
        S = (R * R).transpose(-1, -2) @ (sigma * sigma)  # S_ab = var (R^T E)_ab
        var = 0.25 * torch.stack(
            [
                S[..., 2, 1] + S[..., 1, 2],
                S[..., 0, 2] + S[..., 2, 0],
                S[..., 1, 0] + S[..., 0, 1],
            ],
            -1,
        )
        full = self.deviation_rad.expand(*var.shape[:-2], 24, 3).clone()
        full[..., list(DIP_JOINTS), :] = var.sqrt()
        return full * self.deviation_scale[:, None]

    @property
    def layers(self) -> tuple[nn.Linear, nn.LSTM] | None:
        """Of the recurrent architectures."""
        return (self.net.dense, self.net.lstm) if isinstance(self.net, BiRNN) else None

    def head(self, features: Tensor) -> Gaussian:
        """Means and deviations of one frame."""
        out: Gaussian = self.net.heads(features)  # type: ignore[operator]
        return out
