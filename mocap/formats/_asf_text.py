"""ASF and AMC text (Acclaim): a skeleton of bones with axes of their own, and their angles by frame.

Meaning for a body is given in `mocap.formats._retarget`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.formats._files import check_regular
from mocap.formats._pickled import LARGEST_ANGLE
from mocap.orientation import Array

MAX_BYTES = 512 << 20
ROTATIONS = ("rx", "ry", "rz")
DOFS = (*ROTATIONS, "tx", "ty", "tz", "l")
ROOT = "root"
LARGEST = 1e7  # beyond it rounding eats an angle: such a number is a damaged file


@dataclass(frozen=True, eq=False)
class Bone:
    """One bone: parent's index (-1: the root), unit direction (3,) in the world at zero angles, length
    in file units, its own axes as angles (3,) rad with their order ("xyz"), and its degrees of freedom.
    """

    name: str
    parent: int
    direction: Array
    length: float
    axis: Array
    axis_order: str
    dof: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class AsfFile:
    """A parsed skeleton. bones: parents first, the first is the root (of no length). length_unit: the
    number after `length` under `:units`, 0.45 in CMU's files.
    """

    bones: tuple[Bone, ...]
    length_unit: float
    degrees: bool

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(b.name for b in self.bones)


class _Lines:
    """Lines with words in them, with their numbers; comments (#) are left out."""

    def __init__(self, path: Path, text: str):
        self.path = path
        self.line = 0
        self._rest = enumerate(text.splitlines(), 1)

    def __iter__(self) -> Iterator[list[str]]:
        for line, text in self._rest:
            self.line = line
            words = text.partition("#")[0].split()
            if words:
                yield words

    def fail(self, problem: str) -> FormatError:
        return FormatError(self.path, problem, f"line {self.line}")

    def numbers(self, words: list[str], count: int, what: str) -> Array:
        try:
            values = np.array([float(w) for w in words[:count]])
        except ValueError:
            raise self.fail(
                f"{what} is {' '.join(words)[:60]!r}, expected {count} numbers"
            ) from None
        if len(values) != count or not (np.abs(values) < LARGEST).all():
            raise self.fail(f"{what} is {' '.join(words)[:60]!r}, expected {count} numbers")
        return values


def _text(path: Path) -> str:
    check_regular(path)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise FormatError(path, f"{size >> 20} MiB, at most {MAX_BYTES >> 20} are read")
    data = path.read_bytes()
    if b"\0" in data:
        raise FormatError(path, "holds zero bytes, expected text")
    return data.decode("utf-8-sig", errors="replace")


def parse_asf(path: Path) -> AsfFile:
    """The skeleton of an `.asf` file. Raises FormatError naming the line or bone."""
    lines = _Lines(path, _text(path))
    units: dict[str, str] = {}
    root = Bone(ROOT, -1, np.zeros(3), 0.0, np.zeros(3), "xyz", ("tx", "ty", "tz", *ROTATIONS))
    bones: dict[str, Bone] = {}
    parents: dict[str, str] = {}
    section = ""
    for words in lines:
        if words[0].startswith(":"):
            section = words[0].lower()
        elif section == ":units" and len(words) > 1:
            units[words[0].lower()] = words[1].lower()
        elif section == ":root":
            root = _root(lines, root, words)
        elif section == ":bonedata" and words[0].lower() == "begin":
            bone = _bone(lines, units.get("angle") != "rad")
            if bone.name in bones or bone.name == ROOT:
                raise lines.fail(f"bone {bone.name!r} occurs twice")
            bones[bone.name] = bone
        elif section == ":hierarchy" and words[0].lower() not in ("begin", "end"):
            for child in words[1:]:
                if child in parents or child == ROOT:
                    raise lines.fail(f"bone {child!r} has two parents")
                parents[child] = words[0]
    if not bones:
        raise FormatError(path, "no bones: the file is cut short or is not ASF")
    try:
        unit = float(units.get("length", "1"))
    except ValueError:
        raise FormatError(path, f"length unit is {units['length'][:40]!r}", ":units") from None
    return AsfFile(_tree(path, root, bones, parents), unit, units.get("angle") != "rad")


def _root(lines: _Lines, root: Bone, words: list[str]) -> Bone:
    """The root with what one line under `:root` says; its place is zero in all files but its axes count."""
    key = words[0].lower()
    axis, order, dof = root.axis, root.axis_order, root.dof
    if key == "order":
        dof = _dofs(lines, words[1:])
    elif key == "axis":
        order = _order(lines, words[1:])
    elif key == "orientation":
        axis = np.radians(lines.numbers(words[1:], 3, "orientation"))
    return Bone(ROOT, -1, root.direction, 0.0, axis, order, dof)


def _bone(lines: _Lines, degrees: bool) -> Bone:
    """The bone whose `begin` was just read."""
    name, length = "", 0.0
    direction, axis, order = np.zeros(3), np.zeros(3), "xyz"
    dof: tuple[str, ...] = ()
    for words in lines:
        key, rest = words[0].lower(), words[1:]
        if key == "end":
            break
        if key == "name" and rest:
            name = rest[0]
        elif key == "direction":
            direction = lines.numbers(rest, 3, f"direction of bone {name!r}")
        elif key == "length":
            length = float(lines.numbers(rest, 1, f"length of bone {name!r}")[0])
        elif key == "axis":
            axis = lines.numbers(rest, 3, f"axis of bone {name!r}")
            axis = np.radians(axis) if degrees else axis
            order = _order(lines, rest[3:])
        elif key == "dof":
            dof = _dofs(lines, rest)
    else:
        raise lines.fail(f"bone {name!r} has no 'end'")
    if not name:
        raise lines.fail("a bone has no name")
    size = float(np.linalg.norm(direction))
    if length < 0 or (length > 0 and not math.isclose(size, 1.0, abs_tol=0.05)):
        raise lines.fail(
            f"bone {name!r} has length {length:g} along a direction of length {size:g}"
        )
    return Bone(name, -1, direction / max(size, 1e-300), length, axis, order, dof)


def _order(lines: _Lines, words: list[str]) -> str:
    order = (words[0] if words else "xyz").lower()
    if sorted(order) != ["x", "y", "z"]:
        raise lines.fail(f"order of axes is {order[:20]!r}, expected such as 'XYZ'")
    return order


def _dofs(lines: _Lines, words: list[str]) -> tuple[str, ...]:
    dof = tuple(w.lower() for w in words)
    if any(d not in DOFS for d in dof) or len(set(dof)) != len(dof):
        raise lines.fail(
            f"degrees of freedom are {' '.join(words)[:60]!r}, expected {' '.join(DOFS)}"
        )
    return dof


def _tree(
    path: Path, root: Bone, bones: dict[str, Bone], parents: dict[str, str]
) -> tuple[Bone, ...]:
    """The bones in an order in which every parent precedes its children."""
    unknown = [n for n in (*parents, *parents.values()) if n not in bones and n != ROOT]
    if unknown:
        raise FormatError(path, f"bone {unknown[0][:40]!r} has no data", ":hierarchy")
    loose = [n for n in bones if n not in parents]
    if loose:
        raise FormatError(path, f"bone {loose[0][:40]!r} has no parent", ":hierarchy")
    children: dict[str, list[str]] = {}
    for child, parent in parents.items():
        children.setdefault(parent, []).append(child)
    order = [root]
    index = {ROOT: 0}
    for bone in order:  # grows while it is read: breadth first
        for child in children.get(bone.name, []):
            b = bones[child]
            index[child] = len(order)
            order.append(
                Bone(b.name, index[bone.name], b.direction, b.length, b.axis, b.axis_order, b.dof)
            )
    if len(order) != len(bones) + 1:
        stray = next(n for n in bones if n not in index)
        raise FormatError(path, f"bone {stray[:40]!r} does not hang on the root", ":hierarchy")
    return tuple(order)


@dataclass(frozen=True, eq=False)
class AmcFile:
    """The angles of a trial. first: the number of its first frame, above 1 where it begins within a take.

    values: by bone, (T, degrees of freedom) in the order of its dof; lengths in file units, angles in rad.
    Bones that the file leaves out are absent.
    """

    first: int
    values: dict[str, Array]


def parse_amc(path: Path, asf: AsfFile) -> AmcFile:
    """The trial in an `.amc` file. Raises FormatError naming line or frame, and bone."""
    text = _text(path)
    start = re.search(r"^[ \t]*(\d{1,9})[ \t]*\r?$", text, re.MULTILINE)
    if start is None:
        raise FormatError(
            path, "no line that is a frame's number alone, as '1': cut short or not AMC"
        )
    number = int(start[1])
    head = text[: start.start()].lower()
    degrees = ":radians" not in head and (":degrees" in head or asf.degrees)
    words = text[start.start() :].split()
    first = _first_frame(path, words, {b.name: b for b in asf.bones}, f"frame {number}")
    size = 1 + sum(1 + n for _, n in first)
    frames, odd = divmod(len(words), size)
    at, columns = 1, {}
    fits = odd == 0 and words[0::size] == [str(t) for t in range(number, number + frames)]
    for name, n in first:
        fits = fits and words[at::size].count(name) == frames
        columns[name] = range(at + 1, at + 1 + n)
        at += 1 + n
    if not fits:
        line = text.count("\n", 0, start.start())
        raise _where_it_breaks(path, text[start.start() :], first, line, number)
    bones = {b.name: b for b in asf.bones}
    values = {
        name: _values(path, bones[name], [words[c::size] for c in cs], degrees, number)
        for name, cs in columns.items()
    }
    return AmcFile(number, values)


def _first_frame(
    path: Path, words: list[str], bones: dict[str, Bone], where: str
) -> list[tuple[str, int]]:
    """Names and numbers of values of the bones in the first frame; those of all others are the same."""
    first: list[tuple[str, int]] = []
    at = 1
    while at < len(words) and not words[at].isdigit():
        bone = bones.get(words[at])
        if bone is None:
            raise FormatError(
                path, f"found {words[at][:40]!r}, expected a bone of the skeleton", where
            )
        if any(bone.name == name for name, _ in first):
            raise FormatError(path, f"bone {bone.name!r} occurs twice", where)
        first.append((bone.name, len(bone.dof)))
        at += 1 + len(bone.dof)
    if not first:
        raise FormatError(path, "holds no bones", where)
    return first


def _values(path: Path, bone: Bone, columns: list[list[str]], degrees: bool, number: int) -> Array:
    name, dof = bone.name, bone.dof
    try:
        values = np.array([list(map(float, c)) for c in columns]).T
    except ValueError:
        t, word = next(
            (t, c[t]) for t in range(len(columns[0])) for c in columns if not _is_number(c[t])
        )
        raise FormatError(
            path, f"found {word[:40]!r}, expected a number", f"frame {number + t}, bone {name}"
        ) from None
    bad = ~(np.abs(values) < LARGEST)
    if bad.any():
        t, k = (int(i) for i in np.argwhere(bad)[0])
        raise FormatError(path, f"{dof[k]} is {values[t, k]:g}", f"frame {number + t}, bone {name}")
    turned = [k for k, d in enumerate(dof) if d in ROTATIONS]
    if degrees:
        values[:, turned] = np.radians(values[:, turned])
    elif np.abs(values[:, turned]).max(initial=0.0) > LARGEST_ANGLE:
        t = int(np.abs(values[:, turned]).max(axis=1).argmax())
        found = float(np.abs(values[t, turned]).max())
        raise FormatError(
            path, f"an angle is {found:g}, expected radians", f"frame {number + t}, bone {name}"
        )
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _where_it_breaks(
    path: Path, body: str, first: list[tuple[str, int]], line: int, number: int
) -> FormatError:
    """The first line that is not what the order of the first frame demands."""
    expected = [("", 0), *first]
    at, frame = 0, number - 1
    for n, text in enumerate(body.splitlines(), line + 1):
        words = text.split()
        if not words:
            continue
        name, count = expected[at]
        frame += at == 0
        want = name or str(frame)
        if words[0] != want or len(words) != 1 + count:
            problem = f"found {text.strip()[:60]!r}, expected {want!r} and {count} numbers"
            return FormatError(path, problem, f"line {n}, frame {frame}")
        at = (at + 1) % len(expected)
    return FormatError(path, f"ends inside frame {frame}: cut short", f"frame {frame}")
