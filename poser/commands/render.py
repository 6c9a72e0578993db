"""Motions and recordings as a film or a picture, without a display.

Bodies stand side by side, with the sensors of a recording on its reference. The output's suffix decides:
.mp4 and .gif are films, .png is a film strip with a row for each file. A recording without a reference
motion is shown as measured, as poser view does. Films in .mp4 need the extra `render`:
pip install 'poser-imu[render]'.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from mocap.errors import PoserError
from poser import files, options
from poser.console import DONE, Progress, UsageError, part, progress, say

if TYPE_CHECKING:
    from poser.render.film import Stage

HELP = "motions and recordings as a film or a picture"
SUFFIXES = (".mp4", ".gif", ".png")
FPS = {".mp4": 30.0, ".gif": 20.0}
COLUMNS = 7
CELL = (230, 300)
SIZE = (1280, 720)
LARGEST = 4096


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="motions or recordings")
    options.add_output(parser, "OUT", "film.mp4, film.gif or strip.png")
    options.add_window(parser)
    parser.add_argument(
        "--fps", type=options.positive, metavar="N", help="of a film (default: 30; .gif: 20)"
    )
    parser.add_argument(
        "--size", type=_size, metavar="WxH",
        help=f"pixels of a film ({SIZE[0]}x{SIZE[1]}), or of each picture in a strip ({CELL[0]}x{CELL[1]})",
    )  # fmt: skip
    parser.add_argument(
        "--at", type=options.numbers, metavar="S,S,...",
        help=f"times of a strip's pictures in s (default: {COLUMNS}, evenly)",
    )  # fmt: skip
    parser.add_argument(
        "--view", type=options.number, default=25.0, metavar="DEG",
        help="where the camera is: 0 before the body, 90 at its left (default: 25)",
    )  # fmt: skip
    parser.add_argument(
        "--labels",
        type=lambda text: text.split(","),
        metavar="NAME,...",
        help="instead of the files' names",
    )
    options.add_body(parser)
    options.add_reading(parser)


def run(args: Namespace) -> int:
    from poser.render.film import Stage
    from poser.viewer import tracks

    files.check_output(args.output, args.files, SUFFIXES)
    suffix = args.output.suffix.lower()
    _check(args, suffix)
    reading = options.reading(args)
    with progress("reading") as tell:
        found = [tracks.read(path, reading) for path in args.files]
        if args.labels:
            found = [t.named(label) for t, label in zip(found, args.labels, strict=True)]
        stage = Stage(found, args.view, args.body)
        begin, end = _window(args, stage)
        made = _write(args, suffix, stage, begin, end, part(tell, 0.0, 1.0))
    say(f"{args.output}: {made}, {begin:.2f} to {end:.2f} s")
    return DONE


def _write(
    args: Namespace, suffix: str, stage: Stage, begin: float, end: float, tell: Progress
) -> str:
    """Write it, whole or not at all; what was written, in words."""
    import numpy as np

    from mocap.formats._files import write_aside
    from poser.render import film

    with write_aside(args.output) as aside:
        if suffix == ".png":
            times = args.at or list(np.linspace(begin, end, COLUMNS))
            film.strip(stage, times, args.size or CELL, tell).save(aside, format="PNG")
            return f"{len(stage.tracks)} x {len(times)} pictures"
        fps, size = args.fps or FPS[suffix], args.size or SIZE
        pictures = film.frames(stage, begin, end, fps, size, tell)
        if suffix == ".gif":
            film.write_gif(aside, pictures, fps)
        else:
            film.write_mp4(aside, pictures, fps, size)
    return f"film of {end - begin:.1f} s at {fps:g} frames a second, {size[0]}x{size[1]}"


def _check(args: Namespace, suffix: str) -> None:
    """Raises UsageError for what contradicts itself."""
    options.check_body(args)
    if suffix == ".png" and args.fps is not None:
        raise UsageError("argument --fps: is for films")
    if suffix != ".png" and args.at is not None:
        raise UsageError("argument --at: is for a .png")
    if suffix == ".gif" and args.fps is not None and args.fps > 50:
        raise UsageError("argument --fps: a .gif shows at most 50 frames a second")
    if args.labels and len(args.labels) != len(args.files):
        raise UsageError(f"argument --labels: {len(args.labels)} names for {len(args.files)} files")


def _window(args: Namespace, stage: Stage) -> tuple[float, float]:
    """From where to where, s. Raises PoserError where nothing is there."""
    clock = stage.clock
    begin = clock.first if args.begin is None else max(args.begin, clock.begin)
    end = clock.end if args.end is None else min(args.end, clock.end)
    if end < begin:
        raise PoserError(
            f"nothing between {begin:g} and {end:g} s: the files last from {clock.begin:g} to {clock.end:g} s"
        )
    return begin, end


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(64 <= n <= LARGEST and n % 2 == 0 for n in size):
        raise ArgumentTypeError(
            f"{text!r} is not WIDTHxHEIGHT, even numbers of pixels from 64 to {LARGEST}"
        )
    return size
