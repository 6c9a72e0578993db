"""Tables that phone apps export, one sensor or one device a file: what their columns mean.

Sensor Logger: `time` (ns), `seconds_elapsed`, then `z, y, x`, or for watches and headphones rotationRate,
gravity, acceleration (without gravity) and quaternion. SensorLog: one wide table, units in brackets.
phyphox: `Time (s)` and columns such as `Gyroscope x (rad/s)`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import _delimited
from mocap.orientation import Array

Quantity = Literal["force", "free", "gravity", "gyr", "mag", "quat"]
App = Literal["Sensor Logger", "SensorLog", "phyphox"]
G = ori.GRAVITY

# By app: kind, the columns in lower case, their factor to SI (None: told by the size of gravity).
_WIDE: dict[App, tuple[tuple[Quantity, tuple[str, ...], float | None], ...]] = {
    "SensorLog": (
        ("force", tuple(f"accelerometeracceleration{a}(g)" for a in "xyz"), G),
        ("free", tuple(f"motionuseracceleration{a}(g)" for a in "xyz"), G),
        ("gravity", tuple(f"motiongravity{a}(g)" for a in "xyz"), G),
        ("gyr", tuple(f"motionrotationrate{a}(rad/s)" for a in "xyz"), 1.0),
        ("gyr", tuple(f"gyrorotation{a}(rad/s)" for a in "xyz"), 1.0),
        ("quat", tuple(f"motionquaternion{a}(r)" for a in "wxyz"), 1.0),
    ),
    "Sensor Logger": (
        ("free", tuple(f"acceleration{a}" for a in "xyz"), None),
        ("gravity", tuple(f"gravity{a}" for a in "xyz"), None),
        ("gyr", tuple(f"rotationrate{a}" for a in "xyz"), 1.0),
        ("quat", tuple(f"quaternion{a}" for a in "wxyz"), 1.0),
        ("quat", tuple(f"q{a}" for a in "wxyz"), 1.0),
    ),
    "phyphox": (
        ("force", tuple(f"acceleration {a} (m/s^2)" for a in "xyz"), 1.0),
        ("free", tuple(f"linear acceleration {a} (m/s^2)" for a in "xyz"), 1.0),
        ("gyr", tuple(f"gyroscope {a} (rad/s)" for a in "xyz"), 1.0),
        ("mag", tuple(f"magnetic field {a} (µt)" for a in "xyz"), 1.0),
    ),
}  # fmt: skip
# Sensor Logger's files with columns x, y, z alone, by the words in their names.
_BY_STEM: tuple[tuple[str, Quantity, float | None], ...] = (
    ("gyro", "gyr", 1.0), ("gravity", "gravity", None), ("magneto", "mag", 1.0),
    ("totalacceleration", "force", None), ("accelerometeruncalibrated", "force", None),
    ("acceler", "free", None),
)  # fmt: skip
_TIME: dict[App, tuple[tuple[str, float], ...]] = {
    "SensorLog": (
        ("motiontimestamp_sincereboot(s)", 1.0), ("accelerometertimestamp_sincereboot(s)", 1.0),
        ("gyrotimestamp_sincereboot(s)", 1.0), ("loggingsample(n)", 0.0),
    ),
    "Sensor Logger": (("time", 1e-9), ("seconds_elapsed", 1.0)),
    "phyphox": (("time (s)", 1.0),),
}  # fmt: skip
_MARKS: dict[App, tuple[bytes, ...]] = {
    "SensorLog": (b"sincereboot(s)", b"loggingtime(txt)"),
    "Sensor Logger": (b"seconds_elapsed",),
    "phyphox": (b"time (s)",),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Stream:
    """One quantity: t (N,) s, values (N,k); to_si: its factor, None where gravity must tell."""

    kind: Quantity
    path: Path
    t: Array
    values: Array
    to_si: float | None


def app_of(head: bytes) -> App | None:
    """Which app a file is of, by its first bytes."""
    head = head.lower()
    for app, marks in _MARKS.items():
        if any(mark in head for mark in marks):
            return app
    return None


def read(path: Path, app: App) -> list[Stream]:
    """The quantities in a file of an app; none for one that holds nothing of use (a place, a pedometer).

    Raises FormatError where a quantity lacks an axis, or the table no time.
    """
    table = _delimited.open_table(path, lambda cells: _time_column(app, cells) is not None, "time")
    names = [c.lower() for c in table.header]
    found = _quantities(path, app, names)
    time = _time_column(app, names)
    if time is None or not found:
        return []
    wanted = [time[0], *(names.index(c) for _, columns, _ in found for c in columns)]
    values = table.columns(wanted)
    t = values[:, 0] * time[1]
    known = np.isfinite(t)
    streams, start = [], 1
    for kind, columns, factor in found:
        own = values[:, start : start + len(columns)]
        start += len(columns)
        # A wide table repeats a slower sensor's cells or leaves them empty.
        has = known & np.isfinite(own).all(axis=1)
        if has.any():
            streams.append(Stream(kind, path, t[has], own[has], factor))
    return streams


def _time_column(app: App, cells: list[str]) -> tuple[int, float] | None:
    names = [c.lower() for c in cells]
    return next(((names.index(n), unit) for n, unit in _TIME[app] if n in names and unit), None)


def _quantities(
    path: Path, app: App, names: list[str]
) -> list[tuple[Quantity, tuple[str, ...], float | None]]:
    found: list[tuple[Quantity, tuple[str, ...], float | None]] = []
    for kind, columns, factor in _WIDE[app]:
        missing = [c for c in columns if c not in names]
        if not missing and kind not in [k for k, *_ in found]:
            found.append((kind, columns, factor))
        elif missing and len(missing) < len(columns):
            raise FormatError(path, f"no column {missing[0]}", "header")
    if app == "Sensor Logger" and not found and set("xyz") <= set(names):
        stem = path.stem.lower()
        by_stem = next(((k, f) for word, k, f in _BY_STEM if word in stem), None)
        if by_stem is not None:
            found.append((by_stem[0], ("x", "y", "z"), by_stem[1]))
    return found
