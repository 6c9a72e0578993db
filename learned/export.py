"""A finished run as weights to ship: deviations calibrated, half precision, description, model card."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from learned import checkpoint, deviations
from learned.reach import measured
from learned.validation import Windowed, score
from mocap.formats._files import write_aside

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
    `learned.deviations.calibrate`), and the figures are those of the halved weights, as they will be loaded.
    Returns the description.
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
    figures: dict[str, Any] = score(model, windows) | {"windows": len(windows.clip)}
    checkpoint.save(model, target, known | about | {"validation": figures} | online, half=True)
    written = checkpoint.describe(target)
    with write_aside(target.with_suffix(".md")) as aside:
        aside.write_text(card(target.name, written), encoding="utf-8")
    return written


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
    lines = [
        f"# {name}",
        "",
        f"{network} ({config['architecture']}, {config['hidden']} units), {config['rate_hz']:g} Hz, "
        f"sensors in this order: {', '.join(config['sensors'])}.",
        "",
        "Use: body poses from body-worn inertial sensors, offline or live. Not meant for medical or safety "
        "decisions.",
        "",
        "## Training",
        "",
        f"- data: {data.get('what', 'not stated')}",
        f"- credit: {data.get('credit', 'not stated')}",
        f"- licence of these weights: {record.get('licence', 'not stated')}",
        f"- {training.get('batch', '?')} windows of {training.get('frames', '?')} frames a step, Adam at "
        f"{training.get('learning_rate', '?')}, seed {training.get('seed', '?')}",
        "",
        "## Validation",
        "",
        "On motions that were not trained on, virtual sensors with the realistic noise unless the data say "
        "otherwise; root, wrists and feet masked as the field does it. Computed in single precision from "
        "these half-precision matrices.",
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
