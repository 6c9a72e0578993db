"""BVH text: hierarchy and numbers, without any meaning for a body.

Joint frames, units and rest pose differ from tool to tool; `mocap.formats._retarget` interprets them.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
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
    """A parsed file: joints (parents first) and `values` (T, total channels), degrees and file units.

    assumed, doubts: what the text left open or got wrong.
    """

    joints: tuple[BvhJoint, ...]
    rate_hz: float
    values: Array
    assumed: tuple[Finding, ...] = ()
    doubts: tuple[Finding, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.joints)

    @property
    def parents(self) -> tuple[int, ...]:
        return tuple(j.parent for j in self.joints)

    def columns(self, joint: int) -> slice:
        """Where the channels of that joint lie in `values`."""
        return slice(self._starts[joint], self._starts[joint + 1])

    @cached_property
    def _starts(self) -> list[int]:
        return np.cumsum([0, *(len(j.channels) for j in self.joints)]).tolist()

    @cached_property
    def unmoved(self) -> frozenset[int]:
        """Joints below the root whose position channels are all zero although their OFFSET is not."""
        found = []
        for i, j in enumerate(self.joints):
            at = [k for k, c in enumerate(j.channels) if c[1:] == "position"]
            if j.parent >= 0 and at and j.offset.any():
                start = self.columns(i).start
                if not self.values[:, [start + k for k in at]].any():
                    found.append(i)
        return frozenset(found)

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
        Bandai's files are meant, and where OFFSET is zero the two readings agree. Positions that are zero
        throughout, below the root, were never filled in: there the OFFSET holds.
        """
        j = self.joints[joint]
        out = np.tile(j.offset, (len(self.values), 1))
        if joint in self.unmoved:
            return out
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
    head = _motion_header(path, data[cut.end() :], line)
    columns = sum(len(j.channels) for j in joints)
    if columns == 0:
        raise FormatError(path, "no joint has a channel, so the file holds no motion")
    values, doubts = _numbers(path, head, columns)
    bad = ~np.isfinite(values)
    if bad.any():
        t, c = (int(i) for i in np.argwhere(bad)[0])
        raise FormatError(path, "found a value that is not finite", _column_name(joints, t, c))
    # Beyond a million turns or units rounding eats the angle: such a number is a damaged file.
    bad = np.abs(values) > 1e7
    if bad.any():
        t, c = (int(i) for i in np.argwhere(bad)[0])
        raise FormatError(path, f"found the value {values[t, c]:g}", _column_name(joints, t, c))
    file = BvhFile(joints, head.rate_hz, values, head.assumed, doubts)
    if file.unmoved:
        said = assumption("offsets-hold", joints=len(file.unmoved))
        file = replace(file, assumed=(*file.assumed, said))
    return file


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


@dataclass(frozen=True)
class _Head:
    """What stands between MOTION and the numbers; body: their bytes, line: the number of its first."""

    frames: int
    rate_hz: float
    body: bytes
    line: int
    assumed: tuple[Finding, ...]


def _motion_header(path: Path, data: bytes, line: int) -> _Head:
    match = _HEADER.match(data)
    if match is None:
        raise FormatError(path, "'Frames:' and 'Frame Time:' were expected", f"line {line + 1}")
    count, seconds = (match[i].decode("ascii", errors="replace") for i in (1, 2))
    if not count.isdecimal() or len(count) > 12 or int(count) == 0:
        raise FormatError(path, f"Frames is {count[:40]!r}, expected a count above zero")
    rate, said = _rate(path, seconds)
    after = line + data.count(b"\n", 0, match.end())
    return _Head(int(count), rate, data[match.end() :], after, said)


def _rate(path: Path, text: str) -> tuple[float, tuple[Finding, ...]]:
    """Hz of a Frame Time in s, else in ms, and what was assumed."""
    try:
        frame_time = float(text)
    except ValueError:
        raise FormatError(path, f"Frame Time is {text[:40]!r}, expected seconds") from None
    if 1e-4 <= frame_time <= 1.0:
        return rate_of(text)
    if 1.0 < frame_time <= 1000.0:
        rate, _ = rate_of(text, 1000.0)
        return rate, (assumption("frame-time-ms", text=text[:40], rate_hz=rate),)
    raise FormatError(path, f"Frame Time is {text[:40]} s, expected 0.0001 to 1 s")


def rate_of(frame_time: str, per_second: float = 1.0) -> tuple[float, tuple[Finding, ...]]:
    """Hz of a printed frame time, and what was assumed: the usual rate that rounds to these digits, or whose
    further digits were cut off (0.0083 of 120 Hz), else the inverse.

    per_second: 1000 where the time is in ms.
    """
    value = float(frame_time)
    digits = len(frame_time.partition(".")[2]) if "e" not in frame_time.lower() else 12
    step = 10.0**-digits
    exact = [r for r in RATES if abs(per_second / r - value) <= 0.5000001 * step + 1e-12]
    cut = [r for r in RATES if 0 <= per_second / r - value < step]
    fits = exact or cut
    if not fits:
        return per_second / value, ()
    # Whole rates before 30000 / 1001 and its like, which need their digits to be meant.
    best = min(abs(per_second / r - value) for r in fits)
    near = [r for r in fits if r == round(r) and abs(per_second / r - value) < best + step / 4]
    rate = min(near or fits, key=lambda r: abs(per_second / r - value))
    if abs(rate * value / per_second - 1) < 1e-3:
        return rate, ()
    return rate, (assumption("frame-time-rounded", text=frame_time, rate_hz=rate),)


def _numbers(path: Path, head: _Head, columns: int) -> tuple[Array, tuple[Finding, ...]]:
    """The (frames, columns) numbers, and doubts. Numbers count, not the lines that they stand on."""
    count = _words_per_line(head.body)
    whole, rest = divmod(int(count.sum()), columns)
    last = int(np.flatnonzero(count)[-1]) if count.any() else 0
    if rest or not whole:
        rows = np.flatnonzero(count)
        odd = rows[count[rows] != columns]
        at = int(odd[0]) if len(odd) and len(odd) < len(rows) / 2 else last
        frame = int(count[:at].sum()) // columns
        here = int(count[at]) if len(count) else 0
        raise FormatError(
            path,
            f"found {here} numbers, expected {columns} (one per channel), {count.sum()} in all",
            f"line {head.line + at}, frame {frame}",
        )
    values = _parsed(head.body)
    if len(values) != whole * columns:
        raise _not_a_number(path, head.body, head.line)
    doubts: tuple[Finding, ...] = ()
    if whole != head.frames:
        # One off is a count from zero or of an end; anything else is a file cut short or joined.
        if abs(whole - head.frames) > 1:
            raise FormatError(
                path, f"found {whole} frames, expected {head.frames} (its 'Frames:' line)"
            )
        doubts = (doubt("frames-line", frames=whole, stated=head.frames),)
    return values.reshape(whole, columns), doubts


def _parsed(body: bytes) -> Array:
    """The numbers up to the first word that is none, without a Python object for each."""
    with warnings.catch_warnings():
        # At such a word numpy warns or raises, by its version.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(body, dtype=np.float64, sep=" ")  # type: ignore[call-overload]
        except ValueError:
            return np.empty(0)


def _words_per_line(body: bytes) -> np.ndarray:
    """How many words each line holds."""
    text = np.frombuffer(body + b"\n", np.uint8)
    blank = text <= 32
    starts = np.flatnonzero(~blank & np.r_[True, blank[:-1]])
    ends = np.flatnonzero(text == 10)
    return np.diff(np.searchsorted(starts, ends), prepend=0)


def _not_a_number(path: Path, body: bytes, line: int) -> FormatError:
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
