"""The file formats that are read and written.

Which one a file has is told by suffix and content; docs/files.md says what to export from which tool.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Any

from poser import options
from poser.console import DONE, emit, say

HELP = "the file formats that are read and written"
_KINDS = {"motion": "motions", "recording": "calibrated sensors", "raw": "raw sensors"}


def add_arguments(parser: ArgumentParser) -> None:
    options.add_json(parser)


def run(args: Namespace) -> int:
    rows = listed()
    if args.json:
        emit({"formats": rows})
        return DONE
    for row in rows:
        does = " and ".join(d for d in ("read", "written") if row[d])
        suffixes = " ".join(s or "folder" for s in row["suffixes"])
        holds = ", ".join(_KINDS[k] for k in row["kinds"])
        say(f"{row['name']:<13} {suffixes:<24} {does}: {holds}")
        say(f"{'':<13} {row['about']}")
    return DONE


def listed() -> list[dict[str, Any]]:
    """The JSON of `poser formats`: every format, then what is written for other tools alone."""
    from mocap import formats
    from poser.exports import WRITERS

    rows: list[dict[str, Any]] = [
        {
            "name": f.name,
            "suffixes": list(f.suffixes),
            "kinds": list(f.kinds),
            "read": f.readable,
            "written": f.write is not None,
            "about": f.about,
        }
        for f in formats.registry()
    ]
    named = {suffix for row in rows if row["written"] for suffix in row["suffixes"]}
    return rows + [
        {
            "name": suffix.removeprefix("."),
            "suffixes": [suffix],
            "kinds": ["motion"],
            "read": False,
            "written": True,
            "about": f"for other tools: poser convert MOTION -o OUT{suffix}",
        }
        for suffix in WRITERS
        if suffix not in named
    ]
