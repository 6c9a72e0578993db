"""Docstrings on the pages: `name: what it is. other: what that is.` becomes a list, one name a line."""

from __future__ import annotations

import re
from typing import Any

import griffe

_NAME = r"[A-Za-z_]\w*\*?(?: \([^()]*\))?(?: [A-Za-z0-9/^]{1,5})?"  # `p (T,3) m`, `smooth_*`
_LABEL = re.compile(rf"(?:^|(?<=[.;,)] ))({_NAME}(?:, {_NAME})*): ")
_RAISES = re.compile(r"(?<=[.;]) (?=Raises )")


class Fields(griffe.Extension):  # type: ignore[misc]
    """Applied to a whole package once it has been read."""

    def on_package(self, *, pkg: griffe.Module, **kwargs: Any) -> None:
        _walk(pkg)


def _walk(obj: griffe.Object) -> None:
    if obj.docstring is not None:
        obj.docstring.value = listed(obj.docstring.value, _names(obj))
    for member in obj.members.values():
        if not member.is_alias:
            _walk(member)


def _names(obj: griffe.Object) -> set[str]:
    """What the docstring may explain: fields, and parameters of the function or of `__init__`."""
    found = set(obj.members) if obj.is_class else set()
    function = obj.members.get("__init__") if obj.is_class else obj
    return found | {p.name for p in getattr(function, "parameters", ())}


def listed(text: str, names: set[str]) -> str:
    """`text` with the paragraphs that explain two or more of `names` as lists."""
    return "\n\n".join(_paragraph(p, names) for p in text.split("\n\n"))


def _paragraph(text: str, names: set[str]) -> str:
    if re.search(r"^(\s|- |\||>|```)", text, re.MULTILINE):
        return text
    line = " ".join(text.splitlines())
    labels = [m for m in _LABEL.finditer(line) if _known(m[1], names)]
    if len(labels) < 2:
        return text
    ends = [m.start() for m in labels[1:]] + [len(line)]
    items = [
        f"- **{m[1]}**: {line[m.end() : end].strip(' ;')}"
        for m, end in zip(labels, ends, strict=True)
    ]
    items[-1] = _RAISES.sub("\n\n", items[-1], count=1)
    before = line[: labels[0].start()].strip()
    return "\n\n".join(filter(None, [before, "\n".join(items)]))


def _known(label: str, names: set[str]) -> bool:
    said = re.findall(r"(?:^|, )([A-Za-z_]\w*)(\*?)", re.sub(r"\([^()]*\)", "", label))
    return all(n in names or (star and any(k.startswith(n) for k in names)) for n, star in said)
