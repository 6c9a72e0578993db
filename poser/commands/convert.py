"""From one file format to another.

A motion of any known format becomes an AMASS-style .npz or a .bvh; a raw or calibrated recording
becomes a native .npz. The output's suffix decides. --rate is for files that state none; --resample writes
a motion at another one.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from mocap.errors import FormatError
from poser import files, options
from poser.console import DONE, UsageError, note, progress, say

if TYPE_CHECKING:
    from mocap.formats import Content, Document

HELP = "between file formats"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("input", type=Path, metavar="IN", help="a motion or a recording")
    parser.add_argument("output", type=Path, metavar="OUT", help="a .npz or .bvh file")
    parser.add_argument(
        "--resample", type=options.rate, metavar="HZ", help="rate of the motion that is written"
    )
    options.add_reading(parser)


def run(args: Namespace) -> int:
    files.check_output(args.output, [args.input], (".npz", ".bvh"))
    with progress(f"converting {args.input.name}") as tell:
        doc = files.read(args.input, options.reading(args))
        _check_rate(args, doc)
        for text in (*doc.assumptions, *doc.warnings):
            note(f"{args.input}: {text}")
        content = _prepared(args, doc.content)
        tell(0.5, f"writing {args.output.name}")
        files.write(args.output, content)
    say(f"{args.output}: {doc.kind}, {len(content)} frames at {content.rate_hz:g} Hz")
    return DONE


def _check_rate(args: Namespace, doc: Document) -> None:
    """Raises UsageError for a motion whose file states another rate: it would be slowed down or sped up."""
    if doc.kind == "motion" and doc.stated_hz is not None:
        raise UsageError(
            f"argument --rate: {args.input} states {doc.stated_hz:g} Hz itself; "
            f"--resample {args.rate:g} writes the same motion at {args.rate:g} Hz"
        )


def _prepared(args: Namespace, content: Content) -> Content:
    """What is written; raises FormatError for what the output cannot hold."""
    from mocap.motion import Motion

    if isinstance(content, Motion):
        with files.about(args.input):
            return content if args.resample is None else content.resampled(args.resample)
    if args.output.suffix.lower() == ".bvh":
        raise FormatError(args.input, "holds sensor data, and a .bvh file holds a motion; use .npz")
    if args.resample is not None:
        raise FormatError(
            args.input, "holds sensor data, which --resample does not change; it is for motions"
        )
    return content
