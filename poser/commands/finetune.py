"""Go on training a network on your own calibrated recordings that hold a reference motion.

RECORDING are recordings of any format that the readers know, or folders of them (DIP-IMU's or IMUPoser's
as they are unpacked). The last tenth of them validates, in the order given and in folders by name; of a
single one its last fifth.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mocap.errors import FormatError, PoserError
from poser import files, options, training, training_files
from poser.console import note, progress

if TYPE_CHECKING:
    from learned.models import Model
    from mocap.recording import Recording

HELP = "fine-tune a network on your own recordings with a reference"
DEFAULTS = {"steps": 2000, "every": 100, "learning_rate": 1e-4, "batch": 16, "patience": 10}
"""A tenth of DIP's rate, so that what was learned before is kept (DIP 5.1.2: no forgetting)."""
FRAMES = {"dip": 60, "imuposer": 125}


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("network", choices=training.NETWORKS)
    parser.add_argument(
        "recordings", type=Path, nargs="+", metavar="RECORDING", help="files or folders"
    )
    options.add_output(parser, "FOLDER", "where the run lives, made if missing")
    training.add_run(parser)


def run(args: Namespace) -> int:
    training.check_outputs(args, args.recordings)
    from learned import parallel
    from learned.corpus import key_of
    from learned.recorded import Recorded
    from learned.settings import TrainSettings
    from learned.train import Trainer
    from learned.validation import cut_for

    start, origin = _start(args)
    paths = training_files.recordings(args.recordings)
    with progress("reading recordings") as tell:
        found = []
        for k, path in enumerate(paths):
            tell(k / len(paths), path.name)
            found.append(_recording(path, start))
    train, held = _split(paths, found)
    changes = DEFAULTS | {"frames": FRAMES[args.network]} | training.changes(args)
    settings = TrainSettings.paper(args.network, **(changes | {"config": start.config}))
    world = parallel.join(args.device)
    about = {
        "data": {"what": "recordings of the user", "recordings": len(paths), "held_out": len(held)},
        "started_from": str(origin.name),
    }  # fmt: skip
    windows = cut_for(args.network, held)
    trainer = Trainer(
        settings, Recorded(train, settings.frames, world.device), windows, args.output, about, start,
        world, key_of(paths),
    )  # fmt: skip
    return training.execute(trainer, windows, args, about, lambda: cut_for(args.network, train))


def _start(args: Namespace) -> tuple[Model, Path]:
    """The weights to go on from: --start, else those that are shipped."""
    from learned import checkpoint

    path = args.start or checkpoint.shipped(args.network)
    if not args.start and not path.exists():
        raise PoserError(
            f"no weights of {args.network} come with this installation; give some with --start"
        )
    return checkpoint.load(path, args.network), path


def _recording(path: Path, model: Model) -> Recording:
    """A recording of the network's sensors at its rate. Refuses one without a reference."""
    from learned.recorded import at_rate

    recording = files.recording(path)
    if recording.reference is None:
        raise FormatError(
            path,
            "holds no reference motion to learn from; poser solve makes one from all sensors of a suit",
        )
    with files.about(path):
        return at_rate(recording.select(model.config.sensors), model.config.rate_hz)


def _split(
    paths: Sequence[Path], found: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """(training, validation): the last tenth of the recordings, or the last fifth of a single one."""
    if len(found) == 1:
        cut = int(0.8 * len(found[0]))
        note(
            f"validation: {paths[0].name} from {found[0].start_s + cut / found[0].rate_hz:.1f} s on"
        )
        return [found[0].slice(0, cut)], [found[0].slice(cut, len(found[0]))]
    last = max(1, round(0.1 * len(found)))
    note(f"validation: {', '.join(p.name for p in paths[-last:])}")
    return list(found[:-last]), list(found[-last:])
