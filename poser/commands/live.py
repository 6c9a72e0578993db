"""Poses while the person moves: sensors as they are heard, or a recording, through an estimator, out again.

--source says what is worn, --sink where the poses go; docs/live.md and docs/devices.md have the details.
--list shows what is heard, before anything is worn. Listens on this machine alone unless the source names
another address, as in slimevr:0.0.0.0. Ctrl-C ends it; a motion file then holds everything so far.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from learned.registry import specification
from poser import estimators, files, options
from poser.console import DONE, UsageError, complain, emit, note
from poser.live import addresses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mocap.recording import Recording
    from mocap.skeleton import Skeleton
    from poser.live.opening import Origin
    from poser.live.samples import Network, Source
    from poser.live.sinks.protocol import Sink

BUDGET = 0.8  # of the time between two samples: what a frame may take
HELP = "poses while the person moves, from trackers, phones, suits or a recording"
METHODS = (*estimators.METHODS, *estimators.HYBRIDS)
NETWORK_DEFAULTS: dict[str, object] = {
    "calibration": None, "facing": None, "countdown": 5.0, "up": "y", "rate": 60.0, "buffer": None,
    "map": None, "devices": None, "record": None, "reset": None, "headings": None,
}  # fmt: skip
"""Of sensors that are heard. The parser leaves them unset, so that they can be refused with a recording."""


def _speed(text: str) -> float | None:
    return None if text == "max" else options.positive(text)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--source", required=True, metavar="S",
        help="slimevr, sensorlogger, phyphox:HOST, text:PORT, mvn, dot, udp:PORT, osc:PORT, demo, or a "
        "recording (docs/devices.md)",
    )  # fmt: skip
    parser.add_argument(
        "--sink", action="append", default=[], metavar="S",
        help="FILE.npz, FILE.bvh, FILE.glb, FILE.sto, FILE.trc, FILE.rrd, vmc:PORT, vrchat, lsl or viewer; "
        "may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--list", action="store_true", help="show what is heard for --seconds (5), and end"
    )
    parser.add_argument("--method", choices=METHODS, default="hybrid", help="default: hybrid")
    parser.add_argument("--network", choices=estimators.NETWORKS, help="the hybrid's network")
    parser.add_argument(
        "--weights", type=options.weights, metavar="FILE", help="weights of your own (.safetensors)"
    )
    parser.add_argument(
        "--sensors", metavar="S",
        help=f"{options.SENSORS_HELP} (default: what the method is made for)",
    )  # fmt: skip
    parser.add_argument(
        "--height", type=options.stature, metavar="M", help="the body's stature in m"
    )
    options.add_horizon(parser)
    parser.add_argument("--seconds", type=options.positive, metavar="S", help="stop after so long")
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="X",
        help="of a replay: 2 is twice as fast, max as fast as it goes",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=addresses.port, default=8080,
        help="of the viewer (default: 8080, or the next free one; 0: any free one)",
    )  # fmt: skip
    group = parser.add_argument_group("sensors that are heard")
    group.add_argument(
        "--calibration", metavar="C",
        help="n or t: stand still in that pose at the start (default: n); a file that poser calibrate "
        "wrote; bones: the messages hold orientations of bones already",
    )  # fmt: skip
    group.add_argument(
        "--facing", type=options.number, metavar="DEG",
        help="heading of the wearer in that pose, in the sensors' world (default: 0, +z; 90: +x)",
    )  # fmt: skip
    group.add_argument(
        "--countdown", type=options.number, metavar="S",
        help="time to get into the pose (default: 5)",
    )  # fmt: skip
    group.add_argument("--up", choices=("y", "z"), help="the sensors' vertical axis (default: y)")
    group.add_argument("--rate", type=options.rate, metavar="HZ", help="of the poses (default: 60)")
    group.add_argument(
        "--buffer", type=options.positive, metavar="S",
        help="the longest wait for a late packet (default: 0.05)",
    )  # fmt: skip
    group.add_argument(
        "--map",
        type=options.mapping,
        metavar="NAME=PLACE,...",
        help="device names and their places",
    )
    group.add_argument(
        "--devices", metavar="POCKET,HAND,WATCH",
        help="track a phone, a watch and earbuds: the owner's usual pocket, hand and watch arm, "
        "as in left,right,left",
    )  # fmt: skip
    group.add_argument(
        "--headings", choices=("own", "shared"),
        help="whether each device has a heading of its own; then walking is part of the calibration "
        "(default: what the source is known for)",
    )  # fmt: skip
    group.add_argument(
        "--reset", choices=("n", "t", "none"), metavar="POSE",
        help="with a calibration from a file: take the headings anew from this pose (default: n, where each "
        "device has its own), or none",
    )  # fmt: skip
    group.add_argument(
        "--record", type=options.file, metavar="FILE.npz",
        help="keep what comes, for poser calibrate and --source",
    )  # fmt: skip
    options.add_json(parser)


def run(args: Namespace) -> int:
    from mocap.skeleton import Skeleton
    from poser.live import asking, loop, opening, telling

    origin = opening.origin(args.source)
    if args.list:
        return _list(args, origin)
    _check_apart(args)
    network = estimators.network_of(args.method, args.network)
    tracker = options.horizon(args)
    estimators.check_weights(args.weights, network)
    skeleton = Skeleton.default(args.height)
    source, origin = _source(args, origin, network)
    sinks: list[Sink] = []
    report, begun = loop.Report(), False
    try:
        estimator = estimators.make(
            args.method, source.rate_hz, source.sensors, network=args.network, weights=args.weights,
            skeleton=skeleton, joint=source.joint, seat=source.seat,
            tracker=tracker | {"budget_s": BUDGET / source.rate_hz},
        )  # fmt: skip
        source.read(estimator.sensors)
        for text in args.sink:
            sinks.append(_sink(text, source, skeleton, args))
        source.open()
        begun = True
        _announce(args, origin, source, network, sinks)
        asking.offer(source, sinks)
        loop.run(source, estimator, sinks, skeleton, report, telling.Teller(source, sinks).tell)
    finally:
        loop.close(source, sinks, report)
        if begun and args.json:
            emit(report.to_dict() | {"method": args.method, "network": network})
        elif begun:
            telling.summary(report)
    return DONE


def _check_apart(args: Namespace) -> None:
    """Raises UsageError where two sinks, or one and --record, would write to one file."""
    from poser.live import sinks

    paths = [Path(text) for text in args.sink if sinks.chosen(text)[0].suffixes]
    seen: dict[Path, Path] = {}
    for path in [*paths, *([args.record] if args.record else [])]:
        if path.resolve() in seen:
            raise UsageError(f"{path}: would be written twice; give each sink a file of its own")
        seen[path.resolve()] = path


def _list(args: Namespace, origin: Origin) -> int:
    """Show what is heard; after Ctrl-C, too."""
    from poser.live import listing, opening

    if origin.kind is None:
        raise UsageError(f"argument --list: {args.source} is no kind of devices")
    _settle(args, {})
    sensors = options.sensors("six" if args.sensors is None else args.sensors)
    intake = opening.intake(origin.kind, origin, args, sensors)
    found = listing.Listing(intake)
    try:
        found.open()
        try:
            found.listen(args.seconds or listing.SECONDS)
        finally:
            told = found.to_dict(args.map if isinstance(args.map, dict) else {})
            if args.json:
                emit(told)
            else:
                listing.show(told)
    finally:
        intake.close()
    return DONE


def _settle(args: Namespace, own: dict[str, object]) -> None:
    """The defaults of sensors that are heard, `own` before the general ones."""
    for name, default in (NETWORK_DEFAULTS | own).items():
        if getattr(args, name) is None:
            setattr(args, name, default)


def _source(args: Namespace, origin: Origin, network: str) -> tuple[Source, Origin]:
    """The source, and the origin with the kind of a raw recording in it."""
    from mocap.recording import RawRecording
    from poser.live import opening
    from poser.live.sources import playback

    if origin.kind is not None:
        _settle(args, {})
        return opening.devices(origin, args, network), origin
    content = files.read(origin.path).content
    if isinstance(content, RawRecording):
        _settle(args, {"rate": content.rate_hz})
        origin = replace(origin, kind=playback.kind(content))
        with files.about(origin.path):
            return opening.played(content, origin, args, network), origin
    for name in NETWORK_DEFAULTS:
        if getattr(args, name) is not None:
            raise UsageError(
                f"argument --{name}: for sensors that are heard, not for a calibrated recording"
            )
    return _replay(args, origin, files.recording(origin.path), network), origin


def _replay(args: Namespace, origin: Origin, recording: Recording, network: str) -> Source:
    from poser.live import sinks
    from poser.live.samples import RecordingSource

    for text in args.sink:
        kind, _ = sinks.chosen(text)
        if kind.suffixes:
            files.check_output(Path(text), [origin.path], kind.suffixes)
    if args.seconds is not None:
        recording = recording.slice(0, max(1, round(args.seconds * recording.rate_hz)))
    with files.about(origin.path):
        names = options.sensors(args.sensors, recording.sensors)
        some = not specification(network).needs_all
        if args.sensors is None and some:
            names = estimators.everyday(network, names, recording)
            if names != recording.sensors:
                note(f"{network} sees {', '.join(names)}; --sensors chooses others")
        if some:
            found = estimators.used(network, names)
            estimators.check_devices(network, estimators.at_once(network, found, recording))
        return RecordingSource(recording.select(names), args.speed)


def _announce(
    args: Namespace, origin: Origin, source: Source, network: str, sinks: Sequence[Sink]
) -> None:
    """What the user should know before anything comes: on stderr."""
    from poser.live import sinks as known
    from poser.live.samples import Network

    for sink in sinks:
        if url := getattr(sink, "url", ""):
            complain(f"the page is {url}", "live")
    if isinstance(source, Network):
        _announce_devices(args, origin, source, network)
    if not args.sink and not args.json:
        # With --json it may be the latency alone that is wanted. At once, not among the notes at the end.
        complain(f"without --sink poses go nowhere; it takes {known.spellings()}", "note")


def _announce_devices(args: Namespace, origin: Origin, source: Network, network: str) -> None:
    from poser.live import opening

    kind = origin.kind
    assert kind is not None
    complain(opening.begun(origin, source), "live")
    if args.sensors is None and not specification(network).needs_all and not args.devices:
        # At once, not among the notes at the end: it may run for hours.
        complain(f"{network} sees {', '.join(source.sensors)}; --sensors chooses others", "note")
    for address in () if kind.asks else origin.addresses:
        if not address.is_local:
            complain(f"whoever reaches {address} can send poses", "live")
        elif kind.far:
            complain(
                f"this machine alone is listened to; other devices need --source {kind.name}:0.0.0.0:"
                f"{address.port}", "note",
            )  # fmt: skip
    if source.waiting:
        pose = opening.calibration(args, kind)
        pose = pose.upper() if pose in ("n", "t") else (args.reset or "n").upper()
        walk = ", then walk about" if source.walks else ""
        complain(f"stand still in the {pose}-pose in {args.countdown:g} s{walk}", "live")


def _sink(text: str, source: Source, skeleton: Skeleton, args: Namespace) -> Sink:
    from poser.live import sinks
    from poser.live.sinks.protocol import SinkOrder

    kind, rest = sinks.chosen(text)
    return kind.make(SinkOrder(rest, source.rate_hz, skeleton, args.port))
