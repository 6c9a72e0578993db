"""How far a motion is from a reference, under the field's names.

REFERENCE is a motion, or a recording that holds a reference motion. What states its time on the recording's
clock (recordings, and the motions that poser wrote of them) is compared where all of it covers the same time.
Beside the motion stand two answers that
need no skill: the mean pose of the training motion, and for each frame the training pose that is nearest by
the sensors' relative orientations (where no recording is given, of
six clean virtual sensors on the reference).
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap import timeline
from mocap.errors import FormatError
from poser import files, options
from poser.console import DONE, emit, note, table

if TYPE_CHECKING:
    from mocap.evaluation.metrics import Metrics
    from mocap.formats import Options
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
    ("inside_1_sigma", "errors inside one stated deviation (0.68 is honest)", ""),
    ("inside_2_sigma", "errors inside two (0.95 is honest)", ""),
)
"""JSON name, words, unit: the rows of the table."""
_PART = (
    "a solve of a part can only be compared with a recording of that part (poser compare --from --to does "
    "both)"
)


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
        "--sensors", metavar="S",
        help=f"those the method saw: {options.SENSORS_HELP} (default: all that the recording has)",
    )  # fmt: skip
    parser.add_argument(
        "--smpl", type=options.file, metavar="FILE", help="your SMPL body file, for mesh_cm"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    answer = _evaluate(args)
    if args.json:
        emit(answer.to_json())
    else:
        names = (name.replace("-", " ") for name in answer.others)
        body = rows(answer.found, list(answer.others.values()))
        table(("metric", "value", *names, "unit", "name"), body)
    return DONE


@dataclass(frozen=True, eq=False)
class _Answer:
    """The motion's figures and those of the two rows that need no skill. when: begin and end of the time
    compared, s, where the files state theirs. counted: the sensors of instrumented_deg."""

    found: Metrics
    others: dict[str, Metrics]
    when: tuple[float, float] | None
    counted: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        others = {name: m.to_json() for name, m in self.others.items()}
        more = {"compared_s": self.when, "instrumented_sensors": self.counted}
        return self.found.to_json() | {"no_skill": others} | more


def _evaluate(args: Namespace) -> _Answer:
    from mocap.evaluation import metrics, references
    from mocap.formats import Options, native
    from mocap.skeleton import Skeleton

    motion = files.motion(args.motion)
    reference, recording, timed = _reference(args, Options(smpl=args.smpl))
    whole: Recording | None = None
    if args.recording:
        recording = whole = files.recording(args.recording, gaps=False)
    seen = None
    if args.sensors:
        with files.about(args.recording or args.reference):
            available = None if recording is None else recording.sensors
            seen = options.sensors(args.sensors, available)
    if reference is not None and recording is not None and not timed:
        with files.about(args.recording):
            references.same_time(recording, reference, _PART)
        # Frame for frame the recording's, so on its timeline.
        reference, timed = replace(reference, start_s=recording.start_s), True
    stated: dict[Path, Motion | Recording] = {}
    if native.states_start(args.motion):
        stated[args.motion] = motion
    if reference is not None and timed:
        stated[args.reference] = reference
    if recording is not None:
        stated[args.recording or args.reference] = recording
    when = _shared(stated)
    std_rad = native.deviations(args.motion, motion)
    if when is not None:
        if args.motion in stated:
            a, b = timeline.frames(motion, *when)
            motion, std_rad = motion.slice(a, b), None if std_rad is None else std_rad[a:b]
        reference = reference and timeline.cut(reference, *when)
        recording = recording and timeline.cut(recording, *when)
    if recording is not None and whole is not None:
        files.note_gaps(args.recording, recording, whole)
    smpl = Skeleton.from_smpl_file(args.smpl) if args.smpl else None
    with files.about(args.motion):
        found = metrics.evaluate(
            motion, reference, recording=recording, seen=seen, smpl=smpl, std_rad=std_rad
        )
    others = {
        name: metrics.evaluate(other, reference, recording=recording, seen=seen, smpl=smpl)
        for name, other in _no_skill(reference, recording, seen).items()
    }
    counted = seen or (() if recording is None or reference is None else recording.sensors)
    if counted and not seen:
        note(
            f"instrumented_deg counts the bones of all {len(counted)} sensors of "
            f"{args.recording or args.reference} ({', '.join(counted)}); --sensors names those the method saw"
        )
    return _Answer(found, others, when, counted)


def _shared(stated: Mapping[Path, Motion | Recording]) -> tuple[float, float] | None:
    """Begin and end, s, of what those cover together that state a time; None where fewer than two do. A note
    says where one covers more than a frame more."""
    if len(stated) < 2:
        return None
    begin, end = timeline.shared(stated)
    for path, x in stated.items():
        if x.seconds > end - begin + (1 + 1e-6) / x.rate_hz:
            note(f"{path}: of its {timeline.words(x)}, {begin:.2f} to {end:.2f} s are compared")
    return begin, end


def _no_skill(
    reference: Motion | None, recording: Recording | None, seen: tuple[str, ...] | None
) -> dict[str, Motion]:
    from mocap import sensors, synthesis
    from mocap.evaluation import noskill
    from sip.prior import shipped

    if recording is None:
        assert reference is not None  # or there was nothing to compare with
        recording = synthesis.recording(reference, sensors.SIX)
    elif seen:
        recording = recording.select(seen)
    prior = shipped()
    return noskill.both(recording, prior.mean, prior.poses)


def _reference(args: Namespace, reading: Options) -> tuple[Motion | None, Recording | None, bool]:
    """The reference motion, where its file is a calibrated recording that too, and whether the file states
    its time."""
    from mocap.formats import native
    from mocap.motion import Motion
    from mocap.recording import Recording

    content = files.read(args.reference, reading).content
    if isinstance(content, Motion):
        return content, None, native.states_start(args.reference)
    recording = content if isinstance(content, Recording) else None
    if content.reference is None and (recording is None or not args.sensors):
        hint = "" if recording is None else "; with --sensors the others are measured against"
        raise FormatError(args.reference, f"holds no reference motion{hint}")
    reference = content.reference and replace(content.reference, start_s=content.start_s)
    return reference, recording, True


def rows(found: Metrics, others: Sequence[Metrics]) -> list[tuple[str, ...]]:
    """The figures that are defined, for a table: the motion's, then the others'."""
    out: list[tuple[str, ...]] = []
    for name, words, unit in LABELS:
        if getattr(found, name) is not None:
            values = [getattr(m, name) for m in (found, *others)]
            out.append((words, *("-" if v is None else f"{v:.2f}" for v in values), unit, name))
    blank = ["-"] * len(others)  # they say nothing of where the body is
    for seconds, value in (found.translation_m or {}).items():
        if value is not None:
            out.append((f"drift after {seconds} s", f"{value:.2f}", *blank, "m", "translation_m"))
    out.append(("frames compared", str(found.frames), *blank, "", "frames"))
    return out
