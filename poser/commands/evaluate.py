"""How far a motion is from a reference, under the field's names.

REFERENCE is a motion, or a recording that holds a reference motion. Beside the motion stand two answers that
need no skill: the mean pose of the training motion, and for each frame the training pose that is nearest by
the sensors' relative orientations (where no recording is given, of
six clean virtual sensors on the reference).
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
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
    found, others = _evaluate(args)
    if args.json:
        emit(found.to_json() | {"no_skill": {name: m.to_json() for name, m in others.items()}})
    else:
        names = (name.replace("-", " ") for name in others)
        table(("metric", "value", *names, "unit", "name"), rows(found, list(others.values())))
    return DONE


def _evaluate(args: Namespace) -> tuple[Metrics, dict[str, Metrics]]:
    """The motion's figures, and those of the two rows that need no skill."""
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
    if reference is not None and recording is not None:
        _same_time(args.recording or args.reference, recording, reference)
    smpl = Skeleton.from_smpl_file(args.smpl) if args.smpl else None
    with files.about(args.motion):
        found = metrics.evaluate(motion, reference, recording=recording, seen=seen, smpl=smpl)
    others = {
        name: metrics.evaluate(other, reference, recording=recording, seen=seen, smpl=smpl)
        for name, other in _no_skill(reference, recording, seen).items()
    }
    return found, others


def _same_time(path: Path, recording: Recording, reference: Motion) -> None:
    """Raises FormatError where they differ by more than a frame."""
    lasts = [len(x) / x.rate_hz for x in (recording, reference)]
    if abs(lasts[0] - lasts[1]) > 1.5 / min(recording.rate_hz, reference.rate_hz):
        raise FormatError(
            path, f"lasts {lasts[0]:.2f} s, the reference {lasts[1]:.2f} s: a solve of a part can only be "
            f"compared with a recording of that part (poser compare --from --to does both)",
        )  # fmt: skip


def _no_skill(
    reference: Motion | None, recording: Recording | None, seen: tuple[str, ...] | None
) -> dict[str, Motion]:
    from mocap import noskill, sensors, synthesis
    from sip.prior import shipped

    if recording is None:
        assert reference is not None  # or there was nothing to compare with
        recording = synthesis.recording(reference, sensors.SIX)
    elif seen:
        recording = recording.select(seen)
    prior = shipped()
    return noskill.both(recording, prior.mean, prior.poses)


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


def rows(found: Metrics, others: Sequence[Metrics]) -> list[tuple[str, ...]]:
    """The figures that are defined, for a table: the motion's, then the others'."""
    out: list[tuple[str, ...]] = []
    for name, words, unit in LABELS:
        if getattr(found, name) is not None:
            values = [getattr(m, name) for m in (found, *others)]
            out.append((words, *("-" if v is None else f"{v:.2f}" for v in values), unit, name))
    blank = [""] * len(others)  # they say nothing of where the body is
    for seconds, value in (found.translation_m or {}).items():
        if value is not None:
            out.append((f"drift after {seconds} s", f"{value:.2f}", *blank, "m", "translation_m"))
    out.append(("frames compared", str(found.frames), *blank, "", "frames"))
    return out
