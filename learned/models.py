"""A network with everything it needs to be used: scaling, sensors, rate, uncertainty.

`Dip` and `Imuposer` map sensors to local rotations; training, online runner and checkpoints share them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from learned import features
from learned.dip.network import ACC, POSE, BiRNN, FeedForward, Gaussian, WaveNet
from learned.errors import CheckpointError
from learned.features import DIP_JOINTS, Normalisation, Scaler
from learned.imuposer.network import IMUPoser
from mocap import sensors as places

Architecture = Literal["birnn", "rnn", "feedforward", "wavenet", "imuposer"]
ARCHITECTURES: tuple[Architecture, ...] = ("birnn", "rnn", "feedforward", "wavenet", "imuposer")
FIXED_WIDTHS = ("feedforward", "wavenet")  # those of DIP's appendix A, whatever `hidden` says
RATES = {"dip": 60.0, "imuposer": 25.0}


@dataclass(frozen=True)
class Config:
    """What a network is: enough to build it again, and to refuse weights of another one.

    hidden: width of the recurrent layers (recurrent architectures alone). normalisation, use_acc,
    dropout: DIP's experiments (appendices C and D, 3.4.3).
    """

    architecture: Architecture = "birnn"
    rate_hz: float = 60.0
    sensors: tuple[str, ...] = places.SIX
    hidden: int = 512
    dropout: float = 0.2
    normalisation: Normalisation = "root"
    use_acc: bool = True

    def __post_init__(self) -> None:
        if self.architecture not in ARCHITECTURES:
            raise CheckpointError(
                f"architecture {self.architecture!r} unknown; known: {', '.join(ARCHITECTURES)}"
            )
        want = places.FIVE if self.network == "imuposer" else places.SIX
        object.__setattr__(self, "sensors", tuple(self.sensors))
        if self.sensors != want:
            raise CheckpointError(
                f"sensors {', '.join(self.sensors)}: {self.network} reads {', '.join(want)}, in this order"
            )
        if self.rate_hz != RATES[self.network]:
            raise CheckpointError(
                f"rate {self.rate_hz:g} Hz: {self.network} runs at {RATES[self.network]:g} Hz"
            )

    @property
    def network(self) -> str:
        """dip or imuposer."""
        return "imuposer" if self.architecture == "imuposer" else "dip"

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self) | {"sensors": list(self.sensors)}


def for_network(network: str, **changes: Any) -> Config:
    """The default configuration of dip or imuposer."""
    if network == "imuposer":
        base: dict[str, Any] = {
            "architecture": "imuposer", "rate_hz": RATES["imuposer"], "sensors": places.FIVE,
        }  # fmt: skip
        return Config(**(base | changes))
    return Config(**changes)


class Dip(nn.Module):
    """DIP's network with its scalers; deviations: see `pose_deviation`."""

    in_mean: Tensor
    in_deviation: Tensor
    out_mean: Tensor
    out_deviation: Tensor
    deviation_scale: Tensor
    deviation_rad: Tensor
    error_covariance: Tensor

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        # Frames of layer 2 that the runtime keeps, from the description of the weights; None: all of them.
        self.reach: int | None = None
        sensors = 5 if config.normalisation == "root" else 6
        self.n_orientation = 9 * sensors
        inputs = self.n_orientation + (3 * sensors if config.use_acc else 0)
        if config.architecture in ("birnn", "rnn"):
            directions = 2 if config.architecture == "birnn" else 1
            self.net: nn.Module = BiRNN(inputs, config.hidden, config.dropout, directions)
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
        x = features.dip_input(R_world_bone, acc_world, self.config.normalisation)
        for name, scaler in (
            ("in", Scaler.fit(x)),
            ("out", Scaler.fit(features.dip_target(R_parent_joint))),
        ):
            getattr(self, f"{name}_mean").copy_(scaler.mean)
            getattr(self, f"{name}_deviation").copy_(scaler.deviation)

    def inputs(self, R_world_bone: Tensor, acc_world: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled input (B,T,D) and the scaled accelerations (B,T,15) that it is asked to reconstruct."""
        x = features.dip_input(R_world_bone, acc_world, self.config.normalisation)
        x = self.input_scaler.scale(x)
        acc = x[..., self.n_orientation : self.n_orientation + ACC]
        return (x if self.config.use_acc else x[..., : self.n_orientation]), acc

    def forward(self, x: Tensor) -> Gaussian:
        out: Gaussian = self.net(x)
        return out

    def pose(self, out: Gaussian, R_world_root: Tensor) -> Tensor:
        """Local rotations (...,24,3,3) of the prediction and the pelvis sensor's rotation."""
        return features.dip_pose(self.output_scaler.unscale(out.pose), R_world_root)

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


class Imuposer(nn.Module):
    """IMUPoser's network; its validation errors for each of the 24 combinations: `deviation_rad`
    (24,24,3) rad, joint by joint, `error_covariance` (24,72,72) rad^2, all joints together."""

    deviation_rad: Tensor
    error_covariance: Tensor

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.reach: int | None = None  # as of Dip
        self.net = IMUPoser(hidden=config.hidden, dropout=config.dropout)
        count = len(features.COMBINATIONS)
        self.register_buffer("deviation_rad", torch.full((count, 24, 3), 0.3))
        self.register_buffer("error_covariance", 0.09 * torch.eye(72).repeat(count, 1, 1))

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.net(x)
        return out


Model = Dip | Imuposer


def build(config: Config) -> Model:
    """An untrained model; torch's generator decides the weights."""
    return Imuposer(config) if config.network == "imuposer" else Dip(config)
