"""What a run keeps in its folder: a state to go on from, a log, the best weights; and whose they are."""

from __future__ import annotations

import hashlib
import io
import json
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learned.errors import TrainingError
from learned.model import Model
from learned.registry import NETWORKS
from learned.training.settings import TrainSettings
from learned.training.validation import Windowed
from mocap.errors import FormatError
from mocap.formats._files import about, check_regular, read_text, write_aside

# Settings that may change when a run goes on: when it ends, and what suits the machine.
FREE = ("steps", "minutes", "patience", "bfloat16")
# Settings by the options of poser train that state them, in the order in which they are told.
OPTIONS = {
    "config.architecture": "--architecture", "config.hidden": "--hidden",
    "config.normalisation": "--normalisation", "config.use_acc": "use_acc (--no-acc)",
    "config.dropout": "dropout (--no-dropout)", "reconstruct_acc": "reconstruct_acc (--no-acc-loss)",
    "batch": "--batch", "frames": "--frames", "learning_rate": "--rate", "cooldown": "--cooldown",
    "every": "--every", "seed": "--seed",
    "augmentation.splice": "splice (--no-splice)",
}  # fmt: skip
NAMED = 3  # settings that an error names
ALIKE = 1e-5  # what means of rotations and of m/s^2 may differ by in `outline`s of the same windows


def fingerprint(model: Model | None) -> str:
    """16 hexadecimal digits that change with any weight of a model; empty for none."""
    if model is None:
        return ""
    digest = hashlib.sha256()
    for name, tensor in sorted(model.state_dict().items()):
        digest.update(name.encode() + tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


def outline(windows: Windowed) -> list[float]:
    """Numbers that tell validation windows from others: how many there are of how many clips, and the means
    over windows and frames of all that is in them.

    No digest of their bytes: those are the same on one machine, but another processor or another numpy
    rounds otherwise, and a run may be moved. One other window among 1,500 moves means by far more.
    """
    tensors = (windows.R_world_bone, windows.acc_world, windows.R_parent_joint)
    means = [x.mean((0, 1), dtype=torch.float64).flatten() for x in tensors]
    worn = windows.there.double().mean(0)
    counts = [float(len(windows.clip)), float(len(np.unique(windows.clip)))]
    return [*counts, *torch.cat([*means, worn]).tolist()]


@dataclass(frozen=True)
class Identity:
    """What a run must share with the one that it goes on with.

    data: names what the windows are cut from (`corpus.key_of`); start: `fingerprint` of the weights that
    the run began with; validation: `outline` of the windows that it is validated on. Data and start may be
    empty: of no name, of no weights.
    """

    settings: TrainSettings
    data: str
    start: str
    validation: list[float]

    def to_state(self) -> dict[str, Any]:
        """As `RunFolder.read` compares it."""
        settings = json.dumps(self.settings.to_json(), sort_keys=True)
        return {
            "settings": settings, "data": self.data, "start": self.start,
            "validation": self.validation,
        }  # fmt: skip


def _has_meta(value: Any) -> bool:
    """Whether a tensor in it is of torch's device meta, which has a shape and no numbers."""
    if isinstance(value, dict):
        return any(map(_has_meta, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_has_meta, value))
    return isinstance(value, torch.Tensor) and value.is_meta


@dataclass(frozen=True)
class RunFolder:
    """The files of a run."""

    path: Path

    @property
    def state(self) -> Path:
        return self.path / "state.pt"

    @property
    def log(self) -> Path:
        return self.path / "log.jsonl"

    @property
    def best(self) -> Path:
        return self.path / "best.safetensors"

    @property
    def files(self) -> tuple[Path, ...]:
        """All that a run writes here itself."""
        return (self.state, self.log, self.best, self.best.with_suffix(".json"))

    def set_aside(self) -> list[Path]:
        """Rename log and weights of a run that left no state to go on from, as `log.jsonl.1` or with the next
        number that is free. Returns the new paths; none where there was nothing.
        """
        left = [p for p in self.files if p != self.state and p.exists()]
        k = 1
        while any(p.with_name(f"{p.name}.{k}").exists() for p in left):
            k += 1
        return [p.rename(p.with_name(f"{p.name}.{k}")) for p in left]

    def write(self, state: dict[str, Any], identity: Identity) -> None:
        """The state as a whole, in place of the one before."""
        # Into memory first: of a full disk torch tells nothing that a user could read.
        whole = io.BytesIO()
        torch.save(state | identity.to_state(), whole)
        with write_aside(self.state) as aside:
            aside.write_bytes(whole.getbuffer())

    def read(self, identity: Identity) -> dict[str, Any]:
        """The state. Raises TrainingError where it is damaged or of another run.

        Earlier versions wrote no `start` and no `validation`: such a state fits any.
        """
        try:
            check_regular(self.state)
            state: dict[str, Any] = torch.load(self.state, weights_only=True, map_location="cpu")
            settings = _fixed(state["settings"])
            if _has_meta(state):
                raise ValueError("tensors without numbers")
        except FormatError:
            raise
        except pickle.UnpicklingError as e:
            raise self.damaged("it is damaged, or holds more than tensors and is not loaded") from e
        # The file is a pickle of tensors: what else breaks in a damaged one cannot be listed.
        except Exception as e:
            raise self.damaged() from e
        mine = identity.to_state()
        if settings != _fixed(mine["settings"]):
            words = _differences(settings, _fixed(mine["settings"]))
            raise self._other(f"with other settings ({words})", "the same settings")
        if state.get("data", "") and mine["data"] and state["data"] != mine["data"]:
            raise self._other("on other motions", "the same motions")
        if state.get("start", mine["start"]) != mine["start"]:
            raise self._other("that began with other weights", "the same weights to start from")
        if not _alike(state.get("validation", mine["validation"]), mine["validation"]):
            raise self._other(
                "that was validated on other motions", "the same motions to validate on"
            )
        return state

    def damaged(self, how: str = "it is damaged, or no state of a run") -> TrainingError:
        """The error of a state that cannot be gone on from."""
        return TrainingError(f"{self.state}: cannot be resumed from; {how}")

    def _other(self, what: str, same: str) -> TrainingError:
        return TrainingError(f"{self.path}: holds a run {what}; give another folder, or {same}")

    def append(self, row: dict[str, Any]) -> None:
        """One line more in the log."""
        with about(self.log), self.log.open("a") as log:
            log.write(json.dumps(row) + "\n")

    def cut_log(self, step: int) -> None:
        """Lines of later steps were written by a run that was killed before it saved: redone now."""
        if self.log.exists():
            rows = [line for line in read_text(self.log).splitlines() if line.endswith("}")]
            with write_aside(self.log) as aside:
                kept = [r for r in rows if json.loads(r)["step"] <= step]
                aside.write_text("".join(r + "\n" for r in kept))


def _alike(a: list[float], b: list[float]) -> bool:
    """Whether two `outline`s are of the same windows."""
    return len(a) == len(b) and np.allclose(a, b, rtol=0.0, atol=ALIKE, equal_nan=True)


def _fixed(settings: str) -> dict[str, Any]:
    """Settings but for those that may change when a run goes on."""
    return {k: v for k, v in json.loads(settings).items() if k not in FREE}


def _differences(theirs: dict[str, Any], mine: dict[str, Any]) -> str:
    """Settings that differ, with both values: `--seed 0 there, 1 here`; `NAMED` of them, then a count."""
    there, here = _flat(theirs), _flat(mine)
    if _network(there) != _network(here):  # much else follows from it
        return f"network {_network(there)} there, {_network(here)} here"
    names = dict.fromkeys([*OPTIONS, *there, *here])
    apart = [k for k in names if there.get(k) != here.get(k)]
    told = [
        f"{OPTIONS.get(k, k)} {_value(there.get(k))} there, {_value(here.get(k))} here"
        for k in apart[:NAMED]
    ]
    more = f"; and {len(apart) - NAMED} more" if len(apart) > NAMED else ""
    return "; ".join(told) + more


def _flat(settings: dict[str, Any], before: str = "") -> dict[str, Any]:
    """Nested settings under names with dots: `config.hidden`."""
    out: dict[str, Any] = {}
    for name, value in settings.items():
        own = f"{before}{name}"
        out |= _flat(value, f"{own}.") if isinstance(value, dict) else {own: value}
    return out


def _network(settings: dict[str, Any]) -> str:
    """Its name; empty where a state names no architecture that is known."""
    architecture = settings.get("config.architecture")
    return next((n for n, s in NETWORKS.items() if architecture in s.architectures), "")


def _value(x: Any) -> str:
    return f"{x:g}" if isinstance(x, float) else str(x)
