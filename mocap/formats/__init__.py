"""Files in and out: one module a format, found by suffix and content.

A format module defines `FORMAT = Format(...)`. Other packages add theirs through the entry-point group
`poser.formats` (an object of type `Format`), so that a format whose reader needs torch lives where torch
is imported.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal

from mocap.errors import FormatError, PoserError
from mocap.findings import Finding, doubt
from mocap.formats import _files, _foreign
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.words import sentence

Content = Motion | RawRecording | Recording
Kind = Literal["motion", "recording", "raw"]


@dataclass(frozen=True)
class Options:
    """What a user may tell a reader that the file does not say.

    height: the body's stature in m. scale: m per length unit of the file. rate_hz: where the file names
    none. units, a set: "g" or "m/s^2" for accelerations, "deg/s" or "rad/s" for rates, "y-up" where the
    file's world is not z-up. up: "y" or "z", the axis of a motion's world that points up, where the reader
    finds it wrong. smpl: the user's SMPL body file.
    mapping: sensor names of the file to places of the table, or a file that holds them (by format).
    """

    height: float | None = None
    scale: float | None = None
    rate_hz: float | None = None
    units: frozenset[str] = frozenset()
    up: Literal["y", "z"] | None = None
    smpl: Path | None = None
    mapping: dict[str, str] | Path | None = None


_OPTIONS = tuple(f.name for f in fields(Options))


@dataclass(frozen=True)
class _Watched(Options):
    """Options that remember which of them a reader looked at."""

    asked: set[str] = field(default_factory=set)

    def __getattribute__(self, name: str) -> Any:
        value = object.__getattribute__(self, name)
        if name in _OPTIONS:
            object.__getattribute__(self, "asked").add(name)
        return value


@dataclass(frozen=True)
class Document:
    """A file's content, and what the reader assumed and doubts of it. kind is given by the content's type.

    assumed, doubts: findings; `assumptions` and `warnings` are what they say, in sentences.
    stated_hz: the rate that the file states itself, where the content has another, which the user said.
    """

    format: str
    content: Content
    assumed: tuple[Finding, ...] = ()
    doubts: tuple[Finding, ...] = ()
    stated_hz: float | None = None

    @property
    def assumptions(self) -> tuple[str, ...]:
        return tuple(map(sentence, self.assumed))

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(map(sentence, self.doubts))

    @property
    def kind(self) -> Kind:
        if isinstance(self.content, Motion):
            return "motion"
        return "raw" if isinstance(self.content, RawRecording) else "recording"


@dataclass(frozen=True)
class Format:
    """One file format.

    suffixes: lower case with the dot. sniff(path, head): whether the first 4 KiB (or the folder, with
    empty head) look like it. read(path, options) -> Document; `written_only` where none does. write(path,
    content): None if it is read only. kinds: what files of it may hold. about: whose files these are, in one
    line. sign: what tells such a file from others of its suffix, for whoever has another.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[Path, bytes], bool]
    read: Callable[[Path, Options], Document]
    write: Callable[[Path, Content], None] | None = None
    kinds: tuple[Kind, ...] = ()
    about: str = ""
    sign: str = ""

    @property
    def readable(self) -> bool:
        """Whether there is a reader."""
        return self.read is not written_only


def written_only(path: Path, options: Options) -> Document:
    """The reader of a format that has none."""
    raise FormatError(path, _foreign.instead(path.suffix.lower()) or "such files are written only")


# In the order of trial: the first whose suffix and sniff both fit reads the file.
_MODULES = (
    "native", "amass", "bvh", "asfamc", "dip", "totalcapture", "qmt", "opensense", "xsens_mtw", "mvnx",
    "phones", "csv", "gltf",
)  # fmt: skip


def registry() -> Iterator[Format]:
    """All formats, those of this package first, then those that entry points add."""
    for module in _MODULES:
        yield importlib.import_module(f"mocap.formats.{module}").FORMAT
    for point in entry_points(group="poser.formats"):
        try:
            yield point.load()
        except ImportError:
            # The plug-in's own dependency (torch) is not installed: its files are unknown here, and
            # `detect` says which plug-in would read them.
            continue


def detect(path: Path) -> Format:
    """The format of a file or folder; raises FormatError where none fits, which says what is read instead."""
    if not path.exists():
        raise FormatError(path, "no such file")
    _files.check_regular(path)
    head = b""
    if path.is_file():
        with path.open("rb") as f:
            head = f.read(4096)
        if not head:
            raise FormatError(path, "the file is empty")
    suffix = "" if path.is_dir() else path.suffix.lower()
    readable = [f for f in registry() if f.readable]
    tried = [f for f in readable if suffix in f.suffixes]
    for fmt in tried:
        if fmt.sniff(path, head):
            return fmt
    if path.is_dir():
        names = " and ".join(f.name for f in tried)
        raise FormatError(
            path, f"is a folder, expected a file (of folders, those of {names} are read)"
        )
    if tried and suffix:
        signs = "; ".join(f.sign or f.name for f in tried)
        raise FormatError(path, f"is none of the {suffix} files that are read: {signs}")
    known = " ".join(sorted({s for f in readable for s in f.suffixes if s}))
    told = _foreign.instead(suffix) or f"suffix {suffix or '(none)'!r} unknown; known: {known}"
    raise FormatError(path, told)


def read(path: str | Path, options: Options | None = None) -> Document:
    """Read a file of any known format. Raises FormatError (one sentence naming file and place).

    A mapping renames the sensors of a raw recording whose reader does not do so itself. An option that
    nobody looks at is a doubt.
    """
    path = Path(path)
    told = {k: getattr(options, k) for k in _OPTIONS} if options else {}
    watched = _Watched(**told)
    try:
        fmt = detect(path)
        doc = fmt.read(path, watched)
        if isinstance(doc.content, RawRecording) and "mapping" not in watched.asked:
            doc = replace(doc, content=_renamed(path, doc.content, watched.mapping))
        idle = [k for k, v in told.items() if v and k not in watched.asked]
        more = [doubt("option-unused", option=k.removesuffix("_hz")) for k in idle]
        return replace(doc, doubts=(*doc.doubts, *more)) if more else doc
    except FormatError:
        raise
    except PoserError as e:
        raise FormatError(path, str(e)) from e
    except MemoryError as e:
        raise FormatError(path, "too large for this machine's memory") from e
    except OSError as e:
        raise FormatError(path, e.strerror or str(e)) from e


def _renamed(path: Path, raw: RawRecording, names: dict[str, str] | Path | None) -> RawRecording:
    if names is None:
        return raw
    if not isinstance(names, dict):
        if not names.exists():
            raise FormatError(names, "no such file")
        raise FormatError(names, "is no mapping for this kind of file, expected NAME=PLACE,...")
    check_mapped(path, names, raw.sensors)
    return raw.renamed(names)


def check_mapped(path: Path, mapping: dict[str, str] | Path | None, sensors: Sequence[str]) -> None:
    """Raises FormatError where a mapping said in words names a sensor that the file lacks.

    Mapping files are of a sensor set, of which a recording may hold a part.
    """
    odd = [n for n in mapping if n not in sensors] if isinstance(mapping, dict) else []
    if odd:
        raise FormatError(path, f"has no sensor {odd[0]!r} to map; it has {', '.join(sensors)}")
