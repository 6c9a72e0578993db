"""From sensors' own frames to bones in the world: a raw recording becomes a calibrated one.

The recording needs one still moment in a known pose. Where the wearer faces comes from --facing,
--axis, --second, the file, or the motion, in this order; the diagnostics say which and how sure.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files, options
from poser.console import DONE, UsageError, emit, progress, say

if TYPE_CHECKING:
    from mocap.calibration import Calibration
    from mocap.findings import Finding, Severity
    from mocap.recording import RawRecording, Recording

HELP = "a raw recording to a calibrated one"


def _axis(text: str) -> tuple[str, str]:
    from mocap.calibration.facing import parsed_axis
    from mocap.errors import CalibrationError

    name, equals, axis = text.partition("=")
    if not equals or not name.strip():
        raise ArgumentTypeError(f"{text!r} is not SENSOR=AXIS DIRECTION, as in 'pelvis=x forward'")
    try:
        parsed_axis(axis)
    except CalibrationError as e:
        raise ArgumentTypeError(str(e)) from e
    return name.strip(), axis.strip()


def _arm_angle(text: str) -> float:
    from mocap.stances import ARM_ANGLES_DEG

    value, (low, high) = options.number(text), ARM_ANGLES_DEG
    if not low <= value <= high:
        raise ArgumentTypeError(f"{text!r} is not an angle between {low:g} and {high:g} deg")
    return value


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("raw", type=Path, metavar="RAW", help="a raw recording")
    options.add_output(parser, "REC.npz", "the calibrated recording")
    parser.add_argument(
        "--pose", choices=("n", "t"), default="n", help="arms down (default) or to the sides"
    )
    parser.add_argument(
        "--at", type=options.number, metavar="SECONDS", help="when (default: it is found)"
    )
    parser.add_argument(
        "--arm-angle", type=_arm_angle, metavar="DEG", help="of the N-pose (default: 80)"
    )
    parser.add_argument(
        "--facing",
        type=options.number,
        metavar="DEG",
        help="heading of the wearer in the sensors' world (0: +z, 90: +x)",
    )
    parser.add_argument(
        "--axis",
        type=_axis,
        action="append",
        default=[],
        metavar="SENSOR=AXIS DIRECTION",
        help="a known mounting: pelvis='x forward'; may be repeated for other sensors",
    )
    parser.add_argument(
        "--second",
        type=options.choice_at("n", "t"),
        metavar="POSE@SECONDS",
        help="another static pose: t@12.5",
    )
    parser.add_argument(
        "--orientation",
        choices=("auto", "file", "vqf"),
        default="auto",
        help="the file's (default where it has one), or fused from gyr, acc and mag",
    )
    parser.add_argument(
        "--no-strict",
        action="store_true",
        help="go on where a diagnostic is an error; warnings never stop",
    )
    parser.add_argument("--sensors", metavar="S", help=f"{options.SENSORS_HELP} (default: all)")
    options.add_reading(parser)
    options.add_json(parser)


def run(args: Namespace) -> int:
    files.check_output(args.output, [args.raw], (".npz",))
    if args.arm_angle is not None and args.pose == "t" and args.second is None:
        raise UsageError("argument --arm-angle: the T-pose has its arms at 0")
    axed = [name for name, _ in args.axis]
    if len(set(axed)) < len(axed):
        raise UsageError("argument --axis: one axis a sensor, the other two follow from gravity")
    raw, doubts = _read(args)
    with progress(f"calibrating {args.raw.name}"), files.about(args.raw):
        raw = raw.select(options.sensors(args.sensors, raw.sensors))
        recording, calibration = _with_doubts(*_calibrate(raw, args), doubts)
    files.write(args.output, recording)
    if args.json:
        emit(record(calibration, recording))
    else:
        _print(args.output, calibration, recording)
    return DONE


def _read(args: Namespace) -> tuple[RawRecording, tuple[Finding, ...]]:
    """The raw recording, and what its reader doubts, which is told among the diagnostics."""
    from mocap.recording import RawRecording

    doc = files.read(args.raw, options.reading(args))
    if not isinstance(doc.content, RawRecording):
        return files.raw(args.raw, options.reading(args)), ()  # raises, and says what to do
    return doc.content, doc.doubts


def _with_doubts(
    recording: Recording, calibration: Calibration, doubts: Sequence[Finding]
) -> tuple[Recording, Calibration]:
    """Both with the reader's doubts among the diagnostics: warnings, and samples that are missing as info.

    Doubts about sensors that are not used, and those that the diagnostics state themselves, are left out.
    """
    from mocap.findings import ORDER

    told = {(f.code, f.sensor) for f in calibration.diagnostics}
    more = [
        replace(f, severity="info" if f.code == "missing-samples" else "warning")
        for f in doubts
        if (f.code, f.sensor) not in told and (f.sensor is None or f.sensor in calibration.sensors)
    ]
    if not more:
        return recording, calibration
    more = sorted([*calibration.diagnostics, *more], key=lambda f: ORDER[f.severity])
    calibration = replace(calibration, diagnostics=tuple(more))
    return replace(recording, calibration=calibration.to_dict()), calibration


def _calibrate(raw: RawRecording, args: Namespace) -> tuple[Recording, Calibration]:
    from mocap import calibration, stances

    angle = stances.ARM_ANGLE_DEG if args.arm_angle is None else args.arm_angle
    return calibration.calibrate(
        raw,
        pose=args.pose,
        at=args.at,
        arm_angle_deg=angle,
        facing=args.facing,
        axes=dict(args.axis),
        second=args.second,
        orientation=args.orientation,
        strict=not args.no_strict,
    )


def record(calibration: Calibration, recording: Recording) -> dict[str, Any]:
    """The JSON of `poser calibrate`."""
    return calibration.to_dict() | {
        "frames": len(recording),
        "rate_hz": recording.rate_hz,
        "has_reference": recording.reference is not None,
    }


def _print(path: Path, calibration: Calibration, recording: Recording) -> None:
    import numpy as np

    from mocap.words import clause

    start, stop = calibration.time
    sigma = float(np.rad2deg(calibration.heading_sigma).max())
    codes = {f.code for f in calibration.diagnostics}
    unsure = "could be the opposite" if "facing-ambiguous" in codes else "assumed"
    sure = unsure if sigma > 179 else f"to {sigma:.0f} deg"
    say(f"{calibration.pose.upper()}-pose at {start:.2f} to {stop:.2f} s")
    say(f"facing: {calibration.method} ({sure})")
    say(f"orientation: {calibration.orientation}")
    for (severity, told), whose in _grouped(calibration.diagnostics, clause).items():
        say(f"{severity:<8} {whose}: {told}")
    if not calibration.diagnostics:
        say("nothing doubtful")
    say(
        f"{path}: {len(recording)} frames at {recording.rate_hz:g} Hz, "
        f"{len(recording.sensors)} sensors"
    )


def _grouped(
    findings: Sequence[Finding], clause: Callable[[Finding], str]
) -> dict[tuple[Severity, str], str]:
    """Severity and sentence -> whom it is about; sensors of which the same is said stand together."""
    groups: dict[tuple[Severity, str], list[str]] = {}
    for f in findings:
        groups.setdefault((f.severity, clause(f)), []).append(f.sensor or "body")
    return {said: ", ".join(dict.fromkeys(names)) for said, names in groups.items()}
