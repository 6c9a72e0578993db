"""Poses while the person moves: sensors from the network or a recording, through an estimator, out again.

Sources: a recording, replayed at its own pace; udp:PORT, JSON lines; osc:PORT. Sinks: a motion file,
vmc:HOST:PORT (Unity, Unreal, Blender, VSeeFace), viewer (in the browser). docs/live.md has the messages.
Listens on localhost unless the source names another address, as in udp:0.0.0.0:9000. Ctrl-C ends it;
a motion file then holds everything so far.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learned.registry import specification
from poser import estimators, files, options
from poser.console import DONE, UsageError, complain, emit, note
from poser.live import addresses

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mocap.skeleton import Skeleton
    from poser.live.alignment import Constants, PoseWatch
    from poser.live.sinks import Sink
    from poser.live.sources import Network, Source

HELP = "poses while the person moves, from the network or a recording"
METHODS = (*estimators.METHODS, *estimators.HYBRIDS)
SUFFIXES = (".npz", ".bvh")
NETWORK_DEFAULTS: dict[str, object] = {
    "calibration": "n", "facing": 0.0, "countdown": 5.0, "up": "y", "rate": 60.0, "buffer": 0.05,
    "map": None, "devices": None,
}  # fmt: skip
"""Of sensors from the network. The parser leaves them unset, so that they can be refused with a recording."""
SINKS = "FILE.npz, FILE.bvh, vmc:PORT, vmc:HOST:PORT or viewer"


def _speed(text: str) -> float | None:
    return None if text == "max" else options.positive(text)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--source", required=True, metavar="S", help="REC.npz, udp:PORT or osc:PORT"
    )
    parser.add_argument(
        "--sink", action="append", default=[], metavar="S",
        help=f"{SINKS}; may be repeated",
    )  # fmt: skip
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
    parser.add_argument("--seconds", type=options.positive, metavar="S", help="stop after so long")
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="X",
        help="of a replay: 2 is twice as fast, max as fast as it goes",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=addresses.port, default=8080,
        help="of the viewer (default: 8080, or the next free one; 0: any free one)",
    )  # fmt: skip
    group = parser.add_argument_group("sensors from the network")
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
    options.add_json(parser)


def run(args: Namespace) -> int:
    from mocap.skeleton import Skeleton
    from poser.live import loop, telling

    _settle(args)
    network = estimators.network_of(args.method, args.network)
    estimators.check_weights(args.weights, network)
    skeleton = Skeleton.default(args.height)
    source = _source(args, network)
    sinks: list[Sink] = []
    report, begun = loop.Report(), False
    try:
        estimator = estimators.make(
            args.method, source.rate_hz, source.sensors, network=args.network, weights=args.weights,
            skeleton=skeleton, joint=source.joint, seat=source.seat,
        )  # fmt: skip
        source.read(estimator.sensors)
        for text in args.sink:
            sinks.append(_sink(text, source, skeleton, args))
        source.open()
        begun = True
        _announce(args, source, network, sinks)
        loop.run(source, estimator, sinks, skeleton, report, telling.Teller(source, sinks).tell)
    finally:
        loop.close(source, sinks, report)
        if begun and args.json:
            emit(report.to_dict() | {"method": args.method, "network": network})
        elif begun:
            telling.summary(report)
    return DONE


def _address(args: Namespace) -> tuple[str, str]:
    """udp or osc, and the address behind it; empty where the source is a recording."""
    kind, _, rest = args.source.partition(":")
    if kind not in ("udp", "osc") or (not rest and Path(args.source).exists()):
        return "", ""
    if not rest:
        raise UsageError(
            f"argument --source: {args.source!r} lacks the port to listen on, as in {kind}:9000 "
            f"({kind}:0.0.0.0:9000 for other machines)"
        )
    return kind, rest


def _settle(args: Namespace) -> None:
    """The defaults of sensors from the network. Raises UsageError for what a recording has no use for."""
    kind, _ = _address(args)
    # Of a file that is not there that is the better error: udp:9000 may have been meant.
    refused = not kind and Path(args.source).exists()
    for name, default in NETWORK_DEFAULTS.items():
        if getattr(args, name) is None:
            setattr(args, name, default)
        elif refused:
            raise UsageError(
                f"argument --{name}: for sensors from the network, not for a recording"
            )


def _source(args: Namespace, network: str) -> Source:
    kind, rest = _address(args)
    if kind:
        return _network(args, kind, rest, _worn(args, network))
    from poser.live.sources import Replay

    path = Path(args.source)
    for text in args.sink:
        if _is_file(text):
            files.check_output(Path(text), [path], SUFFIXES)
    recording = files.recording(path)
    if args.seconds is not None:
        recording = recording.slice(0, max(1, round(args.seconds * recording.rate_hz)))
    with files.about(path):
        names = options.sensors(args.sensors, recording.sensors)
        some = not specification(network).needs_all
        if args.sensors is None and some:
            names = estimators.everyday(network, names, recording)
            if names != recording.sensors:
                note(f"{network} sees {', '.join(names)}; --sensors chooses others")
        if some:
            found = estimators.used(network, names)
            estimators.check_devices(network, estimators.at_once(network, found, recording))
        return Replay(recording.select(names), args.speed)


def _worn(args: Namespace, network: str) -> tuple[str, ...]:
    """The sensors from the network: as said, else what the network is made for."""
    from mocap import sensors as places

    if args.devices:
        tracked = options.sensors("five" if args.sensors is None else args.sensors)
        never = [name for name in tracked if name not in places.FIVE]
        if never:
            raise UsageError(
                f"argument --devices: no device is ever tracked at {', '.join(never)}; --sensors may name "
                f"{', '.join(places.FIVE)}"
            )
        return tracked
    spec = specification(network)
    if args.sensors is None and not spec.needs_all:
        return estimators.devices_of(network, spec.places)
    names = options.sensors("six" if args.sensors is None else args.sensors)
    if not spec.needs_all:
        estimators.check_devices(network, estimators.used(network, names))
    return names


def _network(args: Namespace, kind: str, rest: str, sensors: tuple[str, ...]) -> Network:
    from poser.live import osc, packets
    from poser.live.assembler import Assembler
    from poser.live.receiver import Receiver, y_up
    from poser.live.sources import Network

    if args.speed != 1.0:
        raise UsageError("argument --speed: for a recording, not for sensors from the network")
    address = addresses.parse(rest, "argument --source")
    tracker, where = _tracker(args), _where(args, sensors)
    devices = tuple(where)
    if kind == "osc":
        osc.library()
    decode = osc.from_osc if kind == "osc" else packets.from_json
    table, watch = _alignment(args, sensors)
    receiver = Receiver(address, y_up(decode) if args.up == "z" else decode)
    assembler = Assembler(devices, args.rate, args.buffer)
    return Network(receiver, assembler, sensors, where, table, watch, tracker, args.seconds)


def _announce(args: Namespace, source: Source, network: str, sinks: Sequence[Sink]) -> None:
    """What the user should know before anything comes: on stderr."""
    for sink in sinks:
        if url := getattr(sink, "url", ""):
            complain(f"the page is {url}", "live")
    kind, rest = _address(args)
    if kind:
        _announce_network(args, source, network, rest)
    if not args.sink and not args.json:
        # With --json it may be the latency alone that is wanted. At once, not among the notes at the end.
        complain(f"without --sink poses go nowhere; it takes {SINKS}", "note")


def _announce_network(args: Namespace, source: Source, network: str, rest: str) -> None:
    address = addresses.parse(rest, "argument --source")
    names = ", ".join(source.facts()["devices"])
    complain(f"listening on {address} for {names}", "live")
    if args.sensors is None and not specification(network).needs_all and not args.devices:
        # At once, not among the notes at the end: it may run for hours.
        complain(f"{network} sees {', '.join(source.sensors)}; --sensors chooses others", "note")
    if not address.is_local:
        complain(f"whoever reaches {address} can send poses", "live")
    if args.calibration in ("n", "t"):
        pose = args.calibration.upper()
        complain(f"stand still in the {pose}-pose in {args.countdown:g} s", "live")


def _where(args: Namespace, sensors: tuple[str, ...]) -> dict[str, str]:
    """The place of each device by its name: the places' own names unless mapped."""
    if args.devices:
        from poser.live.devices import DEVICES

        return dict.fromkeys(DEVICES, "")
    if not isinstance(args.map, dict | None):
        raise UsageError("argument --map: here it is name=place,name=place")
    where = {name: name for name in sensors}
    for device, place in (args.map or {}).items():
        if place not in sensors:
            raise UsageError(f"argument --map: {place!r} is none of {', '.join(sensors)}")
        where.pop(place, None)
        where[device] = place
    # In the order of the sensors: what stands still in a pose is calibrated in this order.
    return dict(sorted(where.items(), key=lambda pair: sensors.index(pair[1])))


def _tracker(args: Namespace) -> Any:
    if not args.devices:
        return None
    from poser.live.devices import Preferences, Tracker

    words = args.devices.split(",")
    if len(words) != 3 or not set(words) <= {"left", "right"}:
        raise UsageError(f"argument --devices: {args.devices!r} is not three times left or right")
    if args.map:
        raise UsageError("argument --devices: not with --map; devices are phone, watch and earbuds")
    return Tracker(Preferences(*words), args.rate)  # type: ignore[arg-type]


def _alignment(
    args: Namespace, sensors: tuple[str, ...]
) -> tuple[Mapping[str, Constants] | None, PoseWatch | None]:
    """The constants of a file, or who waits for the pose, or neither for bones."""
    from poser.live import alignment

    if args.calibration == "bones":
        return None, None
    if args.calibration in ("n", "t"):
        if args.devices:
            raise UsageError(
                "argument --devices: needs --calibration FILE or bones, since a device changes places"
            )
        return None, alignment.PoseWatch(
            sensors, args.rate, args.calibration, args.facing, args.countdown
        )
    found = alignment.constants(alignment.read(Path(args.calibration)))
    missing = [n for n in sensors if n not in {key.rpartition("@")[2] for key in found}]
    if missing:
        raise UsageError(
            f"argument --calibration: {args.calibration} lacks sensor {', '.join(missing)}; "
            f"it has: {', '.join(found)}"
        )
    return found, None


def _is_file(sink: str) -> bool:
    return sink != "viewer" and not sink.startswith("vmc:")


def _sink(text: str, source: Source, skeleton: Skeleton, args: Namespace) -> Sink:
    if text == "viewer":
        from poser.viewer.live import ViewerSink

        return ViewerSink(skeleton, args.port)
    if text.startswith("vmc:"):
        from poser.live.vmc import VmcSink

        return VmcSink(addresses.parse(text[4:], "argument --sink"), skeleton)
    from poser.live.sinks import MotionFile

    path = Path(text)
    files.check_output(path, [], SUFFIXES)
    return MotionFile(path, source.rate_hz, skeleton)
