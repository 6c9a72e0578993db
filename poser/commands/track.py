"""Poses of a calibrated recording by an online method, sample by sample as it would run live.

Methods: dip (six sensors), imuposer (one to three of wrists, pockets, head), imuposer-adam (with ten steps of
refinement), hybrid (a network refined by a small optimisation each frame). The motion has exactly the
recording's frames, aligned in time whatever the method's look-ahead.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from poser import estimators, files, options
from poser.console import DONE, UsageError, emit, note, progress, say

if TYPE_CHECKING:
    from mocap.estimator import Estimator, Replay
    from mocap.recording import Recording

HELP = "online poses from a recording: DIP, IMUPoser or the hybrid"


def window(text: str) -> tuple[int, int]:
    """`PAST,FUTURE` in frames."""
    past, comma, future = text.partition(",")
    if not (comma and past.strip().isdecimal() and future.strip().isdecimal()):
        raise ArgumentTypeError(f"{text!r} is not PAST,FUTURE in frames, as 20,5")
    return int(past), int(future)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="REC", help="a calibrated recording")
    options.add_output(parser, "MOTION.npz", "the motion: an AMASS-style .npz, or .bvh")
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
        "--weights", type=Path, metavar="FILE", help="weights of your own (.safetensors)"
    )
    parser.add_argument(
        "--height", type=options.stature, metavar="M", help="the body's stature in m"
    )
    parser.add_argument(
        "--uncertainty", action="store_true", help="store std_rad (T,24,3) with the motion"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    if args.network and args.method not in ("hybrid", args.network):
        raise UsageError("argument --network: it is the hybrid's; the other methods name theirs")
    network = estimators.network_of(args.method, args.network)
    if args.window and network != "dip":
        raise UsageError("argument --window: for dip alone; imuposer's window is 125 frames")
    if args.uncertainty and args.output.suffix.lower() == ".bvh":
        raise UsageError("argument --uncertainty: a .bvh file cannot hold it, an .npz file can")
    inputs = [args.recording, *([args.weights] if args.weights else [])]
    files.check_output(args.output, inputs, (".npz", ".bvh"))
    recording = files.recording(args.recording)
    with files.about(args.recording):
        recording = recording.select(options.sensors(args.sensors, recording.sensors))
        recording = _chosen(recording, network, args.recording, free=args.sensors is None)
    estimator, done = _tracked(args, recording)
    extra = {"std_rad": done.std_rad} if args.uncertainty and done.std_rad is not None else None
    if args.uncertainty and extra is None:
        note(f"{args.output}: {args.method} states no uncertainty")
    files.write(args.output, done.motion, extra)
    _report(args, network, estimator, done)
    return DONE


def _chosen(recording: Recording, network: str, path: Path, free: bool) -> Recording:
    """The sensors that the network reads; says where one stands in for another, and, where the choice is
    free, which of more than IMUPoser can use are taken."""
    found = estimators.used(network, recording.sensors)
    if network == "imuposer":
        if free and len(found) > estimators.MOST_DEVICES:
            from poser.comparison import devices_of

            recording = recording.select(devices_of(recording))
            found = estimators.used(network, recording.sensors)
            note(f"{path}: imuposer sees {', '.join(found)}; --sensors chooses others")
        estimators.check_devices(found)
    for place, sensor in found.items():
        if sensor != place:
            note(f"{path}: {sensor} stands in for {place}, which is on the same bone")
    return recording.select(tuple(found.values()))


def _tracked(args: Namespace, recording: Recording) -> tuple[Estimator, Replay]:
    from mocap.estimator import replay
    from mocap.skeleton import Skeleton

    body, words = Skeleton.default(args.height), f"{args.method} {args.recording.name}"
    with progress(words) as tell, files.about(args.recording):
        estimator = estimators.make(
            args.method, recording.rate_hz, recording.sensors,
            network=args.network, weights=args.weights, window=args.window, skeleton=body,
        )  # fmt: skip
        return estimator, replay(estimator, recording, lambda share: tell(share, words), body)


def _report(args: Namespace, network: str, estimator: Estimator, done: Replay) -> None:
    """The answer: JSON, or a few sentences."""
    import numpy as np

    p50, p99 = (float(x) for x in np.percentile(1e3 * done.frame_s, [50, 99]))
    if args.json:
        emit(
            {
                "method": args.method,
                "network": network,
                "frames": len(done.motion),
                "rate_hz": done.motion.rate_hz,
                "frame_ms_p50": p50,
                "frame_ms_p99": p99,
                "fallbacks": done.fallbacks,
                "notes": dict(done.notes),
                "look_ahead_frames": estimator.look_ahead_frames,
                "used_sensors": list(estimator.sensors),
                "motion": str(args.output),
            }
        )
        return
    for text, count in done.notes.items():
        say(f"fallback: {text}: {count}")
    say(
        f"{args.output}: {len(done.motion)} frames by {args.method} from {len(estimator.sensors)} "
        f"sensors; {p50:.1f} ms a frame (99 %: {p99:.1f}), {estimator.look_ahead_frames} frames of "
        f"look-ahead"
    )
