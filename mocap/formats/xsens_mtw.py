"""Xsens exports of MT Manager and of the DOT app: one file a device, read one by one or a folder a take.

`_xsens_export` reads a file. Devices of a take are aligned by their PacketCounter (MT; it wraps at 65536) or
by SampleTimeFine (DOT, where they were synchronised); what the radio lost stays a gap. Each is named by its
tag or by what its file's name has of its own; a mapping file of OpenSim's reader beside them, or --map,
says where it sits.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.findings import Finding, assumption, distinct, doubt
from mocap.formats import (
    Document,
    Format,
    Options,
    _checks,
    _clock,
    _opensim,
    _physics,
    _xsens_export,
)
from mocap.formats._xsens_export import SensorExport
from mocap.orientation import Array
from mocap.recording import RawRecording

_COUNTER = "PacketCounter"
_DEVICE = re.compile(r"[0-9A-Fa-f]{6,16}")
SUFFIXES = (".txt", ".csv", ".tsv")
WRAP = 1 << 16
MAX_FILES = 64


def _aligned(
    path: Path, exports: list[SensorExport], rate: float
) -> tuple[list[_clock.Frames], list[Finding]]:
    """The frame of every row of every file on one clock, counted from the earliest, and doubts."""
    if all(e.dot and e.seconds is not None for e in exports):
        return _by_time(path, exports, rate)
    if any(e.packets is None for e in exports):
        several = len(exports) > 1
        aligned = [doubt("no-counter")] if several else []
        return [np.arange(len(e)) for e in exports], aligned
    counters = [_unwrapped(e) for e in exports]
    # Counters of one trial start within seconds of each other, but on either side of a wrap.
    first = counters[0][0]
    counters = [c + WRAP * np.rint((first - c[0]) / WRAP) for c in counters]
    start, stop = min(c[0] for c in counters), max(c[-1] for c in counters) + 1
    span, longest = int(stop - start), max(len(c) for c in counters)
    if span > _clock.MAX_GROWTH * longest + 10:
        found = f"packets span {span} frames, yet no sensor has more than {longest}"
        raise FormatError(path, found, _COUNTER)
    return [(c - start).astype(np.int64) for c in counters], []


def _by_time(
    path: Path, exports: list[SensorExport], rate: float
) -> tuple[list[_clock.Frames], list[Finding]]:
    """By the clock that synchronised DOTs share; by their first rows where there is none."""
    stamps = [np.asarray(e.seconds) for e in exports]
    grids = [_clock.grid(e.path, s, "SampleTimeFine") for e, s in zip(exports, stamps, strict=True)]
    doubts = [d for g in grids for d in g.doubts]
    if len(exports) > 1:
        named = zip(exports, grids, strict=True)
        doubts = [d for e, g in named for d in _clock.within(e.path.name, g.doubts)]
    begin = min(float(s[0]) for s in stamps)
    if max(float(s[0]) for s in stamps) > min(float(s[-1]) for s in stamps):
        doubts.append(doubt("not-synchronised"))
        return [g.frames for g in grids], doubts
    return [
        g.frames + round((float(s[0]) - begin) * rate) for g, s in zip(grids, stamps, strict=True)
    ], doubts


def _unwrapped(export: SensorExport) -> Array:
    packets = export.packets
    assert packets is not None
    bad = ~((packets >= 0) & (packets < 1e9) & (packets == np.floor(packets)))
    if bad.any():
        k = int(np.argmax(bad))
        raise FormatError(
            export.path, f"is {packets[k]:g}, expected a count", f"row {k + 1}, {_COUNTER}"
        )
    step = np.diff(packets)
    step = np.where(step < -WRAP / 2, step + WRAP, step)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0)) + 1
        found = f"{packets[k]:.0f} after {packets[k - 1]:.0f}, must rise"
        raise FormatError(export.path, found, f"row {k + 1}, {_COUNTER}")
    return packets[0] + np.r_[0.0, np.cumsum(step)]


def _placed(
    values: Sequence[Array | None], frames: list[_clock.Frames], T: int, shape: tuple[int, ...]
) -> Array:
    """(T,S,*shape) with NaN where a sensor has no row, or no such quantity."""
    out = np.full((T, len(values), *shape), np.nan)
    for s, (value, at) in enumerate(zip(values, frames, strict=True)):
        if value is not None:
            out[at, s] = value
    return out


def _files(folder: Path, prefix: str) -> tuple[list[Path], list[Finding]]:
    """The exports of a folder, and which other tables in it are left out."""
    tables = sorted(
        p
        for p in folder.iterdir()
        if p.suffix.lower() in SUFFIXES and p.is_file() and p.name.startswith(prefix)
    )
    empty = [p for p in tables if not p.stat().st_size]
    if empty:
        raise FormatError(empty[0], "the file is empty")
    found = [p for p in tables if _looks(_head(p))]
    if not found:
        raise FormatError(folder, f"no file {prefix}* that MT Manager or the DOT app exported")
    if len(found) > MAX_FILES:
        raise FormatError(folder, f"{len(found)} files, at most {MAX_FILES} sensors are read")
    others = [p.name for p in tables if p not in found]
    return found, [doubt("files-left-out", files=", ".join(others[:5]))] if others else []


def _names(folder: Path, exports: list[SensorExport]) -> list[str]:
    """A name for each device: its tag, else its number in the file's name, else what the name has of its own.

    Raises FormatError where one device has several files, which are several trials.
    """
    tags = [e.device for e in exports]
    stems = [re.split(r"[_\s]+", e.path.stem) for e in exports]
    numbers = [next((w for w in reversed(s) if _DEVICE.fullmatch(w)), s[-1]) for s in stems]
    for names in (tags, numbers):
        if all(names) and len(set(names)) == len(names):
            others = {tuple(w for w in s if w != n) for s, n in zip(stems, numbers, strict=True)}
            if names is tags or len(others) == 1:
                return names
    trials = {"_".join(w for w in s if w != n) for s, n in zip(stems, numbers, strict=True)}
    if len(set(numbers)) < len(numbers) or len({len(s) for s in stems}) > 1:
        shown = ", ".join(sorted(trials)[:4])
        raise FormatError(folder, f"{len(trials)} trials ({shown}), expected one per folder")
    return [e.path.stem for e in exports]


def _mapping(folder: Path, options: Options) -> tuple[str, dict[str, str], str]:
    """Trial prefix, {device: place}, and the file that the names come from."""
    path = options.mapping
    if isinstance(path, dict) or (path is not None and path.suffix.lower() != ".xml"):
        return "", {k.lstrip("_"): v for k, v in _opensim.given(options).items()}, ""
    if path is None:
        beside = sorted(
            p for p in folder.glob("*.xml") if p.is_file() and b"ExperimentalSensor" in _head(p)
        )
        path = beside[0] if len(beside) == 1 else None
    if path is None:
        return "", {}, ""
    prefix, names = _opensim.read_mapping(path)
    return prefix, {k: _opensim.place(v) for k, v in names.items()}, path.name


def _head(path: Path) -> bytes:
    with path.open("rb") as f:
        return f.read(4096)


def _rate(path: Path, exports: list[SensorExport], options: Options) -> tuple[float, list[Finding]]:
    """Samples per s: of the options, the headers or SampleTimeFine; and what was assumed."""
    if options.rate_hz:
        return options.rate_hz, []
    stated = {e.rate_hz for e in exports if e.rate_hz is not None}
    if len(stated) > 1:
        raise FormatError(
            path, f"files run at {sorted(stated)} Hz, expected one rate (say --rate HZ)"
        )
    if stated:
        return stated.pop(), []
    timed = [e for e in exports if e.seconds is not None]
    if not timed:
        raise FormatError(path, "no line '// Update Rate' and no SampleTimeFine: say --rate HZ")
    found = [_clock.grid(e.path, np.asarray(e.seconds), "SampleTimeFine").rate_hz for e in timed]
    rate = float(f"{np.median(found):.6g}")
    return rate, [assumption("rate-of-stamps", rate_hz=rate)]


def _read(path: Path, options: Options) -> Document:
    folder = path if path.is_dir() else path.parent
    prefix, places, source = _mapping(folder, options)
    files, left_out = _files(path, prefix) if path.is_dir() else ([path], [])
    exports = [_xsens_export.read(p) for p in files]
    devices = _names(folder, exports)
    sensors = tuple(places.get(d, d) for d in devices)
    rate, assumed = _rate(path, exports, options)
    frames, doubts = _aligned(path, exports, rate)
    doubts += left_out
    T = max(int(f[-1]) for f in frames) + 1
    acc_unit, gyr_unit = _physics.factors(options)
    turns = [e.orientation(n) for e, n in zip(exports, sensors, strict=True)]
    forces = [e.force(turn) for e, turn in zip(exports, turns, strict=True)]
    acc = acc_unit * _placed([a for a, _ in forces], frames, T, (3,))
    gyr = gyr_unit * _placed([e.columns.get("gyr") for e in exports], frames, T, (3,))
    mag, R = None, None
    if all("mag" in e.columns for e in exports):
        mag = _placed([e.columns["mag"] for e in exports], frames, T, (3,))
    if any(turn is not None for turn in turns):
        R, world = _physics.upright(_placed(turns, frames, T, (3, 3)), acc, "z-up")
        assumed.append(world)
    assumed += distinct(said for _, said in forces if said)
    if source:
        assumed.append(assumption("names-from", file=source))
    if "sternum" in sensors:
        assumed.append(_opensim.TORSO)
    blind = [s for s, e in enumerate(exports) if "gyr" not in e.columns]
    if blind and R is not None:
        gyr[:, blind] = _checks.rates(R[:, blind], rate)
        assumed.append(assumption("rates-of-orientation"))
    # Sensors stop and start one after the other: outside what all have, there is nothing to solve.
    start = max(int(f[0]) for f in frames)
    stop = min(int(f[-1]) for f in frames) + 1
    if stop <= start:
        raise FormatError(path, "the sensors' packets do not overlap in time", _COUNTER)
    if (start, stop) != (0, T):
        doubts.append(doubt("common-part", first=start, last=stop - 1, of=T))
    rec = RawRecording(rate, sensors, gyr, acc, mag, R).slice(start, stop)
    doubts += [*_opensim.unknown(sensors), *_physics.raw(path, rec)]
    name = "xsens_dot" if all(e.dot for e in exports) else "xsens_mtw"
    return Document(name, rec, (*assumed, *_physics.assumed(rec)), tuple(doubts))


def _looks(head: bytes) -> bool:
    """Whether the first bytes of a file are such an export's."""
    head = head.lower().replace(b" ", b"")
    marks = (b"packetcounter", b"sampletimefine", b"mat[1][1]", b"quat_q0", b"// updaterate")
    return any(mark in head for mark in marks) or (b"\tacc_x\t" in head and b"\tmat" in head)


def _sniff(path: Path, head: bytes) -> bool:
    if path.is_dir():
        files = (p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
        return any(_looks(_head(p)) for p in files)
    return _looks(head)


FORMAT = Format(
    "xsens_mtw",
    (*SUFFIXES, ""),
    _sniff,
    _checks.quiet(_read),
    kinds=("raw",),
    about="Xsens MT Manager and DOT exports: a file a device, or a folder",
    sign="Xsens MT Manager and DOT exports (columns PacketCounter, Acc_X, ...)",
)
