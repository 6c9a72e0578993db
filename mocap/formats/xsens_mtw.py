"""Xsens MT Manager exports: one `MT_<trial>_<device>.txt` per sensor, read one by one or as a folder.

Comment lines `//` hold the rate; then a header and rows, tab-separated, found by column name:
PacketCounter (sets the frame, wraps at 65536), Acc_X..Z m/s^2 with gravity in the sensor's frame,
Mat[r][c] or Quat_q0..q3 (sensor to a z-up world), optional Gyr_X..Z rad/s and Mag_X..Z. A mapping file
of OpenSim's reader beside them names the sensors.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Document, Format, Options, _checks, _clock, _opensim, _physics, _text
from mocap.orientation import Array
from mocap.recording import RawRecording

_RATE = re.compile(r"(?:update|sample)\s*rate:\s*([0-9.]+)\s*hz", re.IGNORECASE)
_ACC = ("Acc_X", "Acc_Y", "Acc_Z")
_GYR = ("Gyr_X", "Gyr_Y", "Gyr_Z")
_MAG = ("Mag_X", "Mag_Y", "Mag_Z")
_MAT = tuple(f"Mat[{r}][{c}]" for r in (1, 2, 3) for c in (1, 2, 3))
_QUAT = ("Quat_q0", "Quat_q1", "Quat_q2", "Quat_q3")
_COUNTER = "PacketCounter"
WRAP = 1 << 16
MAX_FILES = 64


@dataclass(frozen=True)
class _Export:
    """One file: its rate in Hz or None, packet counters (N,) or None, and columns by group."""

    path: Path
    rate_hz: float | None
    packets: Array | None
    columns: dict[str, Array]  # acc, gyr, mag (N,3); mat (N,9); quat (N,4)


def _groups(header: Sequence[str]) -> dict[str, tuple[str, ...]]:
    groups = (("packet", (_COUNTER,)), ("acc", _ACC), ("gyr", _GYR), ("mag", _MAG), ("mat", _MAT),
              ("quat", _QUAT))  # fmt: skip
    return {name: wanted for name, wanted in groups if all(c in header for c in wanted)}


def _parse(path: Path) -> _Export:
    rate: float | None = None
    header: list[str] = []
    wanted: list[int] = []
    groups: dict[str, tuple[str, ...]] = {}
    rows = _text.Rows(path, ())
    for number, line in _text.lines(path):
        if line.startswith("//"):
            found = _RATE.search(line)
            rate = _text.number(path, found[1], f"line {number}") if found else rate
        elif not header:
            header = [c.strip() for c in line.split("\t")]
            groups = _groups(header)
            missing = "Acc_X" if "acc" not in groups else "Mat[1][1] or Quat_q0"
            if "acc" not in groups or not ({"mat", "quat"} & groups.keys()):
                raise FormatError(path, f"no column {missing}", f"line {number}")
            names = [c for g in groups.values() for c in g]
            wanted = [header.index(c) for c in names]
            rows = _text.Rows(path, names)
        elif line.strip():
            cells = line.split("\t")
            if len(cells) < max(wanted) + 1:
                raise FormatError(
                    path, f"{len(cells)} columns, expected {len(header)}", f"line {number}"
                )
            # Empty cells are samples that the radio lost.
            rows.add(number, [cells[i] if cells[i].strip() else "nan" for i in wanted])
    table = rows.table() if header else np.empty((0, 0))
    if not len(table):
        raise FormatError(path, "no row of data")
    columns, start = {}, 0
    for name, cells_of in groups.items():
        columns[name] = table[:, start : start + len(cells_of)]
        start += len(cells_of)
    packets = columns.pop("packet", None)
    return _Export(path, rate, None if packets is None else packets[:, 0], columns)


def _frames(exports: list[_Export]) -> tuple[list[np.ndarray], int, list[str]]:
    """The frame of every row of every file on one clock, their number, and doubts."""
    if any(e.packets is None for e in exports):
        T = min(len(e.columns["acc"]) for e in exports)
        doubt = (
            [] if len(exports) == 1 else ["no PacketCounter: files are aligned at their first row"]
        )
        return [np.arange(T) for _ in exports], T, doubt
    counters = [_unwrapped(e) for e in exports]
    # Counters of one trial start within seconds of each other, but on either side of a wrap.
    first = counters[0][0]
    counters = [c + WRAP * np.rint((first - c[0]) / WRAP) for c in counters]
    start, stop = min(c[0] for c in counters), max(c[-1] for c in counters) + 1
    span, longest = int(stop - start), max(len(c) for c in counters)
    if span > _clock.MAX_GROWTH * longest + 10:
        raise FormatError(
            exports[0].path.parent if len(exports) > 1 else exports[0].path,
            f"packets span {span} frames, yet no sensor has more than {longest}", _COUNTER,
        )  # fmt: skip
    return [(c - start).astype(np.int64) for c in counters], span, []


def _unwrapped(export: _Export) -> Array:
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


def _placed(values: list[Array], frames: list[np.ndarray], T: int) -> Array:
    """(T,S,...) with NaN where a sensor has no row."""
    out = np.full((T, len(values), *values[0].shape[1:]), np.nan)
    for s, (value, at) in enumerate(zip(values, frames, strict=True)):
        out[at, s] = value[: len(at)]
    return out


def _orientation(export: _Export, name: str) -> Array:
    """R_world_sensor (N,3,3) of one file in our y-up world."""
    if "mat" in export.columns:
        R = export.columns["mat"].reshape(-1, 1, 3, 3)
        R = _checks.rotations(export.path, R, (name,), "Mat")
    else:
        R, _ = _checks.quaternions(export.path, export.columns["quat"][:, None], (name,), "Quat")
    return ori.R_YUP_ZUP @ R[:, 0]


def _files(folder: Path, prefix: str) -> list[Path]:
    found = sorted(p for p in folder.glob("MT_*.txt") if p.is_file() and p.name.startswith(prefix))
    trials = {p.stem.rpartition("_")[0] for p in found}
    if not found:
        raise FormatError(folder, f"no file {prefix or 'MT_'}*.txt")
    if len(trials) > 1:
        names = ", ".join(sorted(trials)[:4])
        raise FormatError(folder, f"{len(trials)} trials ({names}), expected one per folder")
    if len(found) > MAX_FILES:
        raise FormatError(folder, f"{len(found)} files, at most {MAX_FILES} sensors are read")
    return found


def _mapping(folder: Path, options: Options) -> tuple[str, dict[str, str], str]:
    """Trial prefix, {device: place}, and where the names come from."""
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
    return prefix, {k: _opensim.place(v) for k, v in names.items()}, f"named by {path.name}"


def _head(path: Path) -> bytes:
    with path.open("rb") as f:
        return f.read(4096)


def _read(path: Path, options: Options) -> Document:
    folder = path if path.is_dir() else path.parent
    prefix, places, source = _mapping(folder, options)
    exports = [_parse(p) for p in (_files(path, prefix) if path.is_dir() else [path])]
    devices = [e.path.stem.rpartition("_")[2] for e in exports]
    sensors = tuple(places.get(d, d) for d in devices)
    rates = {e.rate_hz for e in exports if e.rate_hz is not None}
    rate = options.rate_hz or (rates.pop() if len(rates) == 1 else None)
    if rate is None:
        found = f"files run at {sorted(rates)} Hz" if rates else "no line '// Update Rate'"
        raise FormatError(path, f"{found}, expected one rate (say rate)")
    frames, T, doubts = _frames(exports)
    R = _placed([_orientation(e, n) for e, n in zip(exports, sensors, strict=True)], frames, T)
    columns = {
        g: _placed([e.columns[g] for e in exports], frames, T)
        for g in ("acc", "gyr", "mag")
        if all(g in e.columns for e in exports)
    }
    columns |= {
        g: columns[g] * factor
        for g, factor in zip(("acc", "gyr"), _physics.factors(options), strict=True)
        if g in columns
    }
    assumptions = ["world is z-up in the file, y-up here"]
    if source:
        assumptions.append(f"sensors {source}")
    if "sternum" in sensors:
        assumptions.append(_opensim.TORSO)
    if "gyr" not in columns:
        assumptions.append("no rates in the file; gyr is the rate of the orientation")
        columns["gyr"] = _checks.rates(R, rate)
    # Sensors stop and start one after the other: outside what all have, there is nothing to solve.
    start = max(int(f[0]) for f in frames)
    stop = min(int(f[-1]) for f in frames) + 1
    if stop <= start:
        raise FormatError(path, "the sensors' packets do not overlap in time", _COUNTER)
    if (start, stop) != (0, T):
        doubts.append(
            f"frames {start} to {stop - 1} of {T} are read: all sensors have begun, none has ended"
        )
    rec = RawRecording(
        rate,
        sensors,
        columns["gyr"],
        columns["acc"],
        mag=columns.get("mag"),
        R_world_sensor=R,
    ).slice(start, stop)
    doubts += [*_opensim.unknown(sensors), *_physics.raw(path, rec)]
    return Document("xsens_mtw", rec, tuple(assumptions), tuple(doubts))


def _sniff(path: Path, head: bytes) -> bool:
    if path.is_dir():
        return next(path.glob("MT_*.txt"), None) is not None
    return b"PacketCounter" in head or (b"Acc_X" in head and b"\t" in head)


FORMAT = Format("xsens_mtw", (".txt", ""), _sniff, _checks.quiet(_read))
