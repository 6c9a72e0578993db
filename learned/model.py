"""A network with everything it needs to be used: what training, validation, export and online runner share.

They know `Model` alone; each network's folder holds its own (`learned.dip.model`, `learned.imuposer.model`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor, nn

from learned.config import Config
from learned.spec import named

if TYPE_CHECKING:
    from learned.training.virtual_windows import Batch


class Model(nn.Module):
    """Base of the networks' models. B windows of T frames, S sensors: R_world_bone (B,T,S,3,3), acc_world
    (B,T,S,3) m/s^2, R_parent_joint (B,T,24,3,3); there, shown (B,S): the sensors that are worn.

    What `forward` gives is a tensor (B,T,...), or something else that `out[window, frame]` indexes.
    net: its layers, whose weights are halved when they are shipped. reach: frames of layer 2 that the
    runtime keeps, from the description of the weights (`learned.training.reach`); None: all of them.
    """

    net: nn.Module
    error_covariance: Tensor

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.reach: int | None = None

    def forward(self, x: Tensor) -> Any:
        """The layers' own answer to inputs (B,T,D)."""
        return self.net(x)

    # -- training and validation ------------------------------------------------------------------

    def fit(self, draw: Callable[[int], Batch]) -> None:
        """Before the first step: what is taken from the training motion itself. draw: so many windows."""

    def untaught(self, reconstruct_acc: bool) -> list[nn.Module]:
        """Layers that the loss does not depend on."""
        return []

    def drawn(self, rng: np.random.Generator, there: Tensor) -> Tensor:
        """(B,S): of the sensors that are there, those that it is shown in a step of training."""
        return there

    def in_turn(self, first: int, there: Tensor) -> Tensor:
        """(B,S): those that it is shown in validation windows number `first` and on."""
        return there

    def examples(
        self, R_world_bone: Tensor, acc_world: Tensor, R_parent_joint: Tensor, shown: Tensor
    ) -> tuple[Tensor, Any]:
        """Inputs (B,T,D) and the targets for `loss`."""
        raise NotImplementedError

    def loss(self, out: Any, target: Any, reconstruct_acc: bool = True) -> Tensor:
        """The paper's loss. reconstruct_acc: whether it counts predicted accelerations, where there are
        any.
        """
        raise NotImplementedError

    def pose(self, out: Any, R_world_bone: Tensor) -> Tensor:
        """Local rotations (...,24,3,3) of answers, with the sensors' rotations (...,S,3,3) of their
        frames.
        """
        raise NotImplementedError

    # -- online -----------------------------------------------------------------------------------

    @property
    def layers(self) -> tuple[nn.Linear, nn.LSTM] | None:
        """The dense layer (a ReLU behind it) and the two LSTM layers, where it is built so
        (`learned.runtime`).
        """
        return None

    def head(self, features: Tensor) -> Any:
        """The answer for one frame, from its features (F,) behind `layers`."""
        raise NotImplementedError


def build(config: Config) -> Model:
    """An untrained model; torch's generator decides the weights."""
    made: Model = named(config.specification.model)(config)
    return made
