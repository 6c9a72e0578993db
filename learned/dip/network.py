"""Deep Inertial Poser (Huang et al. 2018): BiRNN, its uni-directional form, and appendix A's networks.

All read scaled inputs (B,T,D) and give `Gaussian`s: a mean and a standard deviation for the pose
(135 = 15 joints x 9) and for the accelerations (15), in scaled units.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from learned import recurrent

POSE, ACC = (
    135,
    15,
)  # numbers predicted: 15 joints' local rotation matrices, 5 sensors' accelerations
DEVIATION_MIN = 1e-3  # scaled units: keeps the log-likelihood finite where a channel is constant


@dataclass(frozen=True)
class Gaussian:
    """Mean and standard deviation of the pose (B,T,135) and of the accelerations (B,T,15), scaled."""

    pose: Tensor
    pose_deviation: Tensor
    acc: Tensor
    acc_deviation: Tensor

    def at(self, t: int) -> Gaussian:
        """Of frame t alone: (B,135) and (B,15)."""
        return Gaussian(
            self.pose[:, t], self.pose_deviation[:, t], self.acc[:, t], self.acc_deviation[:, t]
        )


class Heads(nn.Module):
    """Linear maps to the two means and, through softplus, the two standard deviations (Fig. 12)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.pose, self.pose_deviation = nn.Linear(width, POSE), nn.Linear(width, POSE)
        self.acc, self.acc_deviation = nn.Linear(width, ACC), nn.Linear(width, ACC)

    def forward(self, x: Tensor) -> Gaussian:
        return Gaussian(
            self.pose(x).float(),
            softplus(self.pose_deviation(x).float()) + DEVIATION_MIN,
            self.acc(x).float(),
            softplus(self.acc_deviation(x).float()) + DEVIATION_MIN,
        )


class Network(nn.Module):
    """What appendix A's networks have in common."""

    heads: Heads

    def untaught(self, reconstruct_acc: bool) -> list[nn.Module]:
        """Layers that the loss does not depend on.

        reconstruct_acc: whether the loss counts the accelerations (`learned.training.losses.dip`).
        """
        return [] if reconstruct_acc else [self.heads.acc, self.heads.acc_deviation]


class BiRNN(Network):
    """Dense 512 + ReLU, two stacked bidirectional LSTM layers of 512, heads (3.4, Fig. 12).

    The authors' code has a further dense layer of 256 before the heads; the paper has none and is
    followed. Input dropout 0.2 (keep probability 0.8, 3.4.3). directions=1 is the paper's RNN.
    """

    def __init__(
        self, inputs: int = 60, hidden: int = 512, dropout: float = 0.2, directions: int = 2
    ) -> None:
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.dense = nn.Linear(inputs, hidden)
        self.lstm = nn.LSTM(hidden, hidden, 2, batch_first=True, bidirectional=directions == 2)
        self.heads = Heads(hidden * directions)

    def forward(self, x: Tensor) -> Gaussian:
        x = torch.relu(self.dense(self.dropout(x)))
        return self.heads(recurrent.run(self.lstm, x) if self.training else self.lstm(x)[0])


class FeedForward(Network):
    """Five dense layers of 256, 512, 512, 256, 256 on a window of 20 past and 5 future frames (A)."""

    past, future = 20, 5

    def __init__(self, inputs: int = 60, dropout: float = 0.2) -> None:
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        widths = (inputs * (self.past + 1 + self.future), 256, 512, 512, 256, 256)
        layers: list[nn.Module] = []
        for a, b in itertools.pairwise(widths):
            layers += [nn.Linear(a, b), nn.ReLU()]
        self.layers = nn.Sequential(*layers)
        self.heads = Heads(widths[-1])

    def forward(self, x: Tensor) -> Gaussian:
        x = self.dropout(x)
        # Frames beyond the ends repeat the end frames, as the sliding window does before it is full.
        first, last = x[:, :1], x[:, -1:]
        padded = torch.cat(
            [first.expand(-1, self.past, -1), x, last.expand(-1, self.future, -1)], 1
        )
        windows = padded.unfold(1, self.past + 1 + self.future, 1)
        return self.heads(self.layers(windows.transpose(-1, -2).flatten(-2)))


class WaveNet(Network):
    """Dilated causal convolutions with gated units (van den Oord et al. 2016), five frames late (A).

    The paper gives no sizes: here 128 channels, kernels of 2, dilations 1, 2, 4, 8 and 1, 2, 4, 8 (a
    reach of 31 frames). The output at frame t reads frames up to t + 5, as the online BiRNN does.
    """

    future = 5

    def __init__(self, inputs: int = 60, channels: int = 128, dropout: float = 0.2) -> None:
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.entry = nn.Conv1d(inputs, channels, 1)
        self.dilations = (1, 2, 4, 8, 1, 2, 4, 8)
        self.gates = nn.ModuleList(
            nn.Conv1d(channels, 2 * channels, 2, dilation=d) for d in self.dilations
        )
        self.residual = nn.ModuleList(nn.Conv1d(channels, channels, 1) for _ in self.dilations)
        self.skip = nn.ModuleList(nn.Conv1d(channels, channels, 1) for _ in self.dilations)
        self.heads = Heads(channels)

    def untaught(self, reconstruct_acc: bool) -> list[nn.Module]:
        """The last residual map too: no further layer reads it. It stays, as weights name it."""
        return [*super().untaught(reconstruct_acc), self.residual[-1]]

    def forward(self, x: Tensor) -> Gaussian:
        x = self.dropout(x)
        x = torch.cat(
            [x[:, self.future :], x[:, -1:].expand(-1, min(self.future, x.shape[1]), -1)], 1
        )
        h = self.entry(x.transpose(1, 2))
        out = torch.zeros_like(h)
        for d, gate, residual, skip in zip(
            self.dilations, self.gates, self.residual, self.skip, strict=True
        ):
            a, b = gate(nn.functional.pad(h, (d, 0))).chunk(2, 1)
            z = torch.tanh(a) * torch.sigmoid(b)
            out = out + skip(z)
            h = h + residual(z)
        return self.heads(torch.relu(out).transpose(1, 2))
