"""CSV: one wide table, or a folder with one file per sensor.

Columns are named `<sensor>.<quantity>`, in a sensor's own file `<quantity>` alone: acc_x..z with
gravity, gyr_x..z, mag_x..z, quat_w, quat_x..z (sensor to world), and `t` in s. Comment lines `#` before
the header may declare `acc: m/s^2` (or g), `gyr: rad/s` (or deg/s), `world: y-up` (or z-up) and
`rate_hz: 100`; the options override them. Declared units are held against gravity; undeclared ones are
inferred from it, with a warning. Where the acceleration holds no gravity, the orientation puts it back.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.calibration import measures as unit_checks
from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import (
    Content,
    Document,
    Format,
    Options,
    _checks,
    _clock,
    _delimited,
    _opensim,
    _physics,
    _text,
    check_mapped,
)
from mocap.formats._files import write_aside
from mocap.orientation import Array
from mocap.recording import RawRecording

_GROUPS = {
    "acc": ("acc_x", "acc_y", "acc_z"),
    "gyr": ("gyr_x", "gyr_y", "gyr_z"),
    "mag": ("mag_x", "mag_y", "mag_z"),
    "quat": ("quat_w", "quat_x", "quat_y", "quat_z"),
}
_QUANTITY = {q: g for g, columns in _GROUPS.items() for q in columns}
_TIME = ("t", "time", "time_s")
_DECLARED = re.compile(r"\b(acc|gyr|world|rate_hz)\s*[:=]\s*([^\s,;]+)")
_ACC_UNITS = {"m/s^2": 1.0, "m/s2": 1.0, "g": ori.GRAVITY, "mg": ori.GRAVITY / 1000}
_GYR_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180, "dps": np.pi / 180}
_WORLDS = ("y-up", "z-up")
MAX_SENSORS = 64
# Shares of the mean size that the mean vector in the world has: without gravity, and of gravity alone.
AVERAGED_OUT, ALL_ONE_WAY = 0.35, 0.9
AT_REST = 0.5  # m/s^2


@dataclass(frozen=True, eq=False)
class _Table:
    """One file: what it declares, its time stamps (N,) or None, {sensor: {group: (N,k)}}, odd columns."""

    path: Path
    declared: dict[str, str]
    t: Array | None
    sensors: dict[str, dict[str, Array]]
    ignored: tuple[str, ...]


def _declarations(line: str) -> dict[str, str]:
    return {m[1]: m[2] for m in _DECLARED.finditer(line.lower())}


def _columns(
    path: Path, header: list[str], number: int
) -> tuple[dict[str, dict[str, list[int]]], list[str]]:
    """{sensor: {group: column indices}} of a header, and the columns that are none of these."""
    where: dict[str, dict[str, int]] = {}
    ignored = []
    for i, column in enumerate(header):
        sensor, dot, quantity = column.rpartition(".")
        quantity = quantity.lower()
        if quantity in _QUANTITY:
            seen = where.setdefault(sensor if dot else path.stem, {})
            if quantity in seen:
                raise FormatError(path, f"column {column!r} occurs twice", f"line {number}")
            seen[quantity] = i
        elif column and column.lower() not in _TIME:
            ignored.append(column)
    found: dict[str, dict[str, list[int]]] = {}
    for sensor, have in where.items():
        for group, wanted in _GROUPS.items():
            missing = [q for q in wanted if q not in have]
            if not missing:
                found.setdefault(sensor, {})[group] = [have[q] for q in wanted]
            elif len(missing) < len(wanted):
                raise FormatError(
                    path, f"no column {missing[0]}", f"line {number}, sensor {sensor}"
                )
    if not found:
        raise FormatError(path, "no column such as <sensor>.acc_x", f"line {number}")
    if len(found) > MAX_SENSORS:
        raise FormatError(path, f"{len(found)} sensors, at most {MAX_SENSORS} are read")
    return found, ignored


def _parse(path: Path) -> _Table:
    table = _delimited.open_table(path, _known, "<sensor>.acc_x")
    declared: dict[str, str] = {}
    for line in table.preamble:
        if line.startswith("#"):
            declared |= _declarations(line[1:])
    header = list(table.header)
    found, ignored = _columns(path, header, table.line)
    time = [i for i, c in enumerate(header) if c.lower() in _TIME][:1]
    indices = [i for groups in found.values() for own in groups.values() for i in own]
    values = table.columns([*time, *indices])
    start = len(time)
    sensors: dict[str, dict[str, Array]] = {}
    for sensor, groups in found.items():
        for group, own in groups.items():
            sensors.setdefault(sensor, {})[group] = values[:, start : start + len(own)]
            start += len(own)
    return _Table(path, declared, values[:, 0] if time else None, sensors, tuple(ignored))


def _known(cells: list[str]) -> bool:
    """Whether these are column names of ours, of which some quantity has its first axis."""
    return any(c.rpartition(".")[2].lower() in _QUANTITY for c in cells)


def _merged(path: Path, tables: list[_Table]) -> dict[str, str]:
    """What the files declare together; they must agree."""
    declared: dict[str, str] = {}
    for table in tables:
        for key, value in table.declared.items():
            if declared.setdefault(key, value) != value:
                raise FormatError(
                    table.path, f"declares {key} {value!r}, another file {declared[key]!r}"
                )
    return declared


def _timed(
    path: Path, tables: list[_Table], declared: dict[str, str], options: Options
) -> tuple[float, list[np.ndarray], int, float, list[Finding]]:
    """Rate, the frame of every row of every file, number of frames, time of frame 0, doubts."""
    given = options.rate_hz
    if given is None and "rate_hz" in declared:
        given = _text.number(path, declared["rate_hz"], "declared rate_hz")
    doubts: list[Finding] = []
    if any(t.t is None for t in tables):
        if given is None:
            raise FormatError(path, "no column t and no rate_hz (say rate)")
        lengths = [len(next(iter(next(iter(t.sensors.values())).values()))) for t in tables]
        if len(set(lengths)) > 1:
            doubts.append(doubt("rows-differ", least=min(lengths), most=max(lengths)))
        return given, [np.arange(min(lengths)) for _ in tables], min(lengths), 0.0, doubts
    stamps = [np.asarray(t.t) for t in tables]
    grids = [_clock.grid(t.path, s, "column t") for t, s in zip(tables, stamps, strict=True)]
    rates = [g.rate_hz for g in grids]
    rate = float(np.median(rates))
    for table, own in zip(tables, rates, strict=True):
        if own < 1:
            raise FormatError(table.path, f"steps of {1 / own:.3g}, expected seconds", "column t")
        if abs(own / rate - 1) > 0.005:
            raise FormatError(table.path, f"{own:.4g} Hz, other files {rate:.4g} Hz", "column t")
    if given is not None and abs(rate / given - 1) > 0.05:
        raise FormatError(path, f"runs at {rate:.4g} Hz, {given:g} Hz was said", "column t")
    start = min(float(s[0]) for s in stamps)
    frames = []
    for table, clock, stamp in zip(tables, grids, stamps, strict=True):
        by_count = clock.frames + round((float(stamp[0]) - start) * rate)
        by_time = np.rint((clock.slow_s - start) * rate).astype(np.int64)
        apart = int(np.abs(by_time - by_count).max())
        if len(tables) > 1 and apart > 1:
            ppm = 1e6 * abs(clock.rate_hz / rate - 1)
            doubts.append(doubt("clock-off", file=table.path.name, ppm=ppm, frames=apart))
            by_count = np.maximum(by_time, 0)
        frames.append(by_count)
    span = max(int(f[-1]) for f in frames) + 1
    if span > _clock.MAX_GROWTH * max(len(s) for s in stamps) + 10:
        raise FormatError(path, "the files' times hardly overlap", "column t")
    return rate, frames, span, start, doubts + [d for g in grids for d in g.doubts]


def _placed(values: Sequence[Array | None], frames: list[np.ndarray], T: int, width: int) -> Array:
    """(T,S,width) with NaN where a sensor has no row or no such quantity."""
    out = np.full((T, len(values), width), np.nan)
    for s, (value, at) in enumerate(zip(values, frames, strict=True)):
        if value is not None:
            out[at, s] = value[: len(at)]
    return out


def _unit(
    path: Path, what: str, units: dict[str, float], declared: dict[str, str], options: Options
) -> float | None:
    """Factor to SI of the unit that the options or the file declare; None where neither does."""
    said = [u for u in options.units if u in units]
    if len(said) > 1:
        raise FormatError(path, f"units {' and '.join(sorted(said))} contradict each other")
    name = said[0] if said else declared.get(what)
    if name is None:
        return None
    if name not in units:
        raise FormatError(
            path, f"unit {name!r}, expected one of {', '.join(units)}", f"declared {what}"
        )
    return units[name]


def _in_si(
    path: Path, rec: RawRecording, declared: dict[str, str], options: Options
) -> tuple[RawRecording, list[Finding]]:
    """`rec` in m/s^2 and rad/s. What is not declared is inferred from gravity and plausible speed."""
    doubts = []
    acc = _unit(path, "acc", _ACC_UNITS, declared, options)
    if acc is None and _gravity_free(rec, 1.0):
        acc = 1.0
        doubts.append(doubt("acc-undeclared-free"))
    elif acc is None:
        unit, size, when = _by_gravity(path, rec)
        acc = _ACC_UNITS[unit]
        if np.isfinite(rec.acc).any():
            doubts.append(doubt("acc-undeclared", unit=unit, size=size, when=when))
    gyr = _unit(path, "gyr", _GYR_UNITS, declared, options)
    rec = replace(rec, acc=rec.acc * acc)
    if gyr is None and not np.isfinite(rec.gyr).any():
        gyr = 1.0
    elif gyr is None:
        unit = "deg/s" if _physics.gyr_in_degrees(rec) else "rad/s"
        gyr = _GYR_UNITS[unit]
        doubts.append(doubt("gyr-undeclared", unit=unit))
    return replace(rec, gyr=rec.gyr * gyr), doubts


def _by_gravity(path: Path, rec: RawRecording) -> tuple[str, float | None, str]:
    """The unit in which acc holds gravity, and how that is known; raises FormatError where none fits.

    By still sensors, else by the mean over half seconds, within a factor of two: units are ten apart.
    """
    still = unit_checks.gravity_size(rec.acc, rec.rate_hz)
    usual, sample = unit_checks.usual_force(rec.acc, rec.rate_hz)
    size, when = _median(still), "when still"
    if np.isnan(size):
        size, when = _median(usual), "in the mean over half seconds"
    if np.isnan(size):
        return "m/s^2", None, ""
    near = [u for u, f in _ACC_UNITS.items() if 0.5 < size * f / ori.GRAVITY < 2]
    found = f"{size:.3g} {when}"
    if not near:
        raise FormatError(path, f"{found}, gravity in none of m/s^2, g, mg{_physics.FREE}", "acc")
    if size < 0.5 * ori.GRAVITY and _median(usual / sample) < unit_checks.KEPT:
        raise FormatError(path, f"{found}, less than movement{_physics.FREE}", "acc")
    return near[0], size, when


def _gravity_free(rec: RawRecording, to_si: float) -> bool:
    """Whether the mean acceleration, turned to the world, is none: gravity would be left of it.

    Movement averages out; of a sensor at rest little but noise is left. Only orientations can tell that, and
    put gravity back. to_si: of the declared unit.
    """
    if rec.R_world_sensor is None or not np.isfinite(rec.acc).any():
        return False
    force = np.einsum("tsij,tsj->tsi", rec.R_world_sensor, rec.acc)
    mean = np.linalg.norm(np.nanmean(force, axis=0), axis=-1)
    share = _median(mean / np.nanmean(np.linalg.norm(force, axis=-1), axis=0))
    return share < AVERAGED_OUT or (share < ALL_ONE_WAY and _median(mean) * to_si < AT_REST)


def _median(x: Array) -> float:
    """Median of the finite values of x (S,); NaN where there is none."""
    known = x[np.isfinite(x)]
    return float(np.median(known)) if len(known) else float("nan")


def _world(
    path: Path, R: Array, acc: Array, declared: dict[str, str], options: Options
) -> tuple[Array, Finding]:
    """R_world_sensor in our y-up world, and what was assumed. Undeclared: up is where gravity points."""
    said = [w for w in _WORLDS if w in options.units]
    world = said[0] if said else declared.get("world")
    if world is not None and world not in _WORLDS:
        raise FormatError(path, f"is {world!r}, expected y-up or z-up", "declared world")
    source = "as declared"
    if world is None:
        force = np.einsum("tsij,tsj->tsi", R, acc).reshape(-1, 3)
        force = force[np.isfinite(force).all(-1)]
        mean = force.mean(axis=0) if len(force) else np.zeros(3)
        typical = float(np.linalg.norm(force, axis=1).mean()) if len(force) else 1.0
        told = bool(np.linalg.norm(mean) > 0.5 * typical)  # else gravity is not in it
        world = "y-up" if told and mean[1] > mean[2] else "z-up"
        source = "by gravity" if told else "assumed, the file does not say"
    taken = assumption("quaternions-into", world=world, source=source)
    return (R if world == "y-up" else ori.R_YUP_ZUP @ R), taken


def _read(path: Path, options: Options) -> Document:
    files = _files(path) if path.is_dir() else [path]
    tables = [_parse(p) for p in files]
    declared = _merged(path, tables)
    rate, frames_of, T, start, doubts = _timed(path, tables, declared, options)
    given = _opensim.given(options)
    names = [n for t in tables for n in t.sensors]
    check_mapped(path, options.mapping, names)
    columns = [c for t in tables for c in t.sensors.values()]
    frames = [f for f, t in zip(frames_of, tables, strict=True) for _ in t.sensors]
    sensors = tuple(given.get(n, n) for n in names)
    acc, gyr, mag, quat = (
        _placed([c.get(g) for c in columns], frames, T, len(_GROUPS[g])) for g in _GROUPS
    )
    R, assumed = None, []
    if any("quat" in c for c in columns):
        R, zeros = _checks.quaternions(path, quat, sensors, "quat")
        R, world = _world(path, R, acc, declared, options)
        assumed.append(world)
        doubts += [doubt("zero-quaternions", count=zeros)] if zeros else []
    has_mag = all("mag" in c for c in columns)
    rec = RawRecording(rate, sensors, gyr, acc, mag if has_mag else None, R, start_s=start)
    free = _gravity_free(rec, _unit(path, "acc", _ACC_UNITS, declared, options) or 1.0)
    rec, more = _in_si(path, rec, declared, options)
    doubts += more
    if free and rec.R_world_sensor is not None:
        up = np.array([0.0, ori.GRAVITY, 0.0])
        rec = replace(rec, acc=rec.acc + np.einsum("tsji,j->tsi", rec.R_world_sensor, up))
        assumed.append(assumption("gravity-put-back"))
    blind = [s for s, c in enumerate(columns) if "gyr" not in c and "quat" in c]
    if blind and rec.R_world_sensor is not None:
        gyr = rec.gyr.copy()
        gyr[:, blind] = _checks.rates(rec.R_world_sensor[:, blind], rate)
        rec = replace(rec, gyr=gyr, valid=np.ones(acc.shape[:2], bool))
        names = [sensors[s] for s in blind]
        assumed.append(assumption("rates-of-orientation-of", sensors=", ".join(names)))
    ignored = sorted({c for t in tables for c in t.ignored})
    if ignored:
        doubts.append(doubt("columns-left-out", columns=", ".join(ignored[:12])))
    doubts += [*_opensim.unknown(sensors), *_physics.raw(path, rec)]
    return Document("csv", rec, (*assumed, *_physics.assumed(rec)), tuple(doubts))


def _files(folder: Path) -> list[Path]:
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".csv", ".tsv"))
    if not found or len(found) > MAX_SENSORS:
        raise FormatError(folder, f"{len(found)} CSV files, expected 1 to {MAX_SENSORS}")
    return found


def _write(path: Path, content: Content) -> None:
    """A raw recording as one wide table, in SI units and our y-up world; NaN cells stay empty."""
    if not isinstance(content, RawRecording):
        raise FormatError(path, "CSV holds raw recordings only")
    groups = [("acc", content.acc), ("gyr", content.gyr)]
    if content.mag is not None:
        groups.append(("mag", content.mag))
    if content.R_world_sensor is not None:
        quat = np.full((*content.acc.shape[:2], 4), np.nan)
        has = np.isfinite(content.R_world_sensor).all((-1, -2))
        quat[has] = ori.to_quat(content.R_world_sensor[has])
        groups.append(("quat", quat))
    names = ["t"]
    blocks = [content.start_s + np.arange(len(content))[:, None] / content.rate_hz]
    for s, sensor in enumerate(content.sensors):
        for group, values in groups:
            names += [f"{sensor}.{q}" for q in _GROUPS[group]]
            blocks.append(values[:, s])
    rows = np.concatenate(blocks, axis=1)
    with write_aside(path) as aside, aside.open("w", encoding="utf-8") as f:
        f.write(f"# acc: m/s^2, gyr: rad/s, world: y-up, rate_hz: {content.rate_hz:.9g}\n")
        f.write(",".join(names) + "\n")
        for row in rows:
            f.write(",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) + "\n")


def _sniff(path: Path, head: bytes) -> bool:
    if path.is_dir():
        return any(p.suffix.lower() in (".csv", ".tsv") for p in path.iterdir())
    return b"\0" not in head and any(c[0].encode() in head.lower() for c in _GROUPS.values())


FORMAT = Format(
    "csv",
    (".csv", ".tsv", ""),
    _sniff,
    _checks.quiet(_read),
    _write,
    kinds=("raw",),
    about="a table of all sensors, or a folder with one a sensor",
    sign="tables with columns such as pelvis.acc_x (docs/conventions.md)",
)
