"""Poses of a calibrated recording by an online method, sample by sample as it would run live.

Methods: dip (six sensors), imuposer (one to three of wrists, pockets, head at a time; which ones may change
while it runs), imuposer-adam (with ten steps of refinement), hybrid (a network inside a moving window of the
offline optimizer's cost). The motion has exactly the recording's frames, aligned in time whatever the
method's look-ahead.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learned.registry import specification
from mocap.errors import PoserError
from poser import estimators, files, options
from poser.console import DONE, UsageError, emit, note, progress, say
from poser.exports import SUFFIXES

if TYPE_CHECKING:
    from mocap.recording import Recording
    from poser.tracking import Tracked

HELP = "online poses from a recording: DIP, IMUPoser or the hybrid"


def window(text: str) -> tuple[int, int]:
    """`PAST,FUTURE` in frames."""
    past, comma, future = text.partition(",")
    if not (comma and past.strip().isdecimal() and future.strip().isdecimal()):
        raise ArgumentTypeError(f"{text!r} is not PAST,FUTURE in frames, as 20,5")
    return int(past), int(future)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="REC", help="a calibrated recording")
    options.add_motion_output(parser)
    parser.add_argument("--method", choices=estimators.METHODS, required=True, help="what tracks")
    parser.add_argument(
        "--network", choices=estimators.NETWORKS, help="the hybrid's network (default: dip)"
    )
    parser.add_argument(
        "--sensors", metavar="S",
        help=f"{options.SENSORS_HELP} (default: all of the recording that the method reads)",
    )  # fmt: skip
    parser.add_argument(
        "--window", type=window, metavar="PAST,FUTURE",
        help="dip: frames before and after the one answered for (default: 20,5; also 50,5 and 20,0)",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=options.weights, metavar="FILE", help="weights of your own (.safetensors)"
    )
    parser.add_argument(
        "--height", type=options.stature, metavar="M", help="the body's stature in m"
    )
    parser.add_argument(
        "--uncertainty", action="store_true", help="store std_rad (T,24,3) with the motion"
    )
    options.add_horizon(parser)
    options.add_window(parser)
    options.add_solving_rate(parser)
    options.add_json(parser)


def run(args: Namespace) -> int:
    from mocap import thinning
    from poser.commands.solve import cut_window

    if args.network and args.method not in ("hybrid", args.network):
        raise UsageError("argument --network: it is the hybrid's; the other methods name theirs")
    network = estimators.network_of(args.method, args.network)
    tracker = options.horizon(args)
    try:
        estimators.check_window(network, args.window)
    except PoserError as e:
        raise UsageError(f"argument --window: {e}") from e
    options.check_uncertainty(args)
    inputs = [args.recording, *([args.weights] if args.weights else [])]
    files.check_output(args.output, inputs, SUFFIXES)
    estimators.check_weights(args.weights, network)
    whole = files.recording(args.recording, gaps=False)
    with files.about(args.recording):
        named = options.served(args.sensors, whole.sensors)
        recording = whole.select(tuple(dict.fromkeys(named.values())))
        recording, _ = cut_window(recording, args.begin, args.end)
        recording = _chosen(recording, network, args.recording, named, free=args.sensors is None)
    files.note_gaps(args.recording, recording, whole)
    files.note_no_acc(args.recording, recording)
    asked = recording
    if args.rate or args.method == "hybrid":  # a network takes what it needs of a faster one itself
        recording = files.thinned(args.recording, recording, args.rate)
    tracked = _tracked(args, recording, network, tracker)
    if len(recording) <= tracked.look_ahead_frames:
        note(
            f"{args.recording}: has {len(recording)} frames, and {args.method} looks "
            f"{tracked.look_ahead_frames} ahead: its poses rest on hardly any motion"
        )
    std = tracked.run.std_rad if args.uncertainty else None
    if args.uncertainty and std is None:
        note(f"{args.output}: {args.method} states no uncertainty")
    found = tracked.run.motion
    extra = None if std is None else {"std_rad": thinning.deviations_given_back(std, found, asked)}
    files.write(args.output, thinning.given_back(found, asked), extra, timed=True)
    _report(args, tracked, asked)
    return DONE


def _chosen(
    recording: Recording, network: str, path: Path, named: dict[str, str], free: bool
) -> Recording:
    """The sensors that the network reads; says where one stands in for another, and, where the choice is
    free, which of more than IMUPoser can use are taken.

    named: what the user named, and the sensor that serves for it.
    """
    names = recording.sensors
    some = not specification(network).needs_all
    if some and free:
        names = estimators.everyday(network, names, recording)
    found = estimators.used(network, names)
    if names != recording.sensors:
        recording = recording.select(names)
        note(f"{path}: imuposer sees {', '.join(found)}; --sensors chooses others")
    if some:
        estimators.check_devices(network, estimators.at_once(network, found, recording))
    for text in estimators.served_words(named | found):
        note(f"{path}: {text}")
    idle = [n for n in recording.sensors if n not in found.values()]
    if idle and not free:
        note(f"{path}: {network} does not read {', '.join(idle)}")
    return recording.select(tuple(found.values()))


def _tracked(
    args: Namespace, recording: Recording, network: str, tracker: dict[str, Any]
) -> Tracked:
    from mocap.skeleton import Skeleton
    from poser import tracking

    with progress(args.method) as tell, files.about(args.recording):
        return tracking.track(
            recording, args.method, network, weights=args.weights, window=args.window,
            skeleton=Skeleton.default(args.height), tracker=tracker,
            progress=lambda share, words: tell(share, f"{words} {args.recording.name}"),
        )  # fmt: skip


def _report(args: Namespace, tracked: Tracked, asked: Recording) -> None:
    """The answer: JSON, or a few sentences. asked: the recording whose frames were written."""
    rate = tracked.run.motion.rate_hz
    written = {"frames": len(asked), "rate_hz": asked.rate_hz, "estimated_hz": rate}
    record = tracked.record() | written | {"motion": str(args.output)}
    if args.json:
        emit(record)
        return
    for text, count in record["notes"].items():
        say(f"fallback: {text}: {count}")
    network_hz = tracked.network_hz
    other = "" if abs(rate / network_hz - 1) < 1e-6 else f"; the network runs at {network_hz:g} Hz"
    say(
        f"{args.output}: {record['frames']} frames by {args.method} from {len(tracked.sensors)} "
        f"sensors; {record['frame_ms_p50']:.1f} ms per sample at {rate:g} Hz "
        f"(99 %: {record['frame_ms_p99']:.1f}{other}), {tracked.look_ahead_frames} frames late"
    )
