"""One file that Xsens' programs export of one device, MT Manager's or the DOT app's: what its columns mean.

Columns by name, in any order and case: PacketCounter, SampleTimeFine (DOT: us; MT: 0.1 ms), Acc_X..Z m/s^2
with gravity in the sensor's axes, FreeAcc_X..Z (or E, N, U) m/s^2 without gravity in the world's, Gyr_X..Z
(MT: rad/s; DOT: deg/s), Mag_X..Z, and the orientation, sensor to a z-up world, as Mat[r][c], Quat_q0..q3,
Quat_W..Z, or Euler angles Roll, Pitch, Yaw (Euler_X..Z) in deg: R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.findings import Finding, assumption
from mocap.formats import _checks, _delimited, _text
from mocap.orientation import Array

_RATE = re.compile(r"(?:update|sample|output)\s*rate[\s:,;]*([0-9.]+)\s*hz", re.IGNORECASE)
_TAG = re.compile(r"device\s*tag[\s:,;]+(.+)", re.IGNORECASE)
_AXES = tuple("xyz")
# Spellings of each quantity, the clearest first, as lower-case names without blanks.
_SPELT: dict[str, tuple[tuple[str, ...], ...]] = {
    "packet": (("packetcounter",), ("counter",)),
    "time": (("sampletimefine",),),
    "acc": (tuple(f"acc_{a}" for a in _AXES),),
    "free": (tuple(f"freeacc_{a}" for a in _AXES), tuple(f"freeacc_{a}" for a in "enu")),
    "gyr": (tuple(f"gyr_{a}" for a in _AXES),),
    "mag": (tuple(f"mag_{a}" for a in _AXES),),
    "mat": (tuple(f"mat[{r}][{c}]" for r in (1, 2, 3) for c in (1, 2, 3)),),
    "quat": (tuple(f"quat_q{k}" for k in range(4)), tuple(f"quat_{a}" for a in "wxyz")),
    "euler": (("roll", "pitch", "yaw"), tuple(f"euler_{a}" for a in _AXES)),
}  # fmt: skip
_ORIENTATION = ("mat", "quat", "euler")
# Columns only the DOT app writes; MT Manager's quaternions are q0 to q3.
_DOT = frozenset({"quat_w", "euler_x", "dq_w"})
LARGEST_DEG = 720.0
SHORTEST_US = (
    4000  # of a DOT, whose fastest rate is 120 Hz; MTs count in 0.1 ms and at most to 2500
)


@dataclass(frozen=True, eq=False)
class SensorExport:
    """One file. device: its tag, or "". rate_hz: stated, or None. dot: whether a DOT's.

    packets (N,), seconds (N,) on the device's clock: None where the file lacks them. columns: acc, free,
    gyr, mag (N,3) in SI units, and mat (N,9), quat (N,4) or euler (N,3) deg.
    """

    path: Path
    device: str
    rate_hz: float | None
    dot: bool
    packets: Array | None
    seconds: Array | None
    columns: dict[str, Array]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def force(self, R: Array | None) -> tuple[Array | None, Finding | None]:
        """Specific force (N,3) m/s^2 in the sensor's axes or None, and what was done to get it.

        From the free acceleration f in the world: R^T (f + g e_z). R (N,3,3): `orientation`.
        """
        if "acc" in self.columns:
            return self.columns["acc"], None
        if "free" not in self.columns or R is None:
            return None, None
        force = self.columns["free"] + np.array([0, 0, ori.GRAVITY])
        return np.einsum("tji,tj->ti", R, force), assumption("free-acc-put-back")

    def orientation(self, name: str) -> Array | None:
        """R (N,3,3), sensor to a z-up world, or None. name: the sensor's, for errors."""
        if "mat" in self.columns:
            R = self.columns["mat"].reshape(-1, 1, 3, 3)
            return _checks.rotations(self.path, R, (name,), "Mat")[:, 0]
        if "quat" in self.columns:
            q = self.columns["quat"][:, None]
            return _checks.quaternions(self.path, q, (name,), "Quat")[0][:, 0]
        if "euler" not in self.columns:
            return None
        angles = self.columns["euler"]
        bad = np.abs(angles) > LARGEST_DEG
        if bad.any():
            t, k = (int(i) for i in np.argwhere(bad)[0])
            where = _checks.at((name,), t, 0, "Euler")
            raise FormatError(self.path, f"is {angles[t, k]:.4g}, expected degrees", where)
        roll, pitch, yaw = np.deg2rad(angles).T
        Rz, Ry, Rx = (_about(k, a) for k, a in ((2, yaw), (1, pitch), (0, roll)))
        return np.asarray(Rz @ Ry @ Rx)


def known(cells: list[str]) -> bool:
    """Whether these are the column names of such an export."""
    names = _plain(cells)
    marks = {"packetcounter", "sampletimefine", "acc_x", "freeacc_x", "mat[1][1]", "quat_q0", "quat_w",
             "roll", "euler_x"}  # fmt: skip
    return len(marks & set(names)) > 1 or {"acc_x", "acc_y"} <= set(names)


def _plain(cells: list[str] | tuple[str, ...]) -> list[str]:
    return [c.replace(" ", "").lower() for c in cells]


def read(path: Path) -> SensorExport:
    """The export in a file. Raises FormatError naming the column or line that is missing or no number."""
    table = _delimited.open_table(path, known, "PacketCounter, Acc_X or Quat_q0")
    names = _plain(table.header)
    groups = _groups(path, table.header, names, table.line)
    wanted = [i for indices in groups.values() for i in indices]
    values = table.columns(wanted)
    columns: dict[str, Array] = {}
    start = 0
    for group, indices in groups.items():
        columns[group] = values[:, start : start + len(indices)]
        start += len(indices)
    rate, tag = None, ""
    for line in table.preamble:
        if found := _RATE.search(line):
            rate = _text.number(path, found[1], "its rate")
        if found := _TAG.search(line):
            tag = found[1].strip(" \t,;")
    dot = bool(_DOT & set(names)) or bool(tag)
    if dot and "gyr" in columns:
        columns["gyr"] = np.deg2rad(columns["gyr"])
    packets, time = columns.pop("packet", None), columns.pop("time", None)
    seconds = None if time is None else _seconds(time[:, 0], dot)
    counter = None if packets is None else packets[:, 0]
    return SensorExport(path, tag, rate, dot, counter, seconds, columns)


def _groups(
    path: Path, header: tuple[str, ...], names: list[str], line: int
) -> dict[str, tuple[int, ...]]:
    """Column indices by quantity; one orientation of several. Raises FormatError for half a quantity."""
    groups: dict[str, tuple[int, ...]] = {}
    for group, spellings in _SPELT.items():
        for spelling in spellings:
            missing = [c for c in spelling if c not in names]
            if not missing:
                groups[group] = tuple(names.index(c) for c in spelling)
                break
            if len(missing) < len(spelling) and group != "euler":
                raise FormatError(path, f"no column {_shown(missing[0])}", f"line {line}")
    found = [g for g in _ORIENTATION if g in groups]
    for other in found[1:]:
        del groups[other]
    if not found and not {"acc", "gyr"} <= groups.keys():
        have = ", ".join(header[:8])
        raise FormatError(
            path,
            f"no column Mat[1][1], Quat_q0 or Roll, and no Acc_X with Gyr_X (found {have})",
            f"line {line}",
        )
    return groups


def _shown(name: str) -> str:
    """A column's name as the programs spell it."""
    if name.startswith("mat["):
        return name.capitalize()
    head, _, tail = name.partition("_")
    return f"{head.capitalize()}_{tail if tail.startswith('q') else tail.upper()}"


def _seconds(time: Array, dot: bool) -> Array | None:
    """SampleTimeFine as s, without its wrap at 2^32; None where cells are empty."""
    if not np.isfinite(time).all() or len(time) < 2:
        return None
    steps = np.diff(time)
    steps = np.where(steps < -(2.0**31), steps + 2.0**32, steps)
    ticks = time[0] + np.r_[0.0, np.cumsum(steps)]
    # A DOT counts us; exports of MTs may have been edited, so the step decides.
    micro = bool(np.median(steps) >= SHORTEST_US) or dot
    return ticks * (1e-6 if micro else 1e-4)


def _about(axis: int, angle: Array) -> Array:
    return ori.exp(angle[:, None] * np.eye(3)[axis])
