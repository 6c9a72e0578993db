"""Every number of a training run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from learned.checkpoint import LARGEST_HIDDEN
from learned.config import Config, for_network
from learned.errors import TrainingError
from learned.registry import specification
from learned.training.augmentation import Augmentation
from mocap import checked


@dataclass(frozen=True)
class TrainSettings:
    """A training run.

    config: what is trained.
    steps: optimizer steps, at most (None: the clock alone decides).
    batch: windows per step.
    frames: of a window.
    learning_rate: of Adam, at step 0.
    decay: the rate is learning_rate * decay ** (step / decay_steps).
    decay_steps: see decay.
    clip: of the gradient's norm.
    cooldown: the last share of the run over which the rate falls linearly to zero as well (0: none, as in the
    papers).
    average: decay of the running mean of the weights that is validated and shipped (0: the weights alone).
    reconstruct_acc: whether the loss counts predicted accelerations (DIP's eq. 5), where there are any.
    patience: validations without a lesser pose error (`trainer.pose_error`) after which training stops (0:
    never).
    every: steps between validations.
    bfloat16: mixed precision where it is faster (`training.precision`); False: single precision everywhere.
    minutes: stop after this long (None: no limit), the cooldown following the clock then.
    seed: of windows, dropout and first weights.
    augmentation: how the motion is varied.
    """

    config: Config = field(default_factory=Config)
    steps: int | None = 100_000
    batch: int = 16
    frames: int = 60
    learning_rate: float = 1e-3
    decay: float = 0.96
    decay_steps: int = 2000
    clip: float = 1.0
    cooldown: float = 0.0
    average: float = 0.999
    reconstruct_acc: bool = True
    patience: int = 20
    every: int = 1000
    bfloat16: bool = True
    minutes: float | None = None
    seed: int = 0
    augmentation: Augmentation = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        # None stands for no limit of these.
        free = [name for name in ("steps", "minutes") if getattr(self, name) is None]
        positive = ("learning_rate", "decay", "clip")
        checked.settings(
            self, positive=positive, free=free, infinite=("clip",), error=TrainingError
        )
        for name in ("steps", "batch", "every", "decay_steps"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise TrainingError(f"{name} must be 1 or more, got {value}")
        if self.steps is None and self.minutes is None:
            raise TrainingError("steps or minutes must say when the run ends")
        if self.frames < 8:
            raise TrainingError(f"frames must be 8 or more, got {self.frames}")
        for name in ("cooldown", "average"):
            if not 0 <= getattr(self, name) < 1:
                raise TrainingError(f"{name} must lie in [0, 1), got {getattr(self, name)}")
        if self.minutes is not None and not self.minutes > 0:
            raise TrainingError(f"minutes must be above zero, got {self.minutes}")
        if not 1 <= self.config.hidden <= LARGEST_HIDDEN:  # such weights could not be loaded
            raise TrainingError(f"hidden must be 1 to {LARGEST_HIDDEN}, got {self.config.hidden}")

    @classmethod
    def paper(cls, network: str, **changes: Any) -> TrainSettings:
        """The papers' schedules, and where they are left.

        DIP: Adam at 1e-3, decayed by 0.96 every 2,000 steps, gradients clipped at 1, early stopping (4.1;
        the authors' code has 1e-4), batches of 16 (the authors' code). IMUPoser: Adam at 3e-4, batches of
        256 windows of 125 frames (4.3), no decay, no clipping.

        Ours, of both: what is validated and shipped is a running mean of the weights (`average`); the best
        weights and early stopping go by `trainer.pose_error`, where DIP's go by the log-likelihood of
        the validation set (4.1) and IMUPoser's paper states neither. DIP: windows of 60 frames at random
        places, where the paper trains on entire sequences (3.4, 5.1.4). IMUPoser: windows at random places
        with one combination of devices drawn for each, and a number of steps, where the paper has windows
        that do not overlap, 24 copies of each (4.2) and 80 epochs (4.3).
        """
        base = {"config": for_network(network), **specification(network).schedule}
        return cls(**(base | changes))

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)

    def rate_at(self, step: int, done: float) -> float:
        """Learning rate at a step, `done` the share of the run (0 to 1) that is over."""
        rate = self.learning_rate * self.decay ** (step / self.decay_steps)
        if self.cooldown > 0:
            rate *= min(1.0, max(0.0, 1.0 - done) / self.cooldown)
        return rate
