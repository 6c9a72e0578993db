"""Small motions, corpora and networks that the tests of this folder share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from learned.config import for_network
from learned.dip.model import Dip
from learned.model import build
from learned.registry import specification
from learned.training.augmentation import Augmentation
from learned.training.corpus import Corpus, pack
from learned.training.settings import TrainSettings
from learned.training.trainer import Trainer
from learned.training.validation import Windowed, cut
from learned.training.virtual_windows import Windows
from mocap import orientation as ori
from mocap import sensors as places
from mocap import synthesis
from mocap.motion import Motion
from mocap.skeleton import Skeleton

# Networks this small only wait for each other on several threads.
torch.set_num_threads(1)


def dip(**config: Any) -> Dip:
    """An untrained DIP of 8 units."""
    torch.manual_seed(0)
    model = build(for_network("dip", hidden=8, **config)).eval()
    assert isinstance(model, Dip)
    return model


def wavy(frames: int = 90, rate_hz: float = 60.0, seed: int = 0, size: float = 0.3) -> Motion:
    """Every joint swings on its own sines; the root turns and travels."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / rate_hz
    amplitude = rng.normal(size=(24, 3)) * size
    phase, speed = rng.uniform(0, 6, (24, 3)), rng.uniform(0.3, 1.2, (24, 3))
    s = t[:, 0, 0]
    path = np.stack([0.5 * s, 0.05 * np.sin(5 * s), np.sin(s)], axis=1)
    return Motion(
        rate_hz,
        ori.exp(amplitude * np.sin(2 * np.pi * speed * t + phase)),
        path,
        Skeleton.default(),
    )


def still(frames: int) -> Motion:
    """The rest pose."""
    R = np.tile(np.eye(3), (frames, 24, 1, 1))
    return Motion(60.0, R, np.zeros((frames, 3)), Skeleton.default())


def sensors_of(network: str) -> tuple[str, ...]:
    return places.FIVE if network == "imuposer" else places.SIX


def windows(
    motion: Motion | Corpus,
    network: str = "dip",
    frames: int = 20,
    augmentation: Augmentation | None = None,
) -> Windows:
    """Windows of one clip, clean and not augmented unless told."""
    corpus = pack([("clip", motion)]) if isinstance(motion, Motion) else motion
    augmentation = augmentation or Augmentation.none()
    return Windows(
        corpus, sensors_of(network), specification(network).rate_hz, frames, augmentation
    )


def validation(motion: Motion, network: str = "dip", stride: int = 6) -> Windowed:
    """Clean windows of a motion, as the online runner sees them (shorter for IMUPoser)."""
    recording = synthesis.recording(
        motion.resampled(specification(network).rate_hz), sensors_of(network)
    )
    past, future = (20, 5) if network == "dip" else (19, 0)
    return cut([recording], past, future, stride)


def tiny(
    network: str = "dip", config: dict[str, Any] | None = None, **changes: Any
) -> TrainSettings:
    """A run of a few steps of a small network, in single precision."""
    base: dict[str, Any] = {
        "config": for_network(network, **({"hidden": 8} | (config or {}))),
        "steps": 12, "batch": 3, "frames": 12, "every": 5, "bfloat16": False,
        "augmentation": Augmentation.none(),
    }  # fmt: skip
    return TrainSettings.paper(network, **(base | changes))


def trainer(folder: Path, settings: TrainSettings | None = None, **more: Any) -> Trainer:
    """A trainer of `tiny` settings on the wavy clip."""
    settings = settings or tiny()
    network, motion = settings.config.network, wavy()
    source = windows(motion, network, settings.frames, settings.augmentation)
    return Trainer(settings, source, validation(motion, network, 30), folder, **more)
