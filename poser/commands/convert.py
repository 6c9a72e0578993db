"""From one file format to another.

A motion of any known format becomes what the output's suffix says: .npz (AMASS-style), .bvh (--profile for
Mixamo, Unity or CMU), .glb (with its body, for Blender and three.js), .sto or .trc (for OpenSim). A raw or
calibrated recording becomes a native .npz. --rate is for files that state none; --resample writes
a motion at another one. --reference puts a motion into a recording as what is true of it: for poser
finetune, evaluate and compare. Both are taken at the times that they state (a motion without one must last as
long as the recording), and what of the recording the motion does not cover is cut off.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from mocap.errors import FormatError
from poser import files, options
from poser.console import DONE, UsageError, note, progress, say
from poser.exports import PROFILES, RESTS, SUFFIXES, Export

if TYPE_CHECKING:
    from mocap.formats import Content, Document
    from mocap.recording import Recording

HELP = "between file formats"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("input", type=Path, metavar="IN", help="a motion or a recording")
    parser.add_argument(
        "output", type=Path, nargs="?", metavar="OUT", help=f"{', '.join(SUFFIXES)} (or -o)"
    )
    parser.add_argument(
        "-o", "--output", dest="other_output", type=Path, metavar="OUT", help="the same"
    )
    parser.add_argument(
        "--resample", type=options.rate, metavar="HZ", help="rate of the motion that is written"
    )
    parser.add_argument(
        "--reference", type=options.file, metavar="MOTION",
        help="of a calibrated recording: this motion becomes its reference",
    )  # fmt: skip
    parser.add_argument(
        "--profile", choices=PROFILES, help="names of the joints in a .bvh (default: smpl)"
    )
    parser.add_argument(
        "--rest", choices=RESTS, help="T- or A-pose where a .bvh has its zero (default: t)"
    )
    options.add_body(parser)
    options.add_reading(parser)
    options.stand_behind(parser, "output")


def run(args: Namespace) -> int:
    from mocap.formats import native

    output = _output(args)
    inputs = [args.input, *(p for p in (args.reference, args.smpl) if p)]
    files.check_output(output, inputs, (".npz",) if args.reference else SUFFIXES)
    export = _export(args, output.suffix.lower())
    with progress(f"converting {args.input.name}") as tell:
        doc = files.read(args.input, options.reading(args))
        _check_rate(args, doc)
        for text in (*doc.assumptions, *doc.warnings):
            note(f"{args.input}: {text}")
        content = _prepared(args, output, doc.content)
        if args.reference:
            content = _with_reference(args, files.expected(args.input, doc, "recording"))
        tell(0.5, f"writing {output.name}")
        files.write(output, content, timed=native.states_start(args.input), export=export)
    with_it = f" with {args.reference} as its reference" if args.reference else ""
    say(f"{output}: {doc.kind}{with_it}, {len(content)} frames at {content.rate_hz:g} Hz")
    return DONE


def _export(args: Namespace, suffix: str) -> Export:
    """How the output is to be; raises UsageError for what files of its kind have not."""
    said = {"profile": args.profile, "rest": args.rest, "body": args.body}
    for name, value in said.items():
        wanted = ".glb" if name == "body" else ".bvh"
        if value is not None and suffix != wanted:
            raise UsageError(f"argument --{name}: is for {wanted} files")
    options.check_body(args)
    return Export(**{name: value for name, value in said.items() if value is not None})


def _output(args: Namespace) -> Path:
    """Where to write to, however it is said; raises UsageError where it is not, or twice."""
    said = [path for path in (args.output, args.other_output) if path is not None]
    if not said:
        raise UsageError("the following arguments are required: OUT (or -o OUT)")
    if len(said) > 1:
        raise UsageError(f"argument -o: {said[0]} is the output already")
    return said[0]


def _with_reference(args: Namespace, recording: Recording) -> Recording:
    """The recording with the motion of --reference in it."""
    from mocap.evaluation import references
    from mocap.formats import Options, native
    from mocap.words import sentence

    # What is said of sensors' files, rate and names among it, is not said of the motion.
    body = Options(height=args.height, scale=args.scale, smpl=args.smpl)
    motion = files.motion(args.reference, body)
    timed = native.states_start(args.reference)
    with files.about(args.input):
        made, found = references.with_reference(recording, motion, timed, str(args.reference))
    for finding in found:
        note(f"{args.input}: {sentence(finding)}")
    return made


def _check_rate(args: Namespace, doc: Document) -> None:
    """Raises UsageError for a motion whose file states another rate: it would be slowed down or sped up."""
    if doc.kind == "motion" and doc.stated_hz is not None:
        raise UsageError(
            f"argument --rate: {args.input} states {doc.stated_hz:g} Hz itself; "
            f"--resample {args.rate:g} writes the same motion at {args.rate:g} Hz"
        )


def _prepared(args: Namespace, output: Path, content: Content) -> Content:
    """What is written; raises FormatError for what the output cannot hold."""
    from mocap.motion import Motion

    if isinstance(content, Motion):
        with files.about(args.input):
            return content if args.resample is None else content.resampled(args.resample)
    suffix = output.suffix.lower()
    if suffix != ".npz":
        raise FormatError(
            args.input, f"holds sensor data, and a {suffix} file holds a motion; use .npz"
        )
    if args.resample is not None:
        raise FormatError(
            args.input, "holds sensor data, which --resample does not change; it is for motions"
        )
    return content
