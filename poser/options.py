"""Pieces of command lines that several commands share, and the types of their arguments."""

from __future__ import annotations

import math
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser.console import UsageError
from poser.exports import LOOKS, SUFFIXES

if TYPE_CHECKING:
    from mocap.formats import Options

MOST_HORIZON_S, MOST_LAG = 5.0, 120
UNITS = ("g", "m/s^2", "deg/s", "rad/s")
SENSORS_HELP = "six, five, all, or names separated by commas"


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArgumentTypeError(f"{text!r} is not a number")
    return value


def positive(text: str) -> float:
    """A finite number above zero."""
    value = number(text)
    if value <= 0:
        raise ArgumentTypeError(f"{text!r} is not above zero")
    return value


def rate(text: str) -> float:
    """A frame rate in Hz: 1 to 10,000."""
    value = number(text)
    if not 1 <= value <= 10_000:
        raise ArgumentTypeError(f"{text!r} is not a rate between 1 and 10000 Hz")
    return value


def stature(text: str) -> float:
    """A body height in m."""
    value = number(text)
    if not 0.5 <= value <= 2.6:
        raise ArgumentTypeError(f"{text!r} is not a body height between 0.5 and 2.6 m")
    return value


def cutoff(text: str) -> float | None:
    """A cut-off in Hz, or none."""
    return None if text.lower() == "none" else positive(text)


def seed(text: str) -> int:
    """A seed: an integer of zero or more."""
    if not text.isdecimal():
        raise ArgumentTypeError(f"{text!r} is not an integer of zero or more")
    return int(text)


def units(text: str) -> frozenset[str]:
    """Units separated by commas; at most one of accelerations, one of rates."""
    found = frozenset(u.strip() for u in text.split(","))
    odd = sorted(found - set(UNITS))
    if odd:
        raise ArgumentTypeError(f"unit {odd[0]!r} unknown; known: {', '.join(UNITS)}")
    for pair in (UNITS[:2], UNITS[2:]):
        if set(pair) <= found:
            raise ArgumentTypeError(f"{pair[0]} and {pair[1]} exclude each other")
    return found


def file(text: str) -> Path:
    """The path of a file: not that of a folder."""
    path = Path(text)
    if path.is_dir():
        raise ArgumentTypeError(f"{text!r} is a folder, expected a file")
    return path


def weights(text: str) -> Path:
    """The path of a network's weights, by its suffix."""
    path = file(text)
    if path.suffix.lower() != ".safetensors":
        raise ArgumentTypeError(
            f"{text!r} is no .safetensors file: weights are NAME.safetensors with NAME.json beside it, "
            f"as poser train --export writes them"
        )
    return path


def mapping(text: str) -> dict[str, str] | Path:
    """`name=place,...`, or a file that holds them."""
    if "=" not in text:
        return Path(text)
    pairs = [pair.partition("=") for pair in text.split(",")]
    out = {a.strip(): b.strip() for a, _, b in pairs}
    if len(out) < len(pairs) or not all(out) or not all(out.values()):
        raise ArgumentTypeError(f"{text!r} is not name=place,name=place")
    return out


def numbers(text: str) -> list[float]:
    """Numbers separated by commas."""
    return [number(x) for x in text.split(",")]


def choice_at(*choices: str) -> Callable[[str], tuple[str, float]]:
    """A type for `choice@seconds`."""

    def parse(text: str) -> tuple[str, float]:
        name, at, seconds = text.partition("@")
        if name not in choices or not at:
            raise ArgumentTypeError(
                f"{text!r} is not POSE@SECONDS with POSE {' or '.join(choices)}"
            )
        return name, number(seconds)

    return parse


def add_body(parser: ArgumentParser) -> None:
    """How a body is drawn."""
    parser.add_argument(
        "--body", choices=LOOKS,
        help="how bodies look (default: mesh; with --smpl, your SMPL mesh)",
    )  # fmt: skip


def check_body(args: Namespace) -> None:
    """Raises UsageError for a look that needs a file which was not given."""
    if args.body == "smpl" and args.smpl is None:
        raise UsageError("argument --body: smpl needs --smpl FILE, your SMPL body")


def add_reading(parser: ArgumentParser, rate_too: bool = True) -> None:
    """What a user may say about a file that the file does not say itself."""
    group = parser.add_argument_group("what the file does not say")
    group.add_argument("--height", type=stature, metavar="M", help="the body's stature in m")
    group.add_argument("--scale", type=positive, metavar="X", help="m per length unit of the file")
    if rate_too:
        group.add_argument(
            "--rate", type=rate, metavar="HZ", help="frame rate of the samples in the file"
        )
    group.add_argument(
        "--units", type=units, default=frozenset(), metavar="U,U", help=", ".join(UNITS)
    )
    group.add_argument(
        "--up", choices=("y", "z"), help="the axis that points up, where a motion lies on its side"
    )
    group.add_argument("--smpl", type=file, metavar="FILE", help="your SMPL body file")
    group.add_argument(
        "--map",
        type=mapping,
        metavar="NAME=PLACE,...",
        help="names in the file and the places (or joints) they stand for; or a file with them",
    )


def reading(args: Namespace) -> Options:
    """The reader's options of parsed arguments; what the command does not offer is unset."""
    from mocap.formats import Options

    return Options(
        height=getattr(args, "height", None),
        scale=getattr(args, "scale", None),
        rate_hz=getattr(args, "rate", None),
        units=getattr(args, "units", frozenset()),
        up=getattr(args, "up", None),
        smpl=getattr(args, "smpl", None),
        mapping=getattr(args, "map", None),
    )


def add_horizon(parser: ArgumentParser) -> None:
    """--horizon and --lag: of the hybrid's window."""
    parser.add_argument(
        "--horizon", type=number, metavar="SECONDS",
        help="hybrid: length of the window that each pose rests on (default: 0.4; 0: a frame alone)",
    )  # fmt: skip
    parser.add_argument(
        "--lag", type=_frames, metavar="FRAMES",
        help="hybrid: frames that a pose waits for (default: the network's look-ahead; 0: none; more are "
        "more accurate)",
    )  # fmt: skip


def horizon(args: Namespace) -> dict[str, Any]:
    """The hybrid's settings that --horizon and --lag name. Raises UsageError."""
    given = {"--horizon": args.horizon, "--lag": args.lag}
    for name, value in given.items():
        if value is not None and not args.method.startswith("hybrid"):
            raise UsageError(f"argument {name}: it is the hybrid's")
    if args.horizon is not None and not 0 <= args.horizon <= MOST_HORIZON_S:
        raise UsageError(f"argument --horizon: 0 to {MOST_HORIZON_S:g} s, got {args.horizon:g}")
    if args.lag is not None and args.horizon == 0:
        raise UsageError(
            "argument --lag: without a window (--horizon 0) it is the network's look-ahead"
        )
    found = {"horizon_s": args.horizon, "lag": args.lag}
    return {k: v for k, v in found.items() if v is not None}


def _frames(text: str) -> int:
    if not text.strip().isdecimal() or int(text) > MOST_LAG:
        raise ArgumentTypeError(f"{text!r} is not a number of frames from 0 to {MOST_LAG}")
    return int(text)


def add_json(parser: ArgumentParser) -> None:
    """--json."""
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def add_window(parser: ArgumentParser) -> None:
    """--from and --to, in s on the recording's clock."""
    for flag, dest, what in (("--from", "begin", "begin at"), ("--to", "end", "end before")):
        parser.add_argument(
            flag, dest=dest, type=number, metavar="S", help=f"{what} this time in s"
        )


def add_solving_rate(parser: ArgumentParser) -> None:
    """--rate, of the frames that are estimated."""
    parser.add_argument(
        "--rate", type=rate, metavar="HZ",
        help="estimate a faster recording at this rate at most, and give the poses back at its own "
        "(default: 120)",
    )  # fmt: skip


def add_output(parser: ArgumentParser, metavar: str, help: str) -> None:
    """-o FILE, required."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=help)


def add_motion_output(parser: ArgumentParser) -> None:
    """-o for the motion that a command makes."""
    what = f"the motion: an AMASS-style .npz, or {', '.join(SUFFIXES[1:])} for other tools"
    add_output(parser, "MOTION.npz", f"{what} (poser convert has more to say of these)")


def check_uncertainty(args: Namespace) -> None:
    """Raises UsageError where --uncertainty is to go into a file that cannot hold it."""
    suffix = args.output.suffix.lower()
    if args.uncertainty and suffix != ".npz":
        raise UsageError(
            f"argument --uncertainty: a {suffix} file cannot hold it, an .npz file can"
        )


def stand_behind(parser: ArgumentParser, dest: str) -> None:
    """Let the last positional argument, one that may be left out, stand behind options too.

    argparse settles it with the positional before it, and options between the two leave it out: of
    `train dip -o run MOTION` it would not know the MOTION.
    """
    strict = parser.parse_known_args

    def parse(args: Sequence[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:
        found, rest = strict(args, namespace)
        given = getattr(found, dest)
        if any(word.startswith("-") for word in rest):
            return found, rest  # an option that is not known, and perhaps its value
        if isinstance(given, list):
            setattr(found, dest, [*given, *map(Path, rest)])
            return found, []
        if given is None and len(rest) == 1:
            setattr(found, dest, Path(rest[0]))
            return found, []
        return found, rest

    vars(parser)["parse_known_args"] = parse


def sensors(spec: str | None, available: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Sensor names of a spec, in which sets and names may be mixed; None means all. A name that no table
    knows is wrong usage.
    """
    from mocap import sensors as places
    from mocap.errors import SensorError

    if spec is not None and not spec.strip():
        raise UsageError("argument --sensors: is empty")
    if available is None:
        try:
            return places.parse(_without_sets(spec or "six", places.SUIT))
        except SensorError as e:
            raise UsageError(f"argument --sensors: {e}") from e
    names = _spelt(spec or "all", available)
    sets = [n for n in ("six", "five") if set(places.SETS[n]) <= set(available)]
    _check_there([n for n in names if n not in available], available, sets)
    return names


def served(
    spec: str | None, available: tuple[str, ...], option: str = "--sensors"
) -> dict[str, str]:
    """Name -> the sensor that a network reads for it, of those `available`; a spec as `sensors` takes it.

    A place that is absent is served by another sensor on the same bone, and of `five` what there is will do:
    networks know bones. Raises SensorError for a name that nothing serves.
    """
    from mocap import sensors as places
    from poser.estimators import stand_in

    if spec is not None and not spec.strip():
        raise UsageError(f"argument {option}: is empty")

    def of(names: Sequence[str]) -> dict[str, str]:
        known = (n for n in names if n in available or n in places.PLACES)
        return {n: s for n in known if (s := stand_in(n, available)) is not None}

    names = _spelt(spec or "all", available)
    found = of(names)
    free = places.FIVE if found and "five" in _words(spec or "all") else ()
    sets = [n for n in ("six", "five") if len(of(places.SETS[n])) == len(places.SETS[n])]
    _check_there([n for n in names if n not in found and n not in free], available, sets)
    return found


def _check_there(missing: Sequence[str], available: tuple[str, ...], sets: Sequence[str]) -> None:
    """Raises SensorError for the first of what is missing, naming what there is. sets: beside `all`."""
    from mocap.errors import SensorError

    if missing:
        which = f"the sets {', '.join(sets)}, all" if sets else "all"
        raise SensorError(
            f"sensor {', '.join(missing)} not in the recording; there is: {', '.join(available)} (or {which})"
        )


def _words(spec: str) -> list[str]:
    return [n.strip() for n in spec.split(",")]


def _spelt(spec: str, every: tuple[str, ...]) -> tuple[str, ...]:
    """The names of a list, its sets written out. Raises SensorError where one stands there twice."""
    from mocap import sensors as places

    if spec.strip() == "all":
        return every
    listed = _without_sets(spec, every)
    names = places.SETS.get(listed.strip()) or tuple(n for n in _words(listed) if n)
    return places.parse(",".join(names), names)


def _without_sets(spec: str, every: tuple[str, ...]) -> str:
    """A list with its sets written out, each name once: `six,left_foot`. every: what `all` is."""
    from mocap import sensors as places

    names = _words(spec)
    sets = {**places.SETS, "all": every}
    if len(names) == 1 or not any(n in sets for n in names):
        return spec
    return ",".join(dict.fromkeys(m for n in names for m in sets.get(n, (n,))))
