"""A finished run as weights to ship: deviations calibrated, half precision, description, model card."""

from __future__ import annotations

import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from learned import checkpoint
from learned.models import FIXED_WIDTHS
from learned.training import deviations
from learned.training.reach import measured
from learned.training.validation import Windowed, score
from mocap.formats._files import write_aside

SKELETON = "the neutral mean SMPL shape of mocap.skeleton"
"""Whose bone lengths joint positions are computed with, those of the loss and of the figures."""
ROOT = Path(__file__).parents[1]
PRECISION_ONLINE = (
    "Online (`poser track`, `live`, `compare`) the LSTM layers run in int8 where the machine has the "
    "kernels, else in single precision; `python benchmarks/networks.py` measures what that changes, in "
    "degrees."
)


def export(
    best: Path,
    target: Path,
    windows: Windowed,
    about: dict[str, Any],
    trained: Windowed | None = None,
) -> dict[str, Any]:
    """Write `target` (.safetensors), its .json and its .md from a run's best weights.

    Deviations are fitted on the validation windows (and on `trained`, those of motion that was learnt from:
    `training.deviations.calibrate`), and the figures are those of the halved weights, as they will be loaded;
    the loss among them counts what the run's loss did. Returns the description.
    """
    model = checkpoint.load(best)
    record = checkpoint.describe(best)
    with torch.no_grad():
        for name, value in model.state_dict().items():
            if value.ndim > 1 and name.startswith("net."):
                value.copy_(value.half().float())
    deviations.calibrate(model, windows, trained)
    known = {k: v for k, v in record.items() if k not in ("schema", "config", "validation")}
    online = {"online": measured(model, windows)}
    # Without it in training nothing taught the heads of the accelerations.
    reconstruct_acc = record.get("training", {}).get("reconstruct_acc", True)
    figures: dict[str, Any] = score(model, windows, reconstruct_acc)
    figures |= {"windows": len(windows.clip)}
    found = {"validation": figures} | online | made_with()
    checkpoint.save(model, target, known | about | found, half=True)
    written = checkpoint.describe(target)
    with write_aside(target.with_suffix(".md")) as aside:
        aside.write_text(card(target.name, written), encoding="utf-8")
    return written


def made_with(root: Path = ROOT) -> dict[str, str]:
    """Skeleton and version of this package, and git revision where it lies in a checkout of its own.

    root: the folder of the packages. `-dirty` after the revision: files were changed since.
    """
    made = {"skeleton": SKELETON}
    with suppress(PackageNotFoundError):  # a copy that was never installed
        made["version"] = version("poser-imu")
    if not (root / ".git").exists():  # else a checkout around an installation would answer
        return made
    words = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        said = subprocess.run(words, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return made
    return made | {"revision": said.stdout.strip()}


def _made(record: dict[str, Any]) -> list[str]:
    """What `made_with` found, as lines of the card; older descriptions lack some of it."""
    named = (("poser-imu", "version"), ("revision", "revision"))
    made = ", ".join(f"{word} {record[key]}" for word, key in named if key in record)
    return [f"- skeleton: {record.get('skeleton', 'not stated')}"] + (
        [f"- made with: {made}"] if made else []
    )


def _validated_on(data: dict[str, Any]) -> str:
    """What the figures are of, in words."""
    if "held_out" in data:  # `poser finetune`
        held, of = data["held_out"], data.get("recordings", "?")
        if of == 1:
            return "On the last fifth of the user's recording, which was not trained on"
        return f"On {held} of the user's {of} recordings, which were not trained on"
    which = data.get("validation") or data.get("validation_clips")
    named = f" ({which})" if isinstance(which, str) else ""
    count = f"{which} " if isinstance(which, int) else ""
    motions = f"{count}motions that were not trained on{named}"
    return f"On {motions}, virtual sensors with the realistic noise"


def _reach(online: dict[str, Any]) -> list[str]:
    """What the runtime leaves out, in words."""
    if "reach_frames" not in online:
        return []
    return [
        f"Layer 2 then begins {online['reach_frames']} frames from the emitted one, which turns the "
        f"worst joint by {online['reach_mean_deg']:.2f} deg in the mean of validation windows, "
        f"{online['reach_worst_deg']:.1f} at most."
    ]


def card(name: str, record: dict[str, Any]) -> str:
    """The model card of a description, in Markdown."""
    config, figures = record["config"], record.get("validation", {})
    network = "IMUPoser" if config["architecture"] == "imuposer" else "DIP"
    training = record.get("training", {})
    data = record.get("data", {})
    sized = config["architecture"] not in FIXED_WIDTHS
    units = f", {config['hidden']} units" if sized else ""
    precision = f", {record['precision']}" if "precision" in record else ""
    lines = [
        f"# {name}",
        "",
        f"{network} ({config['architecture']}{units}), {config['rate_hz']:g} Hz, "
        f"sensors in this order: {', '.join(config['sensors'])}.",
        "",
        "Use: body poses from body-worn inertial sensors, offline or live. Not meant for medical or safety "
        "decisions.",
        "",
        "## Training",
        "",
        f"- data: {data.get('what', 'not stated')}",
        f"- credit: {data.get('credit', 'not stated')}",
        *([f"- begun with: {record['started_from']}"] if "started_from" in record else []),
        f"- licence of these weights: {record.get('licence', 'not stated')}",
        f"- {training.get('batch', '?')} windows of {training.get('frames', '?')} frames a step, Adam at "
        f"{training.get('learning_rate', '?')}, seed {training.get('seed', '?')}{precision}",
        *_made(record),
        "",
        "## Validation",
        "",
        f"{_validated_on(data)}; root, wrists and feet masked as the field does it. Computed in single "
        "precision from these half-precision matrices.",
        "",
        PRECISION_ONLINE,
        *_reach(record.get("online", {})),
        "",
        "| figure | value |",
        "|---|---|",
        *(f"| {key} | {value:.2f} |" for key, value in figures.items() if isinstance(value, float)),
    ]
    test = record.get("test", {})
    if test:
        lines += [
            "",
            "## Test",
            "",
            f"{test.get('what', 'not stated')}",
            "",
            "| figure | value |",
            "|---|---|",
        ]
        lines += [
            f"| {key} | {value:.2f} |" for key, value in test.items() if isinstance(value, float)
        ]
    if record.get("failures"):
        lines += ["", "## Known failures", "", *(f"- {text}" for text in record["failures"])]
    return "\n".join(lines) + "\n"
