"""Poses while the person moves: sensors from the network or a recording, through an estimator, out again.

Sources: a recording, replayed at its own pace; udp:PORT, JSON lines; osc:PORT. Sinks: a motion file,
vmc:HOST:PORT (Unity, Unreal, Blender, VSeeFace), viewer (in the browser). docs/live.md has the messages.
Listens on localhost unless the source names another address, as in udp:0.0.0.0:9000. Ctrl-C ends it;
a motion file then holds everything so far.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files, options
from poser.console import DONE, UsageError, complain, emit, say, table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mocap.skeleton import Skeleton
    from poser.live.alignment import Constants, PoseWatch
    from poser.live.loop import Report
    from poser.live.sinks import Sink
    from poser.live.sources import Network, Source

HELP = "poses while the person moves, from the network or a recording"
METHODS = ("dip", "imuposer", "imuposer-adam", "hybrid", "hybrid-dip", "hybrid-imuposer")
FIVE_METHODS = ("imuposer", "imuposer-adam", "hybrid-imuposer")
SUFFIXES = (".npz", ".bvh")
STATUS_S = 1.0


def _speed(text: str) -> float | None:
    return None if text == "max" else options.positive(text)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--source", required=True, metavar="S", help="REC.npz, udp:PORT or osc:PORT"
    )
    parser.add_argument(
        "--sink", action="append", default=[], metavar="S",
        help="FILE.npz, FILE.bvh, vmc:PORT, vmc:HOST:PORT or viewer; may be repeated",
    )  # fmt: skip
    parser.add_argument("--method", choices=METHODS, default="hybrid", help="default: hybrid")
    parser.add_argument("--network", choices=("dip", "imuposer"), help="the hybrid's network")
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
    parser.add_argument("--port", type=int, default=8080, help="of the viewer (default: 8080)")
    group = parser.add_argument_group("sensors from the network")
    group.add_argument(
        "--calibration", default="n", metavar="C",
        help="n or t: stand still in that pose at the start (default: n); a file that poser calibrate "
        "wrote; bones: the messages hold orientations of bones already",
    )  # fmt: skip
    group.add_argument(
        "--facing", type=options.number, default=0.0, metavar="DEG",
        help="heading of the wearer in that pose, in the sensors' world (0: +z, 90: +x)",
    )  # fmt: skip
    group.add_argument(
        "--countdown", type=options.number, default=5.0, metavar="S",
        help="time to get into the pose (default: 5)",
    )  # fmt: skip
    group.add_argument("--up", choices=("y", "z"), default="y", help="the sensors' vertical axis")
    group.add_argument(
        "--rate", type=options.rate, default=60.0, metavar="HZ", help="of the poses (default: 60)"
    )
    group.add_argument(
        "--buffer", type=options.positive, default=0.05, metavar="S",
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
    from poser import estimators  # type: ignore[attr-defined]
    from poser.live import loop

    if args.network and args.method != "hybrid":
        raise UsageError("argument --network: it is the hybrid's; the other methods name theirs")
    skeleton = Skeleton.default(args.height)
    source = _source(args)
    sinks: list[Sink] = []
    report = loop.Report()
    try:
        method = f"hybrid-{args.network}" if args.network else args.method
        estimator = estimators.make(method, source.rate_hz, source.sensors)
        for text in args.sink:
            sinks.append(_sink(text, source, skeleton, args))
        source.open()
        _announce(args, source)
        loop.run(source, estimator, sinks, skeleton, report, _Teller(source).tell)
    finally:
        loop.close(source, sinks, report)
        if report.samples:
            _tell(report, args)
    return DONE


def _sensors(args: Namespace, available: tuple[str, ...] | None) -> tuple[str, ...]:
    """The sensors as told, else those that the method is made for."""
    five = args.method in FIVE_METHODS or args.network == "imuposer" or args.devices
    return options.sensors(args.sensors or ("five" if five else "six"), available)


def _source(args: Namespace) -> Source:
    kind, _, rest = args.source.partition(":")
    if kind in ("udp", "osc") and rest:
        return _network(args, kind, rest)
    from poser.live.sources import Replay

    path = Path(args.source)
    if args.devices:
        raise UsageError("argument --devices: for sensors from the network, not for a recording")
    for text in args.sink:
        if _is_file(text):
            files.check_output(Path(text), [path], SUFFIXES)
    recording = files.recording(path)
    if args.seconds is not None:
        recording = recording.slice(0, max(1, round(args.seconds * recording.rate_hz)))
    with files.about(path):
        return Replay(recording.select(_sensors(args, recording.sensors)), args.speed)


def _network(args: Namespace, kind: str, rest: str) -> Network:
    from poser.live import addresses, osc, packets
    from poser.live.assembler import Assembler
    from poser.live.sources import Network, Receiver, y_up

    if args.speed != 1.0:
        raise UsageError("argument --speed: for a recording, not for sensors from the network")
    address = addresses.parse(rest, "argument --source")
    sensors = _sensors(args, None)
    tracker, where = _tracker(args), _where(args, sensors)
    devices = tuple(where)
    if kind == "osc":
        osc.library()
    decode = osc.from_osc if kind == "osc" else packets.from_json
    table, watch = _alignment(args, sensors)
    receiver = Receiver(address, y_up(decode) if args.up == "z" else decode)
    assembler = Assembler(devices, args.rate, args.buffer)
    return Network(receiver, assembler, sensors, where, table, watch, tracker, args.seconds)


def _announce(args: Namespace, source: Source) -> None:
    """What the wearer should know before anything comes: on stderr."""
    kind, _, rest = args.source.partition(":")
    if kind not in ("udp", "osc"):
        return
    from poser.live import addresses

    address = addresses.parse(rest, "argument --source")
    names = ", ".join(source.facts()["devices"])
    complain(f"listening on {address} for {names}", "live")
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
        from poser.live import addresses
        from poser.live.vmc import VmcSink

        return VmcSink(addresses.parse(text[4:], "argument --sink"), skeleton)
    from poser.live.sinks import MotionFile

    path = Path(text)
    files.check_output(path, [], SUFFIXES)
    return MotionFile(path, source.rate_hz, skeleton)


class _Teller:
    """A line on stderr once a second, where stderr is a terminal."""

    def __init__(self, source: Source):
        import time

        self._clock, self._source = time.monotonic, source
        self._told = 0.0

    def tell(self, report: Report) -> None:
        if sys.stderr is None or not sys.stderr.isatty():
            return
        now = self._clock()
        if now - self._told < STATUS_S:
            return
        self._told = now
        sys.stderr.write(f"\r{_status(report, self._source)}\x1b[K")
        sys.stderr.flush()


def _status(report: Report, source: Source) -> str:
    """The last seconds in a line."""
    if getattr(source, "waiting", False):
        return "waiting for the pose"
    p50, p99 = (report.lag.quantile_ms(q, last=300) for q in (0.5, 0.99))
    words = [f"{report.frames} poses"]
    if p50 is not None and p99 is not None:
        words.append(f"latency {p50:.1f} ms (99 %: {p99:.1f})")
    facts = source.facts()
    if facts.get("rejected"):
        words.append(f"{sum(facts['rejected'].values())} messages refused")
    lost = sum(d["lost"] for d in facts.get("devices", {}).values())
    return ", ".join(words + ([f"{lost} packets lost"] if lost else []))


def _tell(report: Report, args: Namespace) -> None:
    """The answer: JSON, or tables."""
    facts = report.to_dict()
    if args.json:
        emit(facts | {"method": args.method})
        return
    if sys.stderr is not None and sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    devices = facts.get("devices", {})
    if devices:
        columns = list(next(iter(devices.values())))
        table(
            ("device", *(c.replace("_", " ") for c in columns)),
            [(name, *(str(d[c]) for c in columns)) for name, d in devices.items()],
        )
    for reason, count in facts.get("rejected", {}).items():
        say(f"refused: {reason}: {count}")
    for text, count in report.notes.items():
        say(f"fallback: {text}: {count}")
    for name in report.sinks:
        say(f"{name}: " + ", ".join(f"{k} {v}" for k, v in report.sinks[name].items()))
    for words, latency in (("latency", report.lag), ("per frame", report.step)):
        if len(latency):
            p50, p99 = latency.quantile_ms(0.5), latency.quantile_ms(0.99)
            say(f"{words}: {p50:.1f} ms in the middle, {p99:.1f} ms for 99 of 100")
    say(f"{report.frames} poses of {report.samples} samples")
