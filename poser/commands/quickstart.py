"""From nothing to a body that moves with you: asks what you have, and leads through the rest.

What is heard, where each sensor goes (with a picture), which device is which, the calibration pose, and then
the browser. Without hardware: poser quickstart --source demo. At the end it says the command for next time.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from poser import files, options
from poser.console import UsageError, complain, say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from poser.live.opening import Origin
    from poser.live.sources.protocol import Intake

HELP = "from nothing to a body that moves with you, step by step"
FOLDER = Path("poser-quickstart")
PICTURE, SESSION = "placement.png", "session.npz"
PHONES = ("sensorlogger", "phyphox", "text")
"""Kinds that are worn as IMUPoser has it: one to three, in everyday places."""


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--source", metavar="S", help="what you have, as for poser live (default: it is asked)"
    )
    parser.add_argument(
        "--sensors", metavar="S", help=f"{options.SENSORS_HELP} (default: by what you have)"
    )
    parser.add_argument(
        "--map", type=options.mapping, metavar="NAME=PLACE,...",
        help="which device is where (default: each is turned in the hand)",
    )  # fmt: skip
    parser.add_argument(
        "--sink",
        action="append",
        default=[],
        metavar="S",
        help="as for poser live (default: viewer)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=FOLDER, metavar="DIR",
        help=f"where the picture and the recording go (default: {FOLDER})",
    )  # fmt: skip
    parser.add_argument("--seconds", type=options.positive, metavar="S", help="stop after so long")
    parser.add_argument(
        "--countdown", type=options.number, default=5.0, metavar="S",
        help="time to get into the pose (default: 5)",
    )  # fmt: skip
    parser.add_argument("--yes", action="store_true", help="ask nothing")


def run(args: Namespace) -> int:
    from poser.live import opening

    asks = not args.yes and sys.stdin is not None and sys.stdin.isatty()
    if args.source is None:
        if not asks:
            raise UsageError("argument --source: say what you have, as in --source demo")
        args.source = _asked_source()
    origin = opening.origin(args.source)
    if origin.kind is None:
        raise UsageError(f"argument --source: {args.source} is no kind of devices")
    method = "imuposer" if origin.kind.name in PHONES else "hybrid"
    sensors = _sensors(args, method)
    _check_map(args, origin, asks)
    with files.folder(args.output, single=True):
        _show_places(args.output, sensors)
        words = ["--source", args.source, "--method", method, "--sensors", ",".join(sensors)]
        words += _mapped(args, origin, sensors)
        if asks:
            _wait("Put everything on as in the picture. Then press Enter")
        return _live(args, words)


def _asked_source() -> str:
    """What the user has, in the words of --source."""
    from poser.live import sources

    kinds = list(sources.kinds())
    say("What do you have?")
    for k, kind in enumerate(kinds, 1):
        say(f"  {k}  {kind.words}")
    kind = kinds[_number(f"1 to {len(kinds)}", len(kinds)) - 1]
    if kind.asks:
        return f"{kind.name}:{_line('Address of the device, several separated by commas')}"
    if kind.port is None:
        return kind.name
    port = kind.port or _number("Port to listen on", 65535)
    if kind.far and _yes(
        "Listen on all addresses of this machine? Whoever reaches it can then send poses"
    ):
        return f"{kind.name}:0.0.0.0:{port}"
    return f"{kind.name}:{port}"


def _sensors(args: Namespace, method: str) -> tuple[str, ...]:
    from mocap import sensors as places
    from poser import estimators

    if args.sensors is not None:
        return options.sensors(args.sensors)
    return estimators.devices_of("imuposer", places.FIVE) if method == "imuposer" else places.SIX


def _show_places(folder: Path, sensors: Sequence[str]) -> None:
    from poser.live import placement

    say("Where the sensors go:")
    for place in sensors:
        say(f"  {placement.words(place)}")
    picture = folder / PICTURE
    placement.draw(picture, sensors)
    say(f"{picture} shows it. Any way round: the calibration finds how they sit.")


def _named_by_places(origin: Origin) -> bool:
    """Whether the devices of a kind bear the names of their places."""
    assert origin.kind is not None
    return origin.kind.worn is not None or origin.kind.name in ("demo", "udp", "osc")


def _check_map(args: Namespace, origin: Origin, asks: bool) -> None:
    """Raises UsageError where it is needed and can be neither asked for nor used."""
    if args.map is not None and not isinstance(args.map, dict):
        raise UsageError("argument --map: here it is name=place,name=place")
    if args.map is None and not asks and not _named_by_places(origin):
        raise UsageError(
            "argument --map: say which device is where, as in NAME=head; poser live --list has the names"
        )


def _mapped(args: Namespace, origin: Origin, sensors: Sequence[str]) -> list[str]:
    """The --map of these devices: as said, or found by turning them one by one."""
    from poser.live import listing

    if args.map is not None:
        return ["--map", ",".join(f"{d}={p}" for d, p in args.map.items())]
    if _named_by_places(origin):
        return []
    intake = _intake(args, origin, tuple(sensors))
    try:
        say("Switch everything on.")
        heard = listing.Listing(intake)
        heard.open()
        while True:
            heard.listen(listing.SECONDS)
            listing.show(heard.to_dict({}))
            if _yes("Is everything there?"):
                break
        found = _turned_one_by_one(intake, sensors)
    finally:
        intake.close()
    return ["--map", ",".join(f"{device}={place}" for device, place in found.items())]


def _intake(args: Namespace, origin: Origin, sensors: tuple[str, ...]) -> Intake:
    from poser.live import opening

    assert origin.kind is not None
    told = Namespace(up="y", rate=60.0, countdown=args.countdown)
    return opening.intake(origin.kind, origin, told, sensors)


def _turned_one_by_one(intake: Intake, sensors: Sequence[str]) -> dict[str, str]:
    from poser.live import identifying

    say("Lay all devices down. Then turn one after the other in your hand, when you are asked to.")
    found: dict[str, str] = {}
    for place in sensors:
        while place not in found.values():
            say(f"turn the one for {place.replace('_', ' ')} over, now")
            device = identifying.turned(intake, found)
            if device is not None:
                say(f"  {device}")
                found[device] = place
            elif not _yes("No device was turned, or several at once. Try again?"):
                raise UsageError(f"argument --map: nothing is known for {place}")
    return found


def _live(args: Namespace, words: list[str]) -> int:
    """`poser live` with what was found."""
    from poser.commands import live

    sinks = args.sink or ["viewer"]
    say(f"next time: poser live {' '.join([*words, *_pairs('--sink', sinks)])}")
    more = ["--countdown", str(args.countdown), "--record", str(args.output / SESSION)]
    if args.seconds is not None:
        more += ["--seconds", str(args.seconds)]
    parser = ArgumentParser(allow_abbrev=False)
    live.add_arguments(parser)
    status = live.run(parser.parse_args([*words, *more, *_pairs("--sink", sinks)]))
    session = args.output / SESSION
    if session.exists():
        complain(f"{session} holds what the sensors measured: poser calibrate, --source", "note")
    return status


def _pairs(option: str, values: Sequence[str]) -> list[str]:
    return [word for value in values for word in (option, value)]


def _line(question: str) -> str:
    """A line that is not empty. Raises UsageError where nobody answers."""
    while True:
        try:
            text = input(f"{question}: ").strip()
        except EOFError as e:
            raise UsageError("nobody answers; --yes asks nothing") from e
        if text:
            return text


def _number(question: str, largest: int) -> int:
    while True:
        text = _line(question)
        if text.isdecimal() and 1 <= int(text) <= largest:
            return int(text)
        say(f"a number from 1 to {largest}")


def _yes(question: str) -> bool:
    return _line(f"{question} (y/n)").lower().startswith("y")


def _wait(question: str) -> None:
    try:
        input(f"{question}: ")
    except EOFError:
        return
