"""Networks that estimate a body's pose from a few inertial sensors: DIP and IMUPoser.

The DIP network (Huang et al. 2018) reads six sensors at 60 Hz; IMUPoser (Mollyn et al. 2023) any one to
three of five everyday devices at 25 Hz. `estimator` streams one with the shipped weights, or with yours,
through the protocol of `mocap.estimator`; `learned.training` trains them on virtual sensors put on motion
capture. What each network is stands in its `Specification`; torch is imported once a model is made.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from learned.config import Config, for_network
from learned.errors import CheckpointError, TrainingError
from learned.registry import NETWORKS, specification
from learned.specification import Specification

if TYPE_CHECKING:
    from learned.checkpoint import load, save, shipped
    from learned.model import Model, build
    from learned.online import Online, stream
    from learned.pretrained import estimator

# Name -> its module, of those that import torch.
_LATER = {
    "Model": "learned.model",
    "Online": "learned.online",
    "build": "learned.model",
    "estimator": "learned.pretrained",
    "load": "learned.checkpoint",
    "save": "learned.checkpoint",
    "shipped": "learned.checkpoint",
    "stream": "learned.online",
}

__all__ = [
    "NETWORKS",
    "CheckpointError",
    "Config",
    "Model",
    "Online",
    "Specification",
    "TrainingError",
    "build",
    "estimator",
    "for_network",
    "load",
    "save",
    "shipped",
    "specification",
    "stream",
]


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'learned' has no attribute {name!r}")
    found = getattr(import_module(_LATER[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
