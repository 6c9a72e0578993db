"""XML as a stream of elements, without entities, document types or anything outside the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from mocap.errors import FormatError
from mocap.formats._files import check_regular

MAX_TEXT = 1 << 22  # characters of one element
MAX_TAG = 1 << 20  # bytes of one tag with its attributes, or one comment
MAX_DEPTH = 100
_CHUNK = 1 << 16


@dataclass(frozen=True)
class Element:
    """An element's start (text is None) or end (text as asked for). tag without its namespace."""

    tag: str
    line: int
    attributes: dict[str, str] = field(default_factory=dict)
    text: str | None = None


class _Collector:
    """Expat's callbacks: elements into `ready`, text only of the tags that are wanted."""

    def __init__(self, path: Path, wanted: frozenset[str]):
        self.path, self.wanted = path, wanted
        self.ready: list[Element] = []
        self.parts: list[str] = []
        self.size = self.depth = 0
        self.parser = expat.ParserCreate(namespace_separator=" ")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.characters
        # A document type is what entity bombs and references to other files need; data has none.
        self.parser.StartDoctypeDeclHandler = self.refuse
        self.parser.EntityDeclHandler = self.refuse

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.parts, self.size = [], 0
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise FormatError(self.path, f"elements lie over {MAX_DEPTH} deep", self._line())
        line = self.parser.CurrentLineNumber
        self.ready.append(Element(name.rpartition(" ")[2], line, attributes))

    def end(self, name: str) -> None:
        self.depth -= 1
        tag = name.rpartition(" ")[2]
        text = "".join(self.parts) if tag in self.wanted else ""
        self.parts, self.size = [], 0
        self.ready.append(Element(tag, self.parser.CurrentLineNumber, text=text))

    def characters(self, text: str) -> None:
        self.size += len(text)
        if self.size > MAX_TEXT:
            raise FormatError(self.path, f"over {MAX_TEXT} characters in one element", self._line())
        self.parts.append(text)

    def refuse(self, *_: object) -> None:
        raise FormatError(
            self.path, "declares a document type or entities, which are refused", self._line()
        )

    def _line(self) -> str:
        return f"line {self.parser.CurrentLineNumber}"


def elements(path: Path, wanted: frozenset[str]) -> Iterator[Element]:
    """Starts and ends of all elements in order; ends carry the text of `wanted` tags.

    Memory does not grow with the file. Raises FormatError with the line where the XML is broken, cut
    short, or declares a document type.
    """
    collector = _Collector(path, wanted)
    check_regular(path)
    with path.open("rb") as f:
        while True:
            chunk = f.read(_CHUNK)
            try:
                collector.parser.Parse(chunk, not chunk)
                # Expat keeps what is not whole yet and looks at it again with every chunk, which takes time
                # that grows with the square of its length.
                if f.tell() - collector.parser.CurrentByteIndex > MAX_TAG + _CHUNK:
                    where = f"line {collector.parser.CurrentLineNumber}"
                    raise FormatError(path, f"a tag or comment of over {MAX_TAG} bytes", where)
            except expat.ExpatError as e:
                what = expat.ErrorString(e.code)
                raise FormatError(path, f"broken XML: {what}", f"line {e.lineno}") from e
            # Unknown encodings surface as LookupError or ValueError.
            except (LookupError, ValueError) as e:
                raise FormatError(path, "broken XML: unreadable encoding") from e
            yield from collector.ready
            collector.ready.clear()
            if not chunk:
                return
