"""What an earlier comparison left in the output folder: a new one takes its place, nothing is mixed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

from mocap.errors import FormatError
from mocap.formats._files import read_json
from poser.comparison import METHODS
from poser.console import UsageError
from poser.report.results import NO_SKILL, SCHEMA

RECORD = "results.json"
PAGE = (RECORD, "report.html", "worst.png", "joints.png", "errors.png")
UNFINISHED = "unfinished-comparison"
READY = ".poser-whole"  # a new comparison that is whole, on its way to its place
REPLACED = "replaced.json"  # in it: the files of the old one
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


def fresh(folder: Path) -> Path:
    """An empty folder inside for a new comparison, until it is whole.

    What an interrupted one has left there is removed. Raises UsageError where something else lies there.
    """
    made = folder / UNFINISHED
    if made.exists():
        known = {*PAGE, *(f"{name}.npz" for name in MOTIONS)}
        for path in made.rglob("*"):
            if not path.is_dir() and path.name not in known and not path.name.startswith("."):
                raise UsageError(f"{path}: is not of a comparison; move it out of {made}")
        shutil.rmtree(made)
    made.mkdir()
    return made


def replace(old: Iterable[Path], made: Path, folder: Path) -> None:
    """The new comparison, whole in `made`, in place of the old one.

    Killed in between, the next comparison in the folder goes on with it (`complete`).
    """
    ready = folder / READY
    (made / REPLACED).write_text(json.dumps([str(p.relative_to(folder)) for p in old]))
    made.rename(ready)
    complete(folder)


def complete(folder: Path) -> None:
    """Put a comparison in its place that was whole when its run was killed."""
    ready = folder / READY
    if not ready.exists():
        return
    new = [p for p in ready.rglob("*") if p.is_file() and p.name != REPLACED]
    listed = read_json(ready / REPLACED) if (ready / REPLACED).exists() else []
    inside = folder.resolve()
    old = [folder / name for name in listed if (folder / name).resolve().is_relative_to(inside)]
    # The old ones first of which there is no new one; what is left is replaced, file by file.
    remove([p for p in old if ready / p.relative_to(folder) not in new], folder)
    for path in sorted(new):
        target = folder / path.relative_to(ready)
        target.parent.mkdir(parents=True, exist_ok=True)
        path.replace(target)
    shutil.rmtree(ready)


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
        record = read_json(folder / RECORD)
        if record["schema"] != SCHEMA:
            return None
        return [
            folder / record["motions"][r["name"]] / f"{name}.npz"
            for r in record["recordings"]
            if r["methods"]
            for name in (*r["methods"], "reference")
            if name in MOTIONS
        ]
    except (OSError, FormatError, LookupError, TypeError):
        return None
