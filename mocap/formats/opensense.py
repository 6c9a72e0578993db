"""OpenSense `.sto`: a table of sensor orientations, one quaternion `w,x,y,z` per sensor and row.

The file holds no accelerations: acc is NaN, gyr is the rate of the orientation. The world's axes are not
in the file either; z up is assumed, as the Xsens reader of OpenSim writes it ("y-up" among the units
overrides).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Document, Format, Options, _checks, _clock, _opensim, _text, check_mapped
from mocap.orientation import Array
from mocap.recording import RawRecording

Lines = Iterator[tuple[int, str]]
MAX_HEADER = 1000


def _header(path: Path, lines: Lines) -> dict[str, str]:
    found: dict[str, str] = {}
    for number, line in lines:
        if line.strip() == "endheader":
            return found
        if number > MAX_HEADER:
            break
        key, _, value = line.partition("=")
        found[key.strip().lower()] = value.strip()
    raise FormatError(path, "no line 'endheader'")


def _rows(path: Path, lines: Lines, columns: list[str]) -> tuple[Array, Array]:
    """Times (T,) s and quaternions (T,S,4); missing cells (`NaN`) stay NaN."""
    names = ["time", *(f"{c} {x}" for c in columns for x in "wxyz")]
    rows = _text.Rows(path, names)
    for number, line in lines:
        if not line.strip():
            continue
        cells = line.rstrip("\t").split("\t")
        if len(cells) != 1 + len(columns):
            raise FormatError(
                path, f"{len(cells)} columns, expected {1 + len(columns)}", f"line {number}"
            )
        values = [cells[0]]
        for name, cell in zip(columns, cells[1:], strict=True):
            four = cell.split(",") if "," in cell else ["nan"] * 4 if _is_nan(cell) else [cell]
            if len(four) != 4:
                raise FormatError(
                    path, f"{len(four)} numbers, expected w,x,y,z", f"line {number}, column {name}"
                )
            values += four
        rows.add(number, values)
    table = rows.table()
    return table[:, 0], table[:, 1:].reshape(len(table), len(columns), 4)


def _is_nan(cell: str) -> bool:
    return cell.strip().lower() in ("nan", "")


def _names(columns: list[str], options: Options) -> tuple[str, ...]:
    given = _opensim.given(options)
    return tuple(given.get(c, _opensim.place(c)) for c in columns)


def _read(path: Path, options: Options) -> Document:
    lines = _text.lines(path)
    header = _header(path, lines)
    kind = header.get("datatype", "")
    if kind.lower() != "quaternion":
        raise FormatError(path, f"DataType is {kind or 'not given'!r}, expected 'Quaternion'")
    number, line = next(lines, (0, ""))
    first, *columns = line.rstrip("\t").split("\t")
    if first.strip().lower() != "time" or not columns:
        raise FormatError(
            path, f"{line[:40]!r}, expected 'time' and sensor names", f"line {number}"
        )
    t, quat = _rows(path, lines, columns)
    check_mapped(path, options.mapping, columns)
    sensors = _names(columns, options)
    if len(t) == 1 and options.rate_hz is None:
        raise FormatError(path, "one row only, so no rate (say rate)")
    doubts: list[Finding] = []
    if len(t) > 1:
        clock = _clock.grid(path, t)
        rate, frames, doubts = clock.rate_hz, clock.frames, list(clock.doubts)
    else:
        rate, frames = float(options.rate_hz or 0), np.zeros(len(t), np.int64)
    R, zeros = _checks.quaternions(path, quat, sensors, "quaternion")
    if zeros:
        doubts.append(doubt("zero-quaternions", count=zeros))
    z_up = "y-up" not in options.units
    full = np.full((int(frames[-1]) + 1 if len(frames) else 0, len(sensors), 3, 3), np.nan)
    full[frames] = ori.R_YUP_ZUP @ R if z_up else R
    if not len(full):
        raise FormatError(path, "no row after the header")
    rec = RawRecording(
        rate, sensors, _checks.rates(full, rate), np.full((*full.shape[:2], 3), np.nan),
        R_world_sensor=full, start_s=float(t[0]),
    )  # fmt: skip
    return Document(
        "opensense",
        rec,
        (
            assumption("world-undeclared", world="z-up" if z_up else "y-up"),
            assumption("orientations-alone"),
            *([_opensim.TORSO] if "sternum" in sensors else []),
        ),
        (*doubts, *_opensim.unknown(sensors), *_checks.gap_report(rec.valid, sensors)),
    )


def _sniff(path: Path, head: bytes) -> bool:
    return b"datatype" in head.lower() or b"endheader" in head.lower()


FORMAT = Format(
    "opensense",
    (".sto",),
    _sniff,
    _checks.quiet(_read),
    kinds=("raw",),
    about="OpenSense tables of orientations",
    sign="OpenSense tables (DataType in the header)",
)
