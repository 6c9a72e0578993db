"""IMUPoser (Mollyn et al. 2023, 4.1): a two-layer bidirectional LSTM over five everyday places."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from learned import recurrent

POSE = 144  # 24 joints x 6D


class IMUPoser(nn.Module):
    """Linear 512 + ReLU, two-layer BiLSTM of 512, linear to 144; 10.7 M parameters (4.1).

    Input (B,T,60) of `learned.features.imuposer_input`. Input dropout 0.2, as the authors' code has it.
    """

    def __init__(self, inputs: int = 60, hidden: int = 512, dropout: float = 0.2) -> None:
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.dense = nn.Linear(inputs, hidden)
        self.lstm = nn.LSTM(hidden, hidden, 2, batch_first=True, bidirectional=True)
        self.head = nn.Linear(2 * hidden, POSE)

    def forward(self, x: Tensor) -> Tensor:
        x = torch.relu(self.dense(self.dropout(x)))
        return self.head(recurrent.run(self.lstm, x) if self.training else self.lstm(x)[0]).float()
