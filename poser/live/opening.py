"""From the words of the command line to a source: which kind of devices, where, worn how, calibrated how."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learned.registry import specification
from poser import estimators, options
from poser.console import UsageError
from poser.live import addresses, sources
from poser.live.addresses import Address
from poser.live.sources.protocol import Intake, Kind, Told, Witness

if TYPE_CHECKING:
    from mocap.calibration import Calibration, PoseName
    from mocap.recording import RawRecording
    from poser.live.aligner import Aligner, Reset
    from poser.live.alignment import Watch
    from poser.live.recorder import Recorder
    from poser.live.samples import Network


@dataclass(frozen=True)
class Origin:
    """What --source says: a kind of devices and where they are, or a file (kind None)."""

    text: str
    kind: Kind | None
    addresses: tuple[Address, ...] = ()

    @property
    def path(self) -> Path:
        return Path(self.text)


def origin(text: str) -> Origin:
    """Raises UsageError where the address is missing or is none."""
    name, _, rest = text.partition(":")
    if name not in sources.NAMES or (not rest and Path(text).exists()):
        return Origin(text, None)
    kind = sources.kind(name)
    return Origin(text, kind, _addresses(kind, text, rest))


def _addresses(kind: Kind, text: str, rest: str) -> tuple[Address, ...]:
    what = "argument --source"
    if kind.port is None:
        if rest:
            raise UsageError(f"{what}: {text!r}: {kind.name} has no address")
        return ()
    if kind.asks:
        if not rest:
            raise UsageError(
                f"{what}: {text!r} lacks the device's address, as in {kind.name}:192.168.0.7"
            )
        return tuple(addresses.parse_host(h, kind.port, what) for h in rest.split(","))
    if kind.port:
        return (addresses.parse_host(rest, kind.port, what),)
    if not rest:
        raise UsageError(
            f"{what}: {text!r} lacks the port to listen on, as in {kind.name}:9000 "
            f"({kind.name}:0.0.0.0:9000 for other machines)"
        )
    return (addresses.parse(rest, what),)


def intake(kind: Kind, where: Origin, args: Namespace, sensors: tuple[str, ...]) -> Intake:
    """The devices of a kind, not yet listened to."""
    if args.up == "z" and not kind.turns:
        raise UsageError(f"argument --up: {kind.name} has an axis of its own")
    told = Told(where.addresses, sensors, args.rate, args.countdown, args.up, time.monotonic)
    return kind.make(told)


def devices(where: Origin, args: Namespace, network: str) -> Network:
    """The source of samples from devices of a kind."""
    assert where.kind is not None
    sensors = _worn(args, network)
    placed = _where(args, sensors, where.kind)
    return _network(where, args, sensors, placed)


def played(raw: RawRecording, where: Origin, args: Namespace, network: str) -> Network:
    """The source of samples from a raw recording, as if its sensors were there."""
    assert where.kind is not None
    sensors = _recorded(raw, args, network)
    placed = _where(args, sensors, where.kind)
    missing = [n for n in placed if n not in raw.sensors]
    if missing:
        raise UsageError(
            f"argument --sensors: {', '.join(missing)} not in {args.source}; it has: "
            f"{', '.join(raw.sensors)} (--map NAME=PLACE says where one is worn)"
        )
    return _network(where, args, sensors, placed)


def _recorded(raw: RawRecording, args: Namespace, network: str) -> tuple[str, ...]:
    """The places of a raw recording that are used: as said, else what the network is made for."""
    from mocap import sensors as places

    mapped = args.map if isinstance(args.map, dict) else {}
    there = tuple(p for n in raw.sensors if (p := mapped.get(n, n)) in places.PLACES)
    if args.sensors is not None or args.devices or not there:
        return _worn(args, network)
    if not specification(network).needs_all:
        return estimators.devices_of(network, there)
    return places.SIX if set(places.SIX) <= set(there) else there


def _network(
    origin: Origin, args: Namespace, sensors: tuple[str, ...], where: Mapping[str, str]
) -> Network:
    from poser.live.assembler import Assembler
    from poser.live.samples import Network

    kind = origin.kind
    assert kind is not None
    if args.speed != 1.0:
        raise UsageError("argument --speed: for a calibrated recording alone")
    own = {"own": True, "shared": False}.get(args.headings, kind.own_headings)
    tracker = _tracker(args)
    aligner = _aligner(args, sensors, own, kind)
    buffer = kind.buffer_s if args.buffer is None else args.buffer
    assembler = Assembler(tuple(where), args.rate, buffer)
    found = intake(kind, origin, args, sensors)
    recorder = None if args.record is None else _recorder(args, kind, found, where, own)
    return Network(
        found,
        assembler,
        sensors,
        where,
        aligner,
        tracker,
        args.seconds,
        recorder=recorder,
        up=args.up,
    )


def _recorder(
    args: Namespace, kind: Kind, devices: Intake, where: Mapping[str, str], own: bool
) -> Recorder:
    from mocap.skeleton import Skeleton
    from poser import files
    from poser.live.recorder import Recorder

    files.check_output(args.record, [Path(args.source)], (".npz",))
    names = tuple(place or device for device, place in where.items())
    bones = calibration(args, kind) == "bones" and not args.devices
    body = Skeleton.default(args.height) if bones and isinstance(devices, Witness) else None
    return Recorder(args.record, names, args.rate, own, bones, body)


def _worn(args: Namespace, network: str) -> tuple[str, ...]:
    """The sensors from devices: as said, else what the network is made for."""
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


def _where(args: Namespace, sensors: tuple[str, ...], kind: Kind) -> dict[str, str]:
    """The place of each device by its name: the places' own names unless mapped."""
    if args.devices:
        from poser.live.devices import DEVICES

        return dict.fromkeys(DEVICES, "")
    if not isinstance(args.map, dict | None):
        raise UsageError("argument --map: here it is name=place,name=place")
    where = kind.worn(sensors) if kind.worn else {name: name for name in sensors}
    for device, place in (args.map or {}).items():
        if place not in sensors:
            raise UsageError(f"argument --map: {place!r} is none of {', '.join(sensors)}")
        where = {d: p for d, p in where.items() if p != place}
        where[device] = place
    # In the order of the sensors: what stands still in a pose is calibrated in this order.
    return dict(sorted(where.items(), key=lambda pair: sensors.index(pair[1])))


def _tracker(args: Namespace) -> Any:
    if not args.devices:
        return None
    from poser.live.devices import DeviceTracker, Preferences

    words = args.devices.split(",")
    if len(words) != 3 or not set(words) <= {"left", "right"}:
        raise UsageError(f"argument --devices: {args.devices!r} is not three times left or right")
    if args.map:
        raise UsageError("argument --devices: not with --map; devices are phone, watch and earbuds")
    return DeviceTracker(Preferences(*words), args.rate)  # type: ignore[arg-type]


def _aligner(args: Namespace, sensors: tuple[str, ...], own: bool, kind: Kind) -> Aligner:
    """The constants of a file, or who waits for the pose, or nothing for bones."""
    from poser.live import alignment
    from poser.live.aligner import Aligner
    from poser.live.device_headings import HeadingWatch

    how = calibration(args, kind)
    if args.reset is not None and how in ("n", "t", "bones"):
        raise UsageError("argument --reset: for a calibration from a file")
    if how == "bones":
        return Aligner()
    if how in ("n", "t"):
        if args.devices:
            raise UsageError(
                "argument --devices: needs --calibration FILE or bones, since a device changes places"
            )
        resets = _resets(args, sensors, own, "n" if how == "n" else "t")
        watch = resets["walk" if own else "pose"](None, args.countdown)
        return Aligner(None, watch, None, resets, args.countdown)
    known = alignment.read(Path(how))
    found = alignment.constants(known)
    missing = [n for n in sensors if n not in {key.rpartition("@")[2] for key in found}]
    if missing:
        raise UsageError(
            f"argument --calibration: {how} lacks sensor {', '.join(missing)}; "
            f"it has: {', '.join(found)}"
        )
    if args.devices:
        return Aligner(found)
    stands = reset(args, kind, own)
    resets = _resets(args, sensors, own, stands or "n")
    if stands is None:
        return Aligner(found, None, known, resets, args.countdown)
    anew = HeadingWatch(known, sensors, args.rate, stands, args.countdown)
    return Aligner(None, anew, known, resets, args.countdown)


def _resets(
    args: Namespace, sensors: tuple[str, ...], own: bool, pose: PoseName
) -> dict[str, Reset]:
    """What finds constants, at the start and while the session runs: by standing still in the pose; and by
    walking, where each device has a heading of its own."""
    from poser.live.alignment import PoseWatch
    from poser.live.device_headings import HeadingWatch, WalkWatch

    def standing(known: Calibration | None, begin_s: float) -> Watch:
        if own and known is not None:
            return HeadingWatch(known, sensors, args.rate, pose, begin_s)
        facing = 0.0 if args.facing is None else args.facing
        return PoseWatch(sensors, args.rate, pose, facing, begin_s)

    def walking(known: Calibration | None, begin_s: float) -> Watch:
        return WalkWatch(sensors, args.rate, pose, args.facing, begin_s)

    return {"pose": standing, "walk": walking} if own else {"pose": standing}


def calibration(args: Namespace, kind: Kind) -> str:
    """n, t, bones, or a file: as said, else what the kind needs."""
    if args.calibration is not None:
        return str(args.calibration)
    return "bones" if kind.bones else "n"


def reset(args: Namespace, kind: Kind, own: bool) -> PoseName | None:
    """The pose from which headings are taken anew, beside a calibration from a file; or None.

    Devices with headings of their own have others after each start; a recording goes on with those it had.
    """
    if args.reset is not None:
        return None if args.reset == "none" else "n" if args.reset == "n" else "t"
    return "n" if own and kind.starts_anew else None


def begun(where: Origin, network: Network) -> str:
    """What is done with the devices now, in words."""
    assert where.kind is not None
    names, at = ", ".join(network.facts()["devices"]), ", ".join(map(str, where.addresses))
    if not at:
        return f"{where.kind.words}: {names}"
    return f"{'asking' if where.kind.asks else 'listening on'} {at} for {names}"
