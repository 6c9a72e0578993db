"""Weights on disk: safetensors and a JSON description beside them.

Neither can run code. The JSON says what the network is (`Config`), what it was trained on, its licence and
its figures; loading refuses what does not fit with a sentence.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, get_args

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as serialised
from torch import Tensor

from learned.config import Config, Normalisation
from learned.errors import CheckpointError
from learned.model import Model, build
from learned.spec import named
from mocap.errors import FormatError
from mocap.formats._files import check_regular, read_json, write_aside

SCHEMA = "poser-weights/1"
WEIGHTS = Path(__file__).parent / "weights"
LARGEST_HIDDEN = 8192  # a description that asks for more is damaged
# Divided by, or standard deviations.
POSITIVE = ("in_deviation", "out_deviation", "deviation_scale", "deviation_rad")
ROUNDING = 1e-4  # of a covariance in single precision, relative to its greatest entry or eigenvalue


def shipped(network: str) -> Path:
    """A network's weights that come with the package."""
    return WEIGHTS / f"{network}.safetensors"


def save(model: Model, path: Path, about: dict[str, Any], half: bool = False) -> None:
    """Write `path` (.safetensors) and the .json beside it. Killed in between it leaves weights without a
    description, which cannot be loaded, never weights with another's.

    half: matrices in half precision; vectors, scalers and deviations stay single, they cost nothing.
    """
    if any(x.is_meta for x in model.state_dict().values()):
        raise CheckpointError(f"{path}: not written: the weights hold no numbers (device meta)")
    tensors = {
        name: (x.half() if half and x.ndim > 1 and name.startswith("net.") else x)
        .detach().cpu().contiguous()
        for name, x in model.state_dict().items()
    }  # fmt: skip
    record = {"schema": SCHEMA, "config": model.config.to_json(), **about}
    beside = path.with_suffix(".json")
    with write_aside(beside) as description, write_aside(path) as weights:
        description.write_text(json.dumps(_plain(record), indent=1, allow_nan=False) + "\n")
        # Not save_file: it replaces the file by one that only its owner may read.
        weights.write_bytes(serialised(tensors, metadata={"schema": SCHEMA}))
        beside.unlink(missing_ok=True)  # the weights are put in place next, their description last


def _plain(value: Any) -> Any:
    """JSON has no infinity: null stands for it."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def describe(path: Path) -> dict[str, Any]:
    """The JSON beside the weights. Raises CheckpointError where it is absent or not one of ours."""
    beside = path.with_suffix(".json")
    try:
        record = read_json(beside)
    except FileNotFoundError:
        raise CheckpointError(
            f"{beside}: no such file; weights come with their description"
        ) from None
    except FormatError as e:
        raise CheckpointError(f"{beside}: not a description of weights: {e.problem}") from e
    except OSError as e:
        raise CheckpointError(f"{beside}: not a description of weights ({e})") from e
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise CheckpointError(f"{beside}: schema is not {SCHEMA}")
    return record


def config_of(path: Path) -> Config:
    """The configuration that the weights were trained with."""
    stated = describe(path).get("config")
    if not isinstance(stated, dict):
        raise CheckpointError(f"{path.with_suffix('.json')}: holds no config")
    try:
        config = Config(**stated)
        _check(config)
        return config
    except (TypeError, ValueError) as e:
        raise CheckpointError(f"{path.with_suffix('.json')}: config does not fit: {e}") from e
    except CheckpointError as e:
        raise CheckpointError(f"{path.with_suffix('.json')}: {e}") from e


def _check(config: Config) -> None:
    """Raises ValueError for a number or a name that no network is built with."""
    hidden, dropout = config.hidden, config.dropout
    if not isinstance(hidden, int) or not 1 <= hidden <= LARGEST_HIDDEN:
        raise ValueError(f"hidden is {hidden!r}, expected 1 to {LARGEST_HIDDEN}")
    if not isinstance(dropout, int | float) or not 0 <= dropout < 1:
        raise ValueError(f"dropout is {dropout!r}, expected 0 to 1")
    if config.normalisation not in get_args(Normalisation):
        raise ValueError(f"normalisation {config.normalisation!r} unknown")
    if not isinstance(config.use_acc, bool):
        raise ValueError(f"use_acc is {config.use_acc!r}, expected true or false")


def _reach(path: Path) -> int | None:
    """`online.reach_frames` of the description (`learned.training.reach`), where it has one."""
    online = describe(path).get("online", {})
    reach = online.get("reach_frames") if isinstance(online, dict) else online
    if reach is not None and (not isinstance(reach, int) or isinstance(reach, bool) or reach < 1):
        raise CheckpointError(
            f"{path.with_suffix('.json')}: online.reach_frames must be a number of frames, got {reach!r}"
        )
    return reach


def load(path: Path, network: str | None = None) -> Model:
    """The model, ready for inference, single precision.

    Raises CheckpointError where the file is absent, corrupt, of another network than `network`, or its
    tensors do not fit its description (names, shapes), or hold what no training leaves: values that are not
    finite, deviations of zero or less, covariances that are none.
    """
    check_regular(path)
    if not path.is_file():
        what = "is a folder; weights are a .safetensors file" if path.is_dir() else "no such file"
        raise CheckpointError(f"{path}: {what}")
    config = config_of(path)
    if network is not None and config.network != network:
        raise CheckpointError(f"{path}: weights of {config.network}, expected {network}")
    try:
        tensors = load_file(path)
    except (SafetensorError, OSError, ValueError) as e:
        raise CheckpointError(f"{path}: not a safetensors file, or cut short ({e})") from e
    named(
        config.specification.model
    )  # imported here: under "meta" its constants would hold no numbers
    # Shapes alone: a description that is wrong may ask for gigabytes.
    with torch.device("meta"):
        expected = {k: tuple(v.shape) for k, v in build(config).state_dict().items()}
    found = {k: tuple(v.shape) for k, v in tensors.items()}
    for name in sorted(expected.keys() | found.keys()):
        if expected.get(name) != found.get(name):
            raise CheckpointError(
                f"{path}: tensor {name} has shape {found.get(name, 'none')}, "
                f"expected {expected.get(name, 'none')}"
            )
        if problem := _problem(name, tensors[name]):
            raise CheckpointError(f"{path}: tensor {name} holds {problem}")
    with torch.random.fork_rng(devices=[]):  # the weights drawn here are overwritten at once
        model = build(config)
    model.load_state_dict({k: v.float() for k, v in tensors.items()})
    model.reach = _reach(path)
    model.requires_grad_(False)
    return model.eval()


def _problem(name: str, x: Tensor) -> str | None:
    """What a tensor of weights holds that it must not, in words."""
    if not x.is_floating_point():
        return f"{x.dtype}, no floats"
    x = x.float()
    if not torch.isfinite(x).all():
        return "values that are not finite"
    if name in POSITIVE and not (x > 0).all():
        return f"{float(x.min()):g}, expected deviations above zero"
    if name == "error_covariance":
        C = x.double()
        if ((C - C.mT).abs() > ROUNDING * C.abs().max()).any():
            return "a matrix that is not symmetric, expected covariances"
        values = torch.linalg.eigvalsh(C)
        if (values[..., 0] < -ROUNDING * values[..., -1].clamp_min(0)).any():
            return f"a matrix with the eigenvalue {float(values.min()):g}, expected covariances"
    return None
