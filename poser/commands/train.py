"""Train DIP or IMUPoser on motion capture: virtual sensors are put on the motions as it goes.

MOTION are files of any motion format, or folders that are searched in all their depth (AMASS as it is
unpacked; files there that cannot be read are left out, with a note); without any, the project's own
training clips from the cache folder (--collections). FOLDER holds the run: it can be interrupted, and the
same command goes on. Several GPUs or processes: torchrun -m poser train ...
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.errors import PoserError
from poser import licences, options, training, training_files
from poser import training_collections as collections
from poser.console import UsageError, note, part, progress

if TYPE_CHECKING:
    from learned.training.corpus import Corpus
    from learned.training.settings import TrainSettings
    from learned.training.validation import Windowed
    from mocap.dataset import Clip
    from poser.console import Progress

HELP = "train a network on motion capture"
# Validation files that windows are cut from: each is up to 15 s of recording in memory (2 MB), and every
# tenth of AMASS are 1,500.
VALIDATED = 400


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("network", choices=training.NETWORKS)
    parser.add_argument(
        "motions", type=Path, nargs="*", default=[], metavar="MOTION", help="files or folders"
    )
    options.stand_behind(parser, "motions")
    options.add_output(parser, "FOLDER", "where the run lives, made if missing")
    parser.add_argument(
        "--validation", type=Path, nargs="+", default=[], metavar="MOTION",
        help="motions to validate on (default: every tenth of MOTION by name)",
    )  # fmt: skip
    parser.add_argument(
        "--collections", nargs="+", choices=tuple(collections.SHARES),
        help="without MOTION: which of the project's collections to train on (default: cmu; weights "
        "trained on bandai are for non-commercial use; generated: motion drawn at random, beside another)",
    )  # fmt: skip
    parser.add_argument(
        "--share", type=training.share, default=1.0, metavar="X",
        help="train on this share of the clips only (default: 1)",
    )  # fmt: skip
    parser.add_argument(
        "--no-splice", action="store_true", help="never the legs of one clip under the trunk of another"
    )  # fmt: skip
    what = parser.add_argument_group("the network (DIP's experiments)")
    what.add_argument(
        "--architecture", choices=("birnn", "rnn", "feedforward", "wavenet"), help="default: birnn"
    )
    what.add_argument("--hidden", type=training.count, metavar="N", help="units (default: 512)")
    what.add_argument(
        "--normalisation",
        choices=("root", "first", "heading"),
        help="of DIP's input; default: root",
    )
    what.add_argument(
        "--no-acc", action="store_true", help="DIP without accelerations, neither as input nor reconstructed"
    )  # fmt: skip
    what.add_argument("--no-acc-loss", action="store_true", help="DIP without reconstructing them")
    what.add_argument("--no-dropout", action="store_true", help="no dropout on the input")
    training.add_run(parser)


def run(args: Namespace) -> int:
    settings = _settings(args)
    training.check_outputs(args, [*args.motions, *args.validation])
    with training.only_run(args):
        return _train(args, settings)


def _train(args: Namespace, settings: TrainSettings) -> int:
    from learned import checkpoint
    from learned.training import parallel
    from learned.training.trainer import Trainer
    from learned.training.virtual_windows import Windows

    start = None
    if args.start:
        start = checkpoint.load(args.start, args.network)
        if start.config != settings.config:
            raise PoserError(f"{args.start}: holds another network than these options describe")
    with progress("reading motions") as tell:
        corpus, validation, about = _data(args, tell)
    if args.share < 1:
        corpus = corpus.subset(args.share, settings.seed)
        about |= {"clips": len(corpus.names), "minutes": round(corpus.seconds / 60, 1)}
    learnt = _learnt(args, corpus.names)
    world = parallel.join(args.device)
    config = settings.config
    windows = Windows(
        corpus, config.sensors, config.rate_hz, settings.frames, settings.augmentation, world.device
    )
    del corpus  # as much memory as the windows' splines; nothing else reads it
    key = f"{about['key']} {args.share:g}"
    record: dict[str, Any] = {"data": about, "licence": _own_licence(args)}
    if args.start:
        licences.inherit(record, args.start)
    # Scalers, and which precision is faster: half a minute on a busy machine.
    with training.bar("preparing", world.first):
        trainer = Trainer(settings, windows, validation, args.output, record, start, world, key)
    return training.execute(
        trainer,
        validation,
        args,
        record,
        lambda: collections.windows(args.network, collections.evenly(learnt)),
    )


def _settings(args: Namespace) -> TrainSettings:
    """Settings of the options. Raises UsageError where one does not concern the network."""
    from learned.config import for_network
    from learned.registry import NETWORKS, specification
    from learned.training.augmentation import Augmentation
    from learned.training.settings import TrainSettings

    for name in ("architecture", "normalisation", "no_acc", "no_acc_loss"):
        if getattr(args, name) and name not in specification(args.network).experiments:
            its = ", ".join(n for n, s in NETWORKS.items() if name in s.experiments)
            raise UsageError(f"argument --{name.replace('_', '-')}: for {its} only")
    training.check_hidden(args)
    config: dict[str, Any] = {}
    for name in ("architecture", "hidden", "normalisation"):
        if getattr(args, name):
            config[name] = getattr(args, name)
    if args.no_acc:
        config["use_acc"] = False
    if args.no_dropout:
        config["dropout"] = 0.0
    changes = training.changes(args) | {"config": for_network(args.network, **config)}
    if args.no_splice:
        changes["augmentation"] = Augmentation(splice=0.0)
    # The loss keeps the network from dropping accelerations of its input (3.4.2): none are there.
    acc = not (args.no_acc or args.no_acc_loss)
    return TrainSettings.paper(args.network, reconstruct_acc=acc, **changes)


def _data(args: Namespace, tell: Progress) -> tuple[Corpus, Windowed, dict[str, Any]]:
    """The training corpus, the validation windows, and what all is made of."""
    if not args.motions:
        if args.validation:
            raise UsageError("argument --validation: needs MOTION to train on")
        return collections.own_split(args.network, _collections(args), tell)
    if args.collections:
        raise UsageError("argument --collections: not with MOTION")
    from learned.training import corpus

    train = training_files.motions(args.motions)
    held = training_files.motions(args.validation) if args.validation else []
    training_files.check_apart(train, held)
    forward = part(tell, 0.0, 0.9)
    left_out = training_files.LeftOut([*args.motions, *args.validation])
    found = corpus.frames(
        train, lambda i, n: forward(i / n, f"reading {i} of {n} motions"), left_out
    )
    train, held = list(found), list(corpus.frames(held, unreadable=left_out))
    left_out.tell()
    if not args.validation:  # of those that can be read: the only one may be one that cannot
        train, held = training_files.held_out(train)
        names = ", ".join(p.stem for p in held[:5]) + (", ..." if len(held) > 5 else "")
        note(f"validation: every tenth motion by name, {len(held)} of them ({names})")
    seen = held[:: max(1, math.ceil(len(held) / VALIDATED))]
    if len(seen) < len(held):
        note(f"validation: windows of {len(seen)} of the {len(held)} motions, evenly by name")
    clips = corpus.cached({p: found[p] for p in train})
    about = {
        "what": "motions of the user", "key": corpus.key_of(train), "clips": len(clips.names),
        "minutes": round(clips.seconds / 60, 1), "validation_clips": len(seen),
    }  # fmt: skip
    if left_out.errors:
        about["left_out"] = len(left_out.errors)
    return clips, collections.windows(args.network, seen), about


def _own_licence(args: Namespace) -> str:
    """Of weights trained on these motions alone."""
    if args.motions:
        return licences.OF_MOTIONS
    return collections.licence(_collections(args))


def _collections(args: Namespace) -> tuple[str, ...]:
    """The project's collections to train on where no motions are given."""
    return tuple(dict.fromkeys(args.collections or ("cmu",)))


def _learnt(args: Namespace, names: Sequence[str]) -> Sequence[Path | Clip]:
    """The files of a corpus, as they are to be read."""
    if args.motions:
        return [Path(name) for name in names]
    return collections.learnt(names, _collections(args))
