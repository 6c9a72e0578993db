"""Training: windows in, checkpoints and a log out; it can be killed at any point and resumed.

A run lives in a folder (`training.run_folder`): `state.pt` (everything needed to go on, replaced as a whole),
`log.jsonl` (one line per validation), `best.safetensors` with its JSON (the weights of the least `pose_error`
so far). A resumed run draws what the uninterrupted one would have drawn. On the same CPU with as many threads
it ends with its weights to the bit; on a GPU it need not, since cuDNN's LSTMs may add up in another order
each time. With several processes (`parallel`) the first alone reads and writes the folder; the others
go on from what it has found there, and draw anew from their rank and the step.
"""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from learned import checkpoint
from learned.errors import CheckpointError, TrainingError
from learned.model import Model, build
from learned.training.interrupts import Interrupts
from learned.training.parallel import World
from learned.training.precision import bfloat16_pays
from learned.training.run_folder import Identity, RunFolder, fingerprint, outline
from learned.training.settings import TrainSettings
from learned.training.validation import Windowed, score
from learned.training.virtual_windows import Batch
from mocap.errors import PoserError

SAVE_EVERY_S = 60.0
_GO, _DONE, _STOP = 0.0, 1.0, 2.0  # what the first process decides before every step


class BatchSource(Protocol):
    """Where batches come from."""

    def draw(self, rng: np.random.Generator, count: int) -> Batch: ...


Progress = Callable[[dict[str, Any]], None]


def pose_error(figures: Mapping[str, Any], prefix: str = "") -> float:
    """What the best weights have least of: position_cm + angular_deg of `training.validation.figures`.

    A degree about a joint moves what is 57 cm away, a limb's length, by 1 cm: the two weigh alike. The
    loss does not measure poses: it can rise while all pose errors still fall (docs/training.md).
    """
    return float(figures[f"{prefix}position_cm"] + figures[f"{prefix}angular_deg"])


class Trainer:
    """One run. `run()` goes on until it is done and returns the path of the best weights.

    data: names what the windows are cut from (`corpus.key_of`). start: a trained model to go on from,
    scalers included. A run is resumed neither on other data, nor with other windows to validate on, nor from
    another start. earlier: what was set aside where the folder held a run that cannot be gone on with.
    precision: "bfloat16" or "float32", whether its products are of mixed precision.
    """

    def __init__(
        self,
        settings: TrainSettings,
        source: BatchSource,
        validation: Windowed,
        folder: Path,
        about: dict[str, Any] | None = None,
        start: Model | None = None,
        world: World | None = None,
        data: str = "",
    ) -> None:
        self.settings, self.source, self.validation = settings, source, validation
        self.files, self.about = RunFolder(folder), about or {}
        self.identity = Identity(settings, data, fingerprint(start), outline(validation))
        self.world = world or World()
        self.device = torch.device(self.world.device)
        self.step, self.seconds, self.best, self.since_best = 0, 0.0, math.inf, 0
        self.best_step = 0  # of the validation that found the best weights; 0: of none
        self.validated, self.loss_sum, self.loss_count = 0, 0.0, 0
        torch.manual_seed(settings.seed)
        self.model: Model = build(settings.config) if start is None else copy.deepcopy(start)
        self.model.requires_grad_(True).train().to(self.device)
        # Several processes would wait for gradients that nobody computes.
        for layer in self.model.untaught(settings.reconstruct_acc):
            layer.requires_grad_(False)
        self._seed()
        self.average = copy.deepcopy(self.model).eval().requires_grad_(False)
        self.optimizer = torch.optim.Adam(self.model.parameters(), lr=settings.learning_rate)
        self.earlier: list[Path] = []
        self.bfloat16: bool | None = None  # what was measured; None: not yet
        self._begin(fit=start is None)
        self.called = self.world.wrapped(self.model)

    @property
    def precision(self) -> str:
        return "bfloat16" if self.settings.bfloat16 and self.bfloat16 else "float32"

    def _begin(self, fit: bool) -> None:
        """The first process alone looks into its folder and measures; all begin with what it has then.

        fit: `Model.fit`, where the run is new. Raises TrainingError in every process where the first cannot
        begin, or where this one was given other settings: its learning rates would be others.
        """
        shared: dict[str, Any] = {}
        if self.world.first:
            try:
                self._open(fit)
                shared = self._state() | self.identity.to_state()
            except PoserError as e:
                if self.world.size == 1:
                    raise
                shared = {"error": str(e)}
        shared = self.world.share(shared)
        if "error" in shared:
            raise TrainingError(shared["error"])
        if self.world.first:
            return
        if shared["settings"] != self.identity.to_state()["settings"]:
            raise TrainingError(
                f"process {self.world.rank} was given other settings than the first one"
            )
        self._take(shared)
        self._seed()

    def _open(self, fit: bool) -> None:
        self.files.path.mkdir(parents=True, exist_ok=True)
        if self.files.state.exists():
            self._resume()
        else:
            if fit:
                rng = np.random.default_rng(self.settings.seed)
                self.model.fit(lambda count: self.source.draw(rng, count))
                self.average.load_state_dict(self.model.state_dict())
            self.earlier = self.files.set_aside()
        if self.settings.bfloat16:
            self.bfloat16 = bfloat16_pays(self.device, self.bfloat16)

    def _seed(self) -> None:
        """Each process draws windows and dropout of its own; the weights are already alike."""
        seed, rank = self.settings.seed, self.world.rank
        self.rng = np.random.default_rng([seed, rank, self.step] if rank else seed)
        if rank:
            torch.manual_seed(int(self.rng.integers(2**62)))

    # -- the loop ---------------------------------------------------------------------------------

    def run(self, progress: Progress | None = None) -> Path:
        """Train. On Ctrl-C the step is finished, the state saved and KeyboardInterrupt raised."""
        saved = -math.inf  # after the first step: a log and weights without a state could not go on
        kept = False  # whether the folder holds the state as it is
        with Interrupts() as interrupts:
            while True:
                if self.world.first and self._due():
                    self._validate(progress, interrupts)
                    self._save()
                    saved, kept = time.monotonic(), True
                self.seconds, verdict = self.world.agree(self.seconds, self._verdict(interrupts))
                if verdict != _GO:
                    break
                began = time.monotonic()
                loss, kept = self._one(), False
                self.seconds += time.monotonic() - began
                if progress and self.step % 10 == 0:
                    progress({"step": self.step, "done": self.done(), "loss": loss})
                if time.monotonic() - saved > SAVE_EVERY_S:
                    self._save()
                    saved, kept = time.monotonic(), True
            if not kept:
                self._save()
        if verdict == _STOP:
            raise KeyboardInterrupt
        return self.files.best

    def done(self) -> float:
        """Share of the run that is over, by steps or by time, whichever is further."""
        steps, minutes = self.settings.steps, self.settings.minutes
        by_steps = 0.0 if steps is None else self.step / steps
        return by_steps if minutes is None else max(by_steps, self.seconds / (60 * minutes))

    def stale(self) -> bool:
        """Whether validation has not improved for long enough to stop."""
        return self.settings.patience > 0 and self.since_best >= self.settings.patience

    def _due(self) -> bool:
        if self.step == self.validated:  # done again where the best weights were lost since
            return self.step > 0 and self.best == math.inf
        return self.step % self.settings.every == 0 or self.done() >= 1

    def _verdict(self, interrupts: Interrupts) -> float:
        if self.done() >= 1 or self.stale():
            return _DONE
        return _STOP if interrupts.asked else _GO

    def _one(self) -> float:
        s = self.settings
        loss = self._loss(self.source.draw(self.rng, s.batch))
        if not torch.isfinite(loss):
            raise TrainingError(
                f"the loss is not finite at step {self.step}; a smaller rate may help"
            )
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if math.isfinite(s.clip):
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), s.clip)
        for group in self.optimizer.param_groups:
            group["lr"] = s.rate_at(self.step, self.done())
        self.optimizer.step()
        self.step += 1
        # A running mean that starts at zero knowledge: short at first, `average` in the long run.
        keep = min(s.average, (1 + self.step) / (10 + self.step)) if s.average else 0.0
        with torch.no_grad():
            for a, b in zip(self.average.parameters(), self.model.parameters(), strict=True):
                a.lerp_(b, 1 - keep)
        value = float(loss.detach())
        if self.step - 1 == self.validated:  # not before: that validation may have to be done again
            self.loss_sum, self.loss_count = 0.0, 0
        self.loss_sum, self.loss_count = self.loss_sum + value, self.loss_count + 1
        return value

    def _loss(self, batch: Batch) -> Tensor:
        model, s = self.model, self.settings
        half = self.precision == "bfloat16"
        mixed = torch.autocast(self.device.type, torch.bfloat16) if half else nullcontext()
        shown = model.drawn(self.rng, batch.there)
        x, target = model.examples(batch.R_world_bone, batch.acc_world, batch.R_parent_joint, shown)
        with mixed:
            out = self.called(x)
        return model.loss(out, target, s.reconstruct_acc)

    def _validate(self, progress: Progress | None, interrupts: Interrupts) -> None:
        interrupts.may_break = self.world.size == 1
        try:
            model = copy.deepcopy(self.average).to("cpu")
            found = score(model, self.validation, self.settings.reconstruct_acc)
        except KeyboardInterrupt:
            self._save()  # before this validation: it is done again
            raise
        finally:
            interrupts.may_break = False
        error = pose_error(found)
        row = {
            "step": self.step, "seconds": round(self.seconds, 1),
            "training_loss": self.loss_sum / max(1, self.loss_count),
            "rate": self.optimizer.param_groups[0]["lr"],
        } | {f"validation_{k}": v for k, v in found.items()}  # fmt: skip
        better, again = error < self.best, self.step == self.validated
        if better:
            self.best, self.best_step = error, self.step
            how = {"training": self.settings.to_json(), "precision": self.precision}
            checkpoint.save(model, self.files.best, self.about | how | {"validation": row})
        if not again:
            self.since_best = 0 if better else self.since_best + 1
            self.files.append(row)
        self.validated = self.step
        if progress:
            progress(row | {"done": self.done()})

    # -- state ------------------------------------------------------------------------------------

    def _state(self) -> dict[str, Any]:
        """What all processes share of a run."""
        return {
            "step": self.step, "seconds": self.seconds, "best_error": self.best,
            "best_step": self.best_step, "since_best": self.since_best, "validated": self.validated,
            "loss_sum": self.loss_sum, "loss_count": self.loss_count,
            "bfloat16": self.bfloat16, "model": self.model.state_dict(),
            "average": self.average.state_dict(), "optimizer": self.optimizer.state_dict(),
        }  # fmt: skip

    def _take(self, state: dict[str, Any]) -> None:
        """The inverse of `_state`; also of the states of earlier versions."""
        self.step, self.seconds = state["step"], state["seconds"]
        if "best_error" in state:
            self.best, self.since_best = state["best_error"], state["since_best"]
        else:  # an earlier version, which chose by the loss: its choice is the one to beat
            self.best = self._described()[1]
        self.best_step = state["best_step"] if "best_step" in state else self._described()[0]
        # Earlier versions saved right after a validation or between two: then nothing is due.
        self.validated = state.get("validated", self.step)
        self.loss_sum, self.loss_count = state.get("loss_sum", 0.0), state.get("loss_count", 0)
        self.bfloat16 = state.get("bfloat16", True)  # which earlier versions always used
        for model, name in ((self.model, "model"), (self.average, "average")):
            # Which earlier versions had not, and training leaves as it is.
            default = {"error_covariance": model.error_covariance}
            model.load_state_dict(default | state[name])
        self.optimizer.load_state_dict(state["optimizer"])

    def _save(self) -> None:
        if self.world.first:
            numbers = {"numpy": json.dumps(self.rng.bit_generator.state)}
            self.files.write(self._state() | numbers | generators(self.device), self.identity)

    def _resume(self) -> None:
        state = self.files.read(self.identity)
        try:
            self._take(state)
            self.rng.bit_generator.state = json.loads(state["numpy"])
            set_generators(self.device, state)
        except (KeyError, TypeError, ValueError, RuntimeError) as e:
            raise self.files.damaged() from e
        self.files.cut_log(self.validated)
        # Lost, or of a validation that is still to come: of a run that was killed before it saved.
        if not 0 < self._described()[0] == self.best_step:
            self.best, self.best_step = math.inf, 0

    def _described(self) -> tuple[int, float]:
        """Step and `pose_error` of the best weights in the folder: 0, infinite where there are none."""
        if not self.files.best.exists():
            return 0, math.inf
        try:
            found = checkpoint.describe(self.files.best)["validation"]
            return int(found["step"]), pose_error(found, "validation_")
        except (CheckpointError, KeyError, TypeError, ValueError):
            return 0, math.inf


def generators(device: torch.device) -> dict[str, Tensor]:
    """The states of torch's generators that draw dropout on a device."""
    found = {"torch": torch.get_rng_state()}
    return found | ({"cuda": torch.cuda.get_rng_state(device)} if device.type == "cuda" else {})


def set_generators(device: torch.device, state: Mapping[str, Tensor]) -> None:
    """The inverse of `generators`; a state saved on a CPU, or by an earlier version, has none of the GPU."""
    torch.set_rng_state(state["torch"])
    if device.type == "cuda" and "cuda" in state:
        torch.cuda.set_rng_state(state["cuda"], device)
