"""What `poser train` and `poser finetune` share: options, a run with its progress, the log drawn."""

from __future__ import annotations

import json
import os
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import learned
from mocap.errors import PoserError
from poser import files, options
from poser.console import (
    DONE,
    INTERRUPTED,
    Progress,
    UsageError,
    complain,
    emit,
    note,
    progress,
    say,
    tell_notes,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from learned.training.trainer import Trainer
    from learned.training.validation import Windowed

NETWORKS = tuple(learned.NETWORKS)


def count(text: str) -> int:
    """An integer of one or more."""
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} is not an integer of one or more")
    return int(text)


def share(text: str) -> float:
    """A share: above 0, at most 1."""
    value = options.positive(text)
    if value > 1:
        raise ArgumentTypeError(f"{text!r} is not a share of at most 1")
    return value


def part_of_run(text: str) -> float:
    """A share of a run's end: 0 or more, under 1."""
    value = options.number(text)
    if not 0 <= value < 1:
        raise ArgumentTypeError(f"{text!r} is not 0 or more and under 1")
    return value


def add_run(parser: ArgumentParser) -> None:
    """Options of any run: how long, how fast, where, what to leave behind."""
    run = parser.add_argument_group("the run")
    run.add_argument("--steps", type=count, metavar="N", help="optimizer steps, at most")
    run.add_argument(
        "--minutes", type=options.positive, metavar="M",
        help="minutes of training, at most; without --steps the clock alone decides",
    )  # fmt: skip
    run.add_argument("--batch", type=count, metavar="N", help="windows per step")
    run.add_argument("--frames", type=count, metavar="N", help="frames of a window")
    run.add_argument(
        "--rate", dest="speed", type=options.positive, metavar="X", help="learning rate"
    )
    run.add_argument(
        "--cooldown", type=part_of_run, metavar="X",
        help="the last share of the run over which the rate falls to zero (default: 0)",
    )  # fmt: skip
    run.add_argument("--every", type=count, metavar="N", help="steps between validations")
    run.add_argument("--seed", type=options.seed, default=0, metavar="N", help="default: 0")
    run.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default: cpu")
    run.add_argument(
        "--precision", choices=("auto", "float32"), default="auto",
        help="of the products: auto is bfloat16 where that is faster, which is measured (default: auto)",
    )  # fmt: skip
    run.add_argument(
        "--resume", action="store_true",
        help="fail where FOLDER holds no run (without this a run there goes on, else one begins)",
    )  # fmt: skip
    run.add_argument(
        "--start",
        type=options.weights,
        metavar="WEIGHTS",
        help="begin with these weights (.safetensors)",
    )
    left = parser.add_argument_group("what is left besides FOLDER")
    left.add_argument(
        "--export", type=Path, metavar="FILE.safetensors",
        help="the best weights in half precision, with description and model card beside them",
    )  # fmt: skip
    left.add_argument("--plot", type=Path, metavar="PNG", help="the run's log as a picture")
    options.add_json(parser)


def changes(args: Namespace) -> dict[str, Any]:
    """Settings that the options state, under the names of `TrainSettings`; minutes alone lift the limit
    of steps.
    """
    names = {
        "steps": "steps", "minutes": "minutes", "batch": "batch", "frames": "frames",
        "speed": "learning_rate", "cooldown": "cooldown", "every": "every", "seed": "seed",
    }  # fmt: skip
    stated = {field: getattr(args, option) for option, field in names.items()}
    found = {field: value for field, value in stated.items() if value is not None}
    if args.precision == "float32":
        found["bfloat16"] = False
    return {"steps": None} | found if "minutes" in found else found


def check_hidden(args: Namespace) -> None:
    """Raises UsageError where --hidden says how wide layers are that have widths of their own."""
    from learned import specification

    if args.hidden and args.architecture in specification(args.network).fixed_widths:
        raise UsageError(f"argument --hidden: not with --architecture {args.architecture}")


def check_outputs(args: Namespace, inputs: Sequence[Path]) -> None:
    """Before any work: can everything be written, and is nothing written over what the run itself keeps?

    Of several processes (torchrun) only the first writes.
    """
    if not _first():
        return
    if args.export:
        files.check_output(args.export, [*inputs, *filter(None, [args.start])], (".safetensors",))
        _check_export(args.export, args.output)
        _check_companions(args.export)
    if args.plot:
        files.check_output(args.plot, inputs, (".png",))
    files.make_folder(args.output)
    if args.resume and not (args.output / "state.pt").exists():
        raise PoserError(f"{args.output}: holds no run to resume")


def _first() -> bool:
    """Whether this is the first process or the only one, before any of torch is imported."""
    return int(os.environ.get("WORLD_SIZE", "1")) == 1 or os.environ.get("RANK", "0") == "0"


def _check_export(export: Path, folder: Path) -> None:
    """Raises UsageError where an export would write over a file of the run."""
    from learned.training.run_folder import RunFolder

    own = {path.resolve() for path in RunFolder(folder).files}
    for path in (export, *(export.with_suffix(s) for s in (".json", ".md"))):
        if path.resolve() in own:
            raise UsageError(
                f"{export}: the run keeps its own {path.name} there; export under another name"
            )


def _check_companions(export: Path) -> None:
    """Raises PoserError where NAME.json or NAME.md beside an export is somebody else's: both are written."""
    from learned import checkpoint

    beside = export.with_suffix(".json")
    if beside.exists():
        try:
            checkpoint.describe(export)
        except PoserError as e:
            raise PoserError(
                f"{beside}: is no description of weights and would be overwritten; export under another name"
            ) from e
    elif export.with_suffix(".md").exists():
        raise PoserError(
            f"{export.with_suffix('.md')}: is not of these weights and would be overwritten; export under "
            f"another name"
        )


@contextmanager
def only_run(args: Namespace) -> Iterator[None]:
    """The run's folder is held while the block runs: a second training in it would mix two.

    Of several processes (torchrun) the first holds it. Raises PoserError where another holds it.
    """
    from mocap.formats._files import alone

    if not _first():
        yield
        return
    with alone(args.output):
        yield


def execute(
    trainer: Trainer,
    windows: Windowed,
    args: Namespace,
    extra: dict[str, Any],
    trained: Callable[[], Windowed],
) -> int:
    """Run, export, draw, report. Ctrl-C leaves a state to go on from and gives 130.

    Of several processes only the first says anything, its notes included. trained: cuts windows of what is
    learnt from, for an export's error covariance.
    """
    first = trainer.world.first
    begun = trainer.step
    if trainer.earlier:
        names = ", ".join(p.name for p in trainer.earlier)
        note(f"{args.output}: an earlier run there left no state to go on from; kept as {names}")
    if not first:
        tell_notes(keep=False)
    elif not args.json:
        where = f"goes on at step {begun}" if begun else "begins"
        say(f"{args.output}: {where}, {_precision(trainer)}")
    try:
        with bar(f"training {trainer.settings.config.network}", first) as tell:
            best = trainer.run(_Told(trainer, tell, args.json or not first))
    except KeyboardInterrupt:
        if first:
            complain(
                f"interrupted after step {trainer.step}; the same command goes on from there",
                f"poser {args.command}",
            )
        return INTERRUPTED
    finally:
        trainer.world.leave()
    if not first:
        return DONE
    log = read_log(args.output)
    if args.plot:
        from poser.report import pictures

        pictures.save(draw_log(log), args.plot)
    from learned import checkpoint

    record: dict[str, Any] = {
        "network": trainer.settings.config.network, "folder": str(args.output), "weights": str(best),
        "step": trainer.step, "begun_at_step": begun, "seconds": trainer.seconds,
        "precision": trainer.precision,
        "stopped": "no better for long" if trainer.stale() else "done",
        "validation": checkpoint.describe(best)["validation"], "settings": trainer.settings.to_json(),
    } | extra  # fmt: skip
    if args.export:
        from learned.training.export import export

        with progress(f"exporting {args.export.name}"):
            written = export(best, args.export, windows, {}, trained())
        record |= {"exported": str(args.export), "exported_validation": written["validation"]}
    if args.json:
        emit(record)
    else:
        say(f"{best}: {_figures(record['validation'])}, step {record['validation']['step']}")
        if args.export:
            say(f"{args.export}: {_figures(record['exported_validation'])}, half precision")
    return DONE


def bar(words: str, shown: bool) -> AbstractContextManager[Progress]:
    """`console.progress`, or nothing: of several processes one shows it."""
    return progress(words) if shown else nullcontext(lambda fraction, text: None)


def _precision(trainer: Trainer) -> str:
    """How it computes, and where that was not the user's choice how he chooses."""
    if trainer.precision == "bfloat16":
        return "in bfloat16, which is faster here (--precision float32: without)"
    why = ": bfloat16 is not faster here" if trainer.settings.bfloat16 else ""
    return f"in float32{why}"


class _Told:
    """Progress rows of a trainer as a bar, and each validation as a line."""

    def __init__(self, trainer: Trainer, tell: Any, quiet: bool) -> None:
        self.trainer, self.tell, self.quiet = trainer, tell, quiet

    def __call__(self, row: dict[str, Any]) -> None:
        done, seconds = row["done"], self.trainer.seconds
        left = seconds * (1 - done) / done if 0 < done < 1 else 0.0
        loss = row.get("loss", row.get("training_loss"))
        self.tell(done, f"step {row['step']}, loss {loss:.3f}, {_minutes(left)} left")
        if "validation_loss" in row and not self.quiet:
            say(f"step {row['step']}: loss {loss:.3f}, {_figures(row)}, {_minutes(left)} left")


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"


def _figures(row: dict[str, Any]) -> str:
    """`validation sip 12.3 deg, angular 10.1 deg, ...` of a log row or a description."""
    get = {k.removeprefix("validation_"): v for k, v in row.items()}
    return (
        f"validation sip {get['sip_deg']:.1f} deg, angular {get['angular_deg']:.1f} deg, "
        f"position {get['position_cm']:.1f} cm, loss {get['loss']:.3f}"
    )


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The rows of a run's log, one a validation."""
    from mocap.formats._files import read_text

    path = folder / "log.jsonl"
    if not path.exists():
        return []
    return [json.loads(line) for line in read_text(path).splitlines() if line.endswith("}")]


def draw_log(log: Sequence[dict[str, Any]]) -> Figure:
    """Losses, angles, distance and rate over the steps."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7))
    axes = figure.subplots(2, 2, sharex=True)
    steps = [r["step"] for r in log]
    for axis, label, names in _panels(axes):
        for name in names:
            words = name.replace("_", " ")
            axis.plot(steps, [r[name] for r in log], ".-", lw=1.3, label=words)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8, loc="upper right", frameon=False)
    for axis in axes[1]:
        axis.set_xlabel("step")
    figure.tight_layout()
    return figure


def _panels(axes: Any) -> Iterator[tuple[Any, str, tuple[str, ...]]]:
    yield axes[0, 0], "loss", ("training_loss", "validation_loss")
    yield axes[0, 1], "deg", ("validation_sip_deg", "validation_angular_deg")
    yield axes[1, 0], "cm", ("validation_position_cm",)
    yield axes[1, 1], "learning rate", ("rate",)
