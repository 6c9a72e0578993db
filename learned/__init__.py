"""Networks that estimate a body's pose from a few inertial sensors: DIP and IMUPoser.

The DIP network (Huang et al. 2018) reads six sensors at 60 Hz; IMUPoser (Mollyn et al. 2023) any one to
three of five everyday devices at 25 Hz. `estimator` streams one with the shipped weights, or with yours,
through the protocol of `mocap.estimator`; `learned.training` trains them on virtual sensors put on motion
capture. What each network is stands in its `Specification`; torch is imported once a model is asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mocap.lazy_names import lazy

if TYPE_CHECKING:
    from learned.checkpoint import load, save, shipped
    from learned.config import Config, for_network
    from learned.errors import CheckpointError, TrainingError
    from learned.model import Model, build
    from learned.online.estimator import Online
    from learned.online.streaming import stream
    from learned.pretrained import estimator
    from learned.registry import NETWORKS, specification
    from learned.spec import Specification

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

__getattr__ = lazy(
    __name__,
    {
        "NETWORKS": "registry",
        "CheckpointError": "errors",
        "Config": "config",
        "Model": "model",
        "Online": "online.estimator",
        "Specification": "spec",
        "TrainingError": "errors",
        "build": "model",
        "estimator": "pretrained",
        "for_network": "config",
        "load": "checkpoint",
        "save": "checkpoint",
        "shipped": "checkpoint",
        "specification": "registry",
        "stream": "online.streaming",
    },
)


def __dir__() -> list[str]:
    return __all__
