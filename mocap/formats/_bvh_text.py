"""BVH text: hierarchy and numbers, without any meaning for a body.

Joint frames, units and rest pose differ from tool to tool; `mocap.formats._retarget` interprets them.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.orientation import Array

CHANNELS = ("xposition", "yposition", "zposition", "xrotation", "yrotation", "zrotation")
# Rates that tools write; a frame time with few digits names the one that rounds to it.
RATES = (
    24000 / 1001, 24.0, 25.0, 30000 / 1001, 30.0, 48.0, 50.0, 60000 / 1001, 60.0, 72.0, 75.0, 80.0,
    90.0, 100.0, 120000 / 1001, 120.0, 125.0, 144.0, 150.0, 180.0, 200.0, 240.0, 250.0, 300.0, 400.0,
    480.0, 500.0, 960.0, 1000.0,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class BvhJoint:
    """One joint: its parent's index (-1: the root), OFFSET (3,) in file units, channels in order.

    `channels` are lower case, empty for an End Site, whose name is empty as well.
    """

    name: str
    parent: int
    offset: Array
    channels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class BvhFile:
    """A parsed file: joints (parents first) and `values` (T, total channels), degrees and file units."""

    joints: tuple[BvhJoint, ...]
    rate_hz: float
    values: Array

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.joints)

    @property
    def parents(self) -> tuple[int, ...]:
        return tuple(j.parent for j in self.joints)

    def columns(self, joint: int) -> slice:
        """Where the channels of that joint lie in `values`."""
        start = sum(len(j.channels) for j in self.joints[:joint])
        return slice(start, start + len(self.joints[joint].channels))

    def rotations(self, joints: Sequence[int]) -> Array:
        """(T,len(joints),3,3): R_parent_joint, the product of a joint's rotations in the order listed."""
        R = np.empty((len(self.values), len(joints), 3, 3))
        R[:] = np.eye(3)
        by_order: dict[str, list[int]] = {}
        for k, j in enumerate(joints):
            order = "".join(c[0] for c in self.joints[j].channels if c[1:] == "rotation")
            by_order.setdefault(order, []).append(k)
        for order, members in by_order.items():
            if not order:
                continue
            columns = [self._rotation_columns(joints[k]) for k in members]
            angles = np.radians(self.values[:, columns])
            R[:, members] = euler(order, angles)
        return R

    def _rotation_columns(self, joint: int) -> list[int]:
        start = self.columns(joint).start
        channels = self.joints[joint].channels
        return [start + i for i, c in enumerate(channels) if c[1:] == "rotation"]

    def translations(self, joint: int) -> Array:
        """(T,3): the joint in its parent's frame, file units.

        A position channel replaces that component of OFFSET (it is not added): so Blender reads, so
        Bandai's files are meant, and where OFFSET is zero the two readings agree.
        """
        j = self.joints[joint]
        out = np.tile(j.offset, (len(self.values), 1))
        values = self.values[:, self.columns(joint)]
        for i, c in enumerate(j.channels):
            if c[1:] == "position":
                out[:, "xyz".index(c[0])] = values[:, i]
        return out


def euler(order: str, angles: Array) -> Array:
    """Rotations (...,3,3) by `angles` (...,n) rad about the axes of `order` ("zxy"): Rz Rx Ry."""
    R = np.zeros((*angles.shape[:-1], 3, 3))
    R[..., [0, 1, 2], [0, 1, 2]] = 1.0
    for k, axis in enumerate(order):
        # R Rot(axis, a) mixes the two columns that follow the axis.
        i, j = (("xyz".index(axis) + n) % 3 for n in (1, 2))
        c, s = (f(angles[..., k])[..., None] for f in (np.cos, np.sin))
        R[..., i], R[..., j] = c * R[..., i] + s * R[..., j], c * R[..., j] - s * R[..., i]
    return R


def parse(path: Path, data: bytes) -> BvhFile:
    """The joints and numbers of a BVH file's bytes.

    Raises FormatError naming the line, joint or frame: no HIERARCHY, unbalanced braces, a channel
    unknown or doubled, fewer or more numbers than frames x channels, a number that is not finite, a
    frame time that is not positive.
    """
    cut = re.search(rb"^[ \t]*MOTION\b", data, re.MULTILINE | re.IGNORECASE)
    if cut is None:
        raise FormatError(path, "no line MOTION: the file is cut short or is not BVH")
    joints = _hierarchy(path, data[: cut.start()].decode("utf-8-sig", errors="replace"))
    line = data.count(b"\n", 0, cut.start()) + 1
    frames, rate, body, line = _motion_header(path, data[cut.end() :], line)
    columns = sum(len(j.channels) for j in joints)
    if columns == 0:
        raise FormatError(path, "no joint has a channel, so the file holds no motion")
    values = _numbers(path, body, frames, columns, line)
    bad = ~np.isfinite(values)
    if bad.any():
        t, c = (int(i) for i in np.argwhere(bad)[0])
        raise FormatError(path, "found a value that is not finite", _column_name(joints, t, c))
    # Beyond a million turns or units rounding eats the angle: such a number is a damaged file.
    bad = np.abs(values) > 1e7
    if bad.any():
        t, c = (int(i) for i in np.argwhere(bad)[0])
        raise FormatError(path, f"found the value {values[t, c]:g}", _column_name(joints, t, c))
    return BvhFile(joints, rate, values)


def _column_name(joints: tuple[BvhJoint, ...], frame: int, column: int) -> str:
    names = [f"joint {j.name}, channel {c}" for j in joints for c in j.channels]
    return f"frame {frame}, {names[column]}"


class _Tokens:
    """Words of the hierarchy, each with its line number."""

    def __init__(self, path: Path, text: str):
        self.path = path
        self.words = [
            (word, n)
            for n, line in enumerate(text.splitlines(), 1)
            for word in line.replace("{", " { ").replace("}", " } ").split()
        ]
        self.at = 0

    @property
    def where(self) -> str:
        last = self.words[min(self.at, len(self.words)) - 1][1] if self.words else 1
        return f"line {last}"

    def next(self, expected: str) -> str:
        if self.at >= len(self.words):
            raise FormatError(
                self.path, f"the hierarchy ends where {expected} was expected", self.where
            )
        self.at += 1
        return self.words[self.at - 1][0]

    def fail(self, problem: str) -> FormatError:
        return FormatError(self.path, problem, self.where)

    def number(self, expected: str) -> float:
        word = self.next(expected)
        try:
            value = float(word)
        except ValueError:
            raise self.fail(f"found {word[:40]!r} where {expected} was expected") from None
        if not np.isfinite(value) or abs(value) > 1e7:
            raise self.fail(f"found {word[:40]!r} where {expected} was expected")
        return value

    def name(self) -> str:
        """The words up to the opening brace (some tools write spaces into names)."""
        words = []
        while (word := self.next("'{'")) != "{":
            words.append(word)
        return " ".join(words)


def _hierarchy(path: Path, text: str) -> tuple[BvhJoint, ...]:
    tokens = _Tokens(path, text)
    if tokens.next("HIERARCHY").upper() != "HIERARCHY":
        raise tokens.fail("the file does not begin with HIERARCHY")
    joints: list[BvhJoint] = []
    stack: list[int] = []
    while tokens.at < len(tokens.words):
        word = tokens.next("a joint").upper()
        if word == "}":
            if not stack:
                raise tokens.fail("found '}' without a '{' before it")
            stack.pop()
        elif word in ("ROOT", "JOINT", "END"):
            _check_nesting(tokens, word, joints, stack)
            if word == "END":
                tokens.next("Site")
            joints.append(_joint(tokens, word, stack[-1] if stack else -1))
            stack.append(len(joints) - 1)
        else:
            raise tokens.fail(
                f"found {word[:40]!r} where ROOT, JOINT, End Site or '}}' was expected"
            )
    if stack:
        raise tokens.fail(f"{len(stack)} closing braces are missing at the end of the hierarchy")
    if not joints:
        raise tokens.fail("the hierarchy has no ROOT")
    names = [j.name for j in joints if j.channels]
    doubled = (
        sorted({n for n in names if names.count(n) > 1}) if len(set(names)) < len(names) else []
    )
    if doubled:
        raise FormatError(path, f"joint name {doubled[0]!r} occurs more than once")
    return tuple(joints)


def _check_nesting(tokens: _Tokens, word: str, joints: list[BvhJoint], stack: list[int]) -> None:
    if word == "ROOT" and joints:
        raise tokens.fail("found a second ROOT; one body per file is expected")
    if word != "ROOT" and not stack:
        raise tokens.fail(f"found {word} outside of a ROOT")
    if stack and not joints[stack[-1]].name:
        raise tokens.fail(f"found {word} inside an End Site")


def _joint(tokens: _Tokens, word: str, parent: int) -> BvhJoint:
    name = tokens.name()
    if word == "END":
        name = ""
    elif not name:
        raise tokens.fail(f"{word} has no name")
    if tokens.next("OFFSET").upper() != "OFFSET":
        raise tokens.fail(f"joint {name or 'End Site'}: OFFSET was expected")
    offset = np.array([tokens.number("a number of OFFSET") for _ in range(3)])
    if word == "END":
        return BvhJoint("", parent, offset, ())
    # A joint without CHANNELS is rigid: some exporters leave the line out.
    if tokens.at < len(tokens.words) and tokens.words[tokens.at][0].upper() != "CHANNELS":
        return BvhJoint(name, parent, offset, ())
    tokens.next("CHANNELS")
    count = tokens.number("the number of channels")
    if count not in range(7):
        raise tokens.fail(f"joint {name}: {count:g} channels, expected 0 to 6")
    channels = tuple(tokens.next("a channel name").lower() for _ in range(int(count)))
    for c in channels:
        if c not in CHANNELS:
            raise tokens.fail(f"joint {name}: channel {c[:40]!r} unknown, expected e.g. Xrotation")
    if len(set(channels)) < len(channels):
        raise tokens.fail(f"joint {name}: a channel occurs twice")
    return BvhJoint(name, parent, offset, channels)


_HEADER = re.compile(
    rb"[\s]*Frames\s*:\s*(\S+)[^\n]*\n\s*Frame\s*Time\s*:\s*(\S+)[ \t\r]*(\n|$)", re.IGNORECASE
)


def _motion_header(path: Path, data: bytes, line: int) -> tuple[int, float, bytes, int]:
    """Frame count, rate in Hz, the bytes of the numbers, the line number they begin at."""
    match = _HEADER.match(data)
    if match is None:
        raise FormatError(path, "'Frames:' and 'Frame Time:' were expected", f"line {line + 1}")
    count, seconds = (match[i].decode("ascii", errors="replace") for i in (1, 2))
    if not count.isdecimal() or len(count) > 12 or int(count) == 0:
        raise FormatError(path, f"Frames is {count[:40]!r}, expected a count above zero")
    try:
        frame_time = float(seconds)
    except ValueError:
        raise FormatError(path, f"Frame Time is {seconds[:40]!r}, expected seconds") from None
    if not 1e-4 <= frame_time <= 1.0:
        raise FormatError(path, f"Frame Time is {seconds[:40]} s, expected 0.0001 to 1 s")
    after = line + data.count(b"\n", 0, match.end())
    return int(count), rate_of(seconds), data[match.end() :], after


def rate_of(frame_time: str) -> float:
    """Hz of a printed frame time: the usual rate that rounds to these digits, else the inverse."""
    seconds = float(frame_time)
    digits = len(frame_time.partition(".")[2]) if "e" not in frame_time.lower() else 12
    fits = [r for r in RATES if abs(1 / r - seconds) <= 0.5000001 * 10.0**-digits + 1e-12]
    # Truncated instead of rounded digits are common too (.0083333).
    return min(fits, key=lambda r: abs(1 / r - seconds)) if fits else 1 / seconds


def _numbers(path: Path, body: bytes, frames: int, columns: int, line: int) -> Array:
    """The (frames, columns) numbers; one frame a line, as BVH demands."""
    per_line = _words_per_line(body)
    rows = np.flatnonzero(per_line)
    odd = np.flatnonzero(per_line[rows] != columns)
    if len(odd):
        k = int(odd[0])
        raise FormatError(
            path,
            f"found {per_line[rows[k]]} numbers, expected {columns} (one per channel)",
            f"line {line + int(rows[k])}, frame {k}",
        )
    if len(rows) != frames:
        raise FormatError(path, f"found {len(rows)} frames, expected {frames} (its 'Frames:' line)")
    try:
        return np.loadtxt(io.BytesIO(body), dtype=np.float64, comments=None, ndmin=2)
    except ValueError:
        raise _not_a_number(path, body, columns, line) from None


def _words_per_line(body: bytes) -> np.ndarray:
    """How many words each line holds."""
    text = np.frombuffer(body + b"\n", np.uint8)
    blank = text <= 32
    starts = np.flatnonzero(~blank & np.r_[True, blank[:-1]])
    ends = np.flatnonzero(text == 10)
    return np.diff(np.searchsorted(starts, ends), prepend=0)


def _not_a_number(path: Path, body: bytes, columns: int, line: int) -> FormatError:
    for n, row in enumerate(body.split(b"\n")):
        for word in row.split():
            try:
                float(word)
            except ValueError:
                shown = word[:40].decode("ascii", errors="replace")
                return FormatError(
                    path, f"found {shown!r} where a number was expected", f"line {line + n}"
                )
    return FormatError(path, "the numbers cannot be read")
