"""What an earlier comparison left in the output folder: a new one takes its place, nothing is mixed."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from poser.comparison import METHODS
from poser.console import UsageError
from poser.report.results import NO_SKILL, SCHEMA

RECORD = "results.json"
PAGE = (RECORD, "report.html", "worst.png", "joints.png", "errors.png")
MOTIONS = (*METHODS, *NO_SKILL, "reference")


def files_in(folder: Path, subfolders: Iterable[Path]) -> list[Path]:
    """The files that an earlier comparison wrote: those of its record `results.json`, and the motions in
    those of the `subfolders` that hold a reference, where one that was interrupted has left no record.

    Other files are not in it, also not those of the same names in other folders: `poser solve` may have
    written them.
    """
    inside = folder.resolve()
    own = [p for p in subfolders if p != folder and (p / "reference.npz").exists()]
    found = [p / f"{name}.npz" for p in own for name in MOTIONS]
    listed = _listed(folder)
    if listed is not None:
        found += [p for p in listed if p.resolve().is_relative_to(inside)]
        found += [folder / name for name in PAGE]
    return sorted({p for p in found if p.is_file()})


def check_own(folder: Path, found: Iterable[Path]) -> None:
    """A folder is written to where it is empty, or holds an earlier comparison (`found`: `files_in`).

    Raises UsageError for one that holds something else. Hidden files do not count.
    """
    others = any(not p.name.startswith(".") for p in folder.iterdir())
    if others and not list(found) and _listed(folder) is None:
        raise UsageError(
            f"{folder}: holds files and no comparison (no {RECORD} of one); choose a new or empty folder "
            f"with -o"
        )


def remove(found: Iterable[Path], folder: Path) -> None:
    """Delete the files, and folders inside `folder` that are empty then. Raises OSError where it fails."""
    for path in found:
        path.unlink(missing_ok=True)
        parent = path.parent
        if parent != folder and parent.is_dir() and not any(parent.iterdir()):
            parent.rmdir()


def _listed(folder: Path) -> list[Path] | None:
    """The motions that the record names; None where there is no record of a comparison."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        if record["schema"] != SCHEMA:
            return None
        return [
            folder / record["motions"][r["name"]] / f"{name}.npz"
            for r in record["recordings"]
            if r["methods"]
            for name in (*r["methods"], "reference")
            if name in MOTIONS
        ]
    except (OSError, ValueError, LookupError, TypeError):
        return None
