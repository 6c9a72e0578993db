"""Go on training a network on your own calibrated recordings that hold a reference motion.

RECORDING are recordings of any format that the readers know, or folders of them (DIP-IMU's or IMUPoser's
as they are unpacked). The last tenth of them validates, in the order given and in folders by name; of a
single one its last fifth. Sensors are found as by poser track: another one on the same bone stands in, and
imuposer learns the combinations of those of its five places that a recording has.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learned.registry import specification
from mocap.errors import FormatError, PoserError
from poser import estimators, files, licences, options, training, training_files
from poser.console import note, progress

if TYPE_CHECKING:
    from learned.model import Model
    from mocap.recording import Recording

HELP = "fine-tune a network on your own recordings with a reference"
DEFAULTS = {"steps": 2000, "every": 100, "learning_rate": 1e-4, "batch": 16, "patience": 10}
"""A tenth of DIP's rate, so that what was learned before is kept (DIP 5.1.2: no forgetting)."""
NAMED = 5  # recordings that a note names


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("network", choices=training.NETWORKS)
    parser.add_argument(
        "recordings", type=Path, nargs="+", metavar="RECORDING", help="files or folders"
    )
    options.add_output(parser, "FOLDER", "where the run lives, made if missing")
    training.add_run(parser)


def run(args: Namespace) -> int:
    training.check_outputs(args, args.recordings)
    with training.only_run(args):
        return _finetune(args)


def _finetune(args: Namespace) -> int:
    from learned.training import parallel
    from learned.training.corpus import key_of
    from learned.training.recorded import Recorded
    from learned.training.settings import TrainSettings
    from learned.training.trainer import Trainer
    from learned.training.validation import cut_for

    start, origin = _start(args)
    paths = training_files.recordings(args.recordings)
    with progress("reading recordings") as tell:
        found: list[Recording] = []
        worn: list[dict[str, str]] = []
        for k, path in enumerate(paths):
            tell(k / len(paths), path.name)
            recording, places = _recording(path, start)
            found.append(recording)
            worn.append(places)
    _note_places(args.network, worn)
    train, held = _split(paths, found)
    changes = DEFAULTS | training.changes(args)
    settings = TrainSettings.paper(args.network, **(changes | {"config": start.config}))
    _note_short([p.name for p in paths], train, held, settings.frames)
    world = parallel.join(args.device)
    about: dict[str, Any] = {
        "data": {"what": "recordings of the user", "recordings": len(paths), "held_out": len(held)},
        "licence": licences.OF_RECORDINGS,
    }  # fmt: skip
    licences.inherit(about, origin)
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


def _recording(path: Path, model: Model) -> tuple[Recording, dict[str, str]]:
    """A recording of the network's sensors at its rate, and which of the file's serves for which place.

    Refuses one without a reference, one of a single frame, which has no acceleration, and one whose sensors
    do not serve the network.
    """
    from learned.training.recorded import at_rate, placed

    recording = files.recording(path)
    if len(recording) < 2:
        raise FormatError(path, "holds one frame, and at least two are needed to learn from")
    if recording.reference is None:
        raise FormatError(
            path,
            f"holds no reference motion to learn from; poser convert {path} -o WITH.npz --reference MOTION "
            f"puts one in (poser solve makes one from all sensors of a suit)",
        )
    config = model.config
    with files.about(path):
        found = estimators.used(config.network, recording.sensors)
        made = at_rate(placed(recording, found, config.sensors), config.rate_hz)
    return made, _measured(path, made, config.network, found)


def _measured(
    path: Path, recording: Recording, network: str, found: dict[str, str]
) -> dict[str, str]:
    """Those of the sensors that ever measured their orientation, by place: the others are as good as absent.

    Raises FormatError where there is none, and where dip lacks one: a bone that never turns would be learnt
    from in its place.
    """
    alive = {place for k, place in enumerate(recording.sensors) if recording.ori_valid[:, k].any()}
    dead = [sensor for place, sensor in found.items() if place not in alive]
    if len(dead) == len(found):
        raise FormatError(path, f"no orientation in any frame of {', '.join(dead)}")
    if dead and specification(network).needs_all:
        problem = f"no orientation in any frame; {network} learns from all of its sensors"
        raise FormatError(path, problem, f"sensor {', '.join(dead)}")
    return {place: sensor for place, sensor in found.items() if place in alive}


def _note_places(network: str, worn: Sequence[dict[str, str]]) -> None:
    """Says once which sensors stand in for others, and which devices imuposer learns nothing of."""
    for text in dict.fromkeys(t for found in worn for t in estimators.served_words(found)):
        note(text)
    spec = specification(network)
    never = [p for p in spec.places if not any(p in found for found in worn)]
    if not spec.needs_all and never:
        note(f"no recording has {', '.join(never)}: combinations with them are not trained")


def _note_short(
    names: Sequence[str], train: Sequence[Recording], held: Sequence[Recording], frames: int
) -> None:
    """Says which recordings are too short for a window: to train on, or to tell much when they validate.

    names: of the files, in the order of the recordings, `train` first; of a single one both are parts.
    """
    short = [n for n, r in zip(names, train, strict=False) if len(r) < frames]
    if short:
        note(f"shorter than a window of {frames} frames and not trained on: {_some(short)}")
    few = [
        f"{n} ({len(r)})" for n, r in zip(names[-len(held) :], held, strict=True) if len(r) < frames
    ]
    if few:
        note(
            f"fewer frames to validate on than a window's {frames}, which tells little: {_some(few)}"
        )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _split(
    paths: Sequence[Path], found: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """(training, validation): the last tenth of the recordings, or the last fifth of a single one."""
    if len(found) == 1:
        cut = int(0.8 * len(found[0]))
        if cut == 0:
            raise FormatError(
                paths[0],
                f"at {found[0].rate_hz:g} Hz it is one frame, which cannot both train and validate",
            )
        note(
            f"validation: {paths[0].name} from {found[0].start_s + cut / found[0].rate_hz:.1f} s on"
        )
        return [found[0].slice(0, cut)], [found[0].slice(cut, len(found[0]))]
    last = max(1, round(0.1 * len(found)))
    note(f"validation: {', '.join(p.name for p in paths[-last:])}")
    return list(found[:-last]), list(found[-last:])
