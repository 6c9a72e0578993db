"""Which of the combinations of devices windows of recordings hold, and which one they are shown with.

A recording rarely has all five places, and devices come and go. A place without a device is no input of zeros
that was measured: the network must neither learn from combinations with it nor be judged by them.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from learned.imuposer.specification import COMBINATIONS

_MASKS = torch.tensor([[p in c for p in range(5)] for c in COMBINATIONS])  # (24,5)


def possible(there: Tensor) -> Tensor:
    """(N,24): the combinations of the places (N,5) that are there."""
    return (there[:, None] | ~_MASKS.to(there.device)).all(-1)


def drawn(rng: np.random.Generator, there: Tensor) -> Tensor:
    """(N,5): one of the possible combinations each, all alike probable, where there is a place in each."""
    count = possible(there).sum(1).cpu().numpy()
    return _chosen(there, torch.as_tensor(rng.integers(count)))


def in_turn(first: int, there: Tensor) -> Tensor:
    """(N,5): of the possible combinations number first, first + 1, ..., going round them."""
    count = possible(there).sum(1).cpu()
    return _chosen(there, (first + torch.arange(len(there))) % count)


def _chosen(there: Tensor, number: Tensor) -> Tensor:
    """(N,5): of each window's possible combinations the one of this number (N,), counted from 0."""
    may = possible(there).cpu()
    which = ((may.cumsum(1) == number[:, None] + 1) & may).int().argmax(1)
    return _MASKS[which].to(there.device)
