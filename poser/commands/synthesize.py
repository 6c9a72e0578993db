"""Virtual sensors on motions: one recording a motion, DIR/<motion's stem>.npz.

MOTION are files of any motion format, or folders that are searched for them in all their depth.
The noise of a file depends on the seed and on the file's name alone, so that neither the order nor
the number of the motions changes it.
"""

from __future__ import annotations

import zlib
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mocap.errors import PoserError
from poser import files, options, training_files
from poser.console import DONE, FAILED, UsageError, complain, emit, note, progress, say

if TYPE_CHECKING:
    import numpy as np

    from mocap.motion import Motion
    from mocap.recording import RawRecording, Recording

HELP = "virtual sensors on motion capture"
STATIC_S = 3.0


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("motions", type=Path, nargs="+", metavar="MOTION", help="files or folders")
    options.add_output(parser, "DIR", "folder of the recordings, made if missing")
    parser.add_argument(
        "--sensors", default="six", metavar="S", help=f"{options.SENSORS_HELP} (default: six)"
    )
    parser.add_argument(
        "--noise", choices=("none", "realistic"), default="none", help="default: none"
    )
    parser.add_argument(
        "--rate", dest="out_rate", type=options.rate, default=60.0, metavar="HZ", help="default: 60"
    )
    parser.add_argument(
        "--lowpass",
        type=options.cutoff,
        default=8.0,
        metavar="HZ|none",
        help="cut-off of the filter on the motion before it is differentiated (default: 8)",
    )
    parser.add_argument("--seed", type=options.seed, default=0, metavar="N", help="default: 0")
    parser.add_argument(
        "--raw", action="store_true", help="sensors' own frames, gravity in, not calibrated"
    )
    parser.add_argument(
        "--static-pose", choices=("n", "t"), help="stand still in this pose first, for calibration"
    )
    parser.add_argument(
        "--static-seconds",
        type=options.positive,
        metavar="S",
        help=f"default: {STATIC_S:g}",
    )
    options.add_reading(parser, rate_too=False)
    options.add_json(parser)


def run(args: Namespace) -> int:
    if args.static_seconds is not None and args.static_pose is None:
        raise UsageError("argument --static-seconds: of no use without --static-pose")
    with files.folder(args.output):
        return _synthesize(args)


def _synthesize(args: Namespace) -> int:
    sensors = options.sensors(args.sensors)
    sources = _sources(args.motions)
    targets = _targets(sources, args.output)
    done, failed = [], False
    with progress("synthesizing") as tell:
        for k, (source, target) in enumerate(zip(sources, targets, strict=True)):
            tell(k / len(targets), source.name)
            try:
                made = _one(source, sensors, args)
                files.write(target, made)
            except PoserError as e:
                # The others are still worth having; the exit status tells.
                if args.debug:
                    raise
                complain(str(e), "poser synthesize")
                failed = True
                continue
            done.append((source, target, made))
    if args.json:
        emit({"files": [_record(*d, args.seed) for d in done]})
    else:
        for _, target, made in done:
            say(f"{target}: {len(made)} frames at {made.rate_hz:g} Hz, {len(sensors)} sensors")
    return FAILED if failed else DONE


def _sources(given: Sequence[Path]) -> list[Path]:
    """The motions: files as they are, whether they can be read or not, and those in folders."""
    found = []
    for path in given:
        found += training_files.motions([path]) if path.is_dir() else [path]
    return list({path.resolve(): path for path in reversed(found)}.values())[::-1]


def noise_generator(seed: int, stem: str) -> np.random.Generator:
    """The generator of a file's noise: of the seed and the CRC-32 of the file's stem."""
    import numpy as np

    return np.random.default_rng([seed, zlib.crc32(stem.encode("utf-8", "surrogateescape"))])


def _targets(motions: Sequence[Path], folder: Path) -> list[Path]:
    """Where each recording goes; raises UsageError where two would go to one place or onto an input."""
    first: dict[str, Path] = {}
    for path in motions:
        if path.stem in first:
            raise UsageError(
                f"{first[path.stem]} and {path} would both be written to {path.stem}.npz; "
                f"synthesize them into different folders"
            )
        first[path.stem] = path
    targets = [folder / f"{p.stem}.npz" for p in motions]
    if folder.is_dir():
        # Looked up, not compared each with each: folders hold thousands.
        own = {_identity(path): path for path in motions}
        for target in targets:
            same = own.get(_identity(target)) if target.exists() else None
            files.check_output(target, [same] if same else [], (".npz",))
    return targets


def _identity(path: Path) -> tuple[int, int] | Path:
    """What the names of one file have in common."""
    try:
        found = path.stat()
    except OSError:
        return path
    return found.st_dev, found.st_ino


def _one(source: Path, sensors: tuple[str, ...], args: Namespace) -> Recording | RawRecording:
    from mocap import synthesis
    from mocap.synthesis.staging import with_static_pose

    motion = files.motion(source, options.reading(args), quiet=True)
    with files.about(source):
        if args.static_pose:
            motion = with_static_pose(motion, args.static_pose, args.static_seconds or STATIC_S)
        _check_rates(source, motion, args.out_rate, args.lowpass)
        motion = synthesis.prepare(motion, args.out_rate, args.lowpass)
        if len(motion) < 3:
            raise PoserError(f"{len(motion)} frames at {args.out_rate:g} Hz, expected 3 or more")
        make = synthesis.raw_recording if args.raw else synthesis.recording
        noise = synthesis.NOISES[args.noise]
        made = make(motion, sensors, noise, noise_generator(args.seed, source.stem))
        return replace(made, start_s=motion.start_s)


def _check_rates(source: Path, motion: Motion, rate: float, lowpass: float | None) -> None:
    """Accelerations of frames that were interpolated are not those of the motion."""
    if rate > 1.01 * motion.rate_hz:
        note(
            f"{source}: {motion.rate_hz:g} Hz interpolated to {rate:g} Hz: accelerations between "
            f"its frames are not the motion's; --rate {motion.rate_hz:g} avoids that"
        )
    if lowpass is not None and lowpass >= motion.rate_hz / 2:
        note(f"{source}: {motion.rate_hz:g} Hz is too slow for a low-pass at {lowpass:g} Hz: none")


def _record(
    source: Path, target: Path, made: Recording | RawRecording, seed: int
) -> dict[str, object]:
    return {
        "motion": str(source),
        "file": str(target),
        "frames": len(made),
        "rate_hz": made.rate_hz,
        "sensors": list(made.sensors),
        "seed": seed,
    }
