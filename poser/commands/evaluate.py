"""How far a motion is from a reference, under the field's names.

REFERENCE is a motion, or a recording that holds a reference motion.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from mocap.errors import FormatError
from poser import files, options
from poser.console import DONE, emit, table

if TYPE_CHECKING:
    from mocap.formats import Options
    from mocap.metrics import Metrics
    from mocap.motion import Motion
    from mocap.recording import Recording

HELP = "compare a motion with a reference, in the field's metrics"

LABELS: tuple[tuple[str, str, str], ...] = (
    ("sip_deg", "hips and shoulders, global angle (SIP)", "deg"),
    ("angular_deg", "24 joints, global angle, masked", "deg"),
    ("local_angular_deg", "DIP's 15 joints, local angle", "deg"),
    ("position_cm", "24 joints, distance, roots aligned, masked", "cm"),
    ("mesh_cm", "mesh, distance, masked", "cm"),
    ("jitter", "jitter", "100 m/s^3"),
    ("jitter_reference", "jitter of the reference", "100 m/s^3"),
    ("root_deg", "root, angle", "deg"),
    ("global_deg", "24 joints, global angle, nothing masked", "deg"),
    ("instrumented_deg", "bones that carry a sensor, angle", "deg"),
    ("left_out_deg", "bones of sensors left out, angle to what they measured", "deg"),
    ("world_position_cm", "24 joints, distance, pelvis aligned", "cm"),
    ("translation_m_per_m", "drift per metre travelled", "m"),
)
"""JSON name, words, unit: the rows of the table."""


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("motion", type=Path, metavar="MOTION", help="the estimated motion")
    parser.add_argument(
        "reference", type=Path, metavar="REFERENCE", help="a motion, or a recording that holds one"
    )
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="REC",
        help="what all sensors measured, for instrumented_deg and left_out_deg",
    )
    parser.add_argument(
        "--sensors", metavar="S", help=f"those the method saw: {options.SENSORS_HELP}"
    )
    parser.add_argument(
        "--smpl", type=options.file, metavar="FILE", help="your SMPL body file, for mesh_cm"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    found = _evaluate(args)
    if args.json:
        emit(found.to_json())
    else:
        table(("metric", "value", "unit", "name"), rows(found))
    return DONE


def _evaluate(args: Namespace) -> Metrics:
    from mocap import metrics
    from mocap.formats import Options
    from mocap.skeleton import Skeleton

    motion = files.motion(args.motion)
    reference, recording = _reference(args, Options(smpl=args.smpl))
    if args.recording:
        recording = files.recording(args.recording)
    seen = None
    if args.sensors:
        with files.about(args.recording or args.reference):
            available = None if recording is None else recording.sensors
            seen = options.sensors(args.sensors, available)
    smpl = Skeleton.from_smpl_file(args.smpl) if args.smpl else None
    with files.about(args.motion):
        return metrics.evaluate(motion, reference, recording=recording, seen=seen, smpl=smpl)


def _reference(args: Namespace, reading: Options) -> tuple[Motion | None, Recording | None]:
    """The reference motion and, where its file is a recording, that too."""
    from mocap.motion import Motion
    from mocap.recording import Recording

    content = files.read(args.reference, reading).content
    if isinstance(content, Motion):
        return content, None
    recording = content if isinstance(content, Recording) else None
    if content.reference is None and (recording is None or not args.sensors):
        hint = "" if recording is None else "; with --sensors the others are measured against"
        raise FormatError(args.reference, f"holds no reference motion{hint}")
    return content.reference, recording


def rows(found: Metrics) -> list[tuple[str, str, str, str]]:
    """The figures that are defined, for a table."""
    out = []
    for name, words, unit in LABELS:
        value = getattr(found, name)
        if value is not None:
            out.append((words, f"{value:.2f}", unit, name))
    for seconds, value in (found.translation_m or {}).items():
        if value is not None:
            out.append((f"drift after {seconds} s", f"{value:.2f}", "m", "translation_m"))
    out.append(("frames compared", str(found.frames), "", "frames"))
    return out
