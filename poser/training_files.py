"""Which files a training run reads: folders searched, each file once, some of them held out."""

from __future__ import annotations

import filecmp
import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from mocap.errors import PoserError
from poser.console import UsageError, note

MOTION_FORMATS = ("amass", "bvh", "asfamc")
MOTION_SUFFIXES = (".npz", ".bvh", ".amc")
RECORDING_SUFFIXES = (".npz", ".pkl", ".pt", ".pth")
NAMED = 3  # files that a note names, of those that were left out
VALIDATES_EVERY = 10  # of the motions, by name
ENDS = 1 << 16  # bytes at each end of a file that are compared before the whole of it is


class LeftOut:
    """Called with each file that cannot be read and why; keeps those that were found in folders.

    Folders are searched for what there is, and one broken file of thousands must not end it. What the user
    named himself he wants: that error is raised.
    """

    def __init__(self, given: Sequence[Path]) -> None:
        self._named = {p.resolve() for p in given if not p.is_dir()}
        self.errors: list[PoserError] = []

    def __call__(self, path: Path, error: PoserError) -> None:
        if path.resolve() in self._named:
            raise error
        self.errors.append(error)

    def tell(self) -> None:
        """A note with the first of them."""
        if self.errors:
            more = ", ..." if len(self.errors) > NAMED else ""
            first = "; ".join(str(e) for e in self.errors[:NAMED])
            note(
                f"{len(self.errors)} files in the folders cannot be read and were left out "
                f"({first}{more})"
            )


def motions(paths: Sequence[Path]) -> list[Path]:
    """Motion files, sorted by name; see `gathered`.

    Files in folders that are no motions (AMASS keeps shapes beside them) are passed over, with a note.
    """
    found = gathered(paths, MOTION_SUFFIXES, "motion file", _is_motion)
    return sorted(found, key=lambda p: (p.name, str(p)))


def recordings(paths: Sequence[Path]) -> list[Path]:
    """Recordings in the order given, a folder's by path; see `gathered`."""
    return gathered(paths, RECORDING_SUFFIXES, "recording")


def gathered(
    paths: Sequence[Path],
    suffixes: tuple[str, ...],
    what: str,
    fits: Callable[[Path], bool] = lambda path: True,
) -> list[Path]:
    """Files as they are, folders searched in all their depth for files of these suffixes that `fits` takes.

    Each file once (`distinct`), so that none both trains and validates; notes tell what was left out.
    Raises PoserError where a file is absent or nothing is left.
    """
    found, passed = [], 0
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        inside = [p for p in sorted(path.rglob("*")) if p.suffix.lower() in suffixes]
        fitting = [p for p in inside if fits(p)]
        found += fitting
        passed += len(inside) - len(fitting)
    if passed:
        note(f"{passed} files in the folders are no motions, or cannot be opened; passed over")
    if not found:
        raise PoserError(f"no {what} in {', '.join(str(p) for p in paths)}")
    once, again = distinct(found)
    if again:
        more = f" and {len(again) - 1} more" if len(again) > 1 else ""
        note(f"found more than once and used once: {again[0]}{more}")
    return once


def distinct(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """(each file once, in its order; those that repeat one before them: the same file, or the same bytes).

    Only files of one size are read, and of these their ends first. Raises PoserError for an absent file.
    """
    real: dict[Path, Path] = {}
    again = []
    for path in paths:
        if real.setdefault(path.resolve(), path) is not path:
            again.append(path)
    sizes = {path: _size(path) for path in real.values()}
    shared = Counter(sizes.values())
    alike: dict[tuple[int, bytes], list[Path]] = {}
    once = []
    for path, size in sizes.items():
        if shared[size] > 1:
            before = alike.setdefault((size, _ends(path, size)), [])
            if any(filecmp.cmp(path, p, shallow=False) for p in before):
                again.append(path)
                continue
            before.append(path)
        once.append(path)
    return once, again


def held_out(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """(training, validation): every tenth motion validates. Raises PoserError below two of them."""
    if len(paths) < 2:
        raise PoserError(
            "one motion cannot both train and validate; give more, or --validation MOTION"
        )
    train = [p for k, p in enumerate(paths) if k % VALIDATES_EVERY]
    return train, list(paths[::VALIDATES_EVERY])


def check_apart(train: Sequence[Path], validation: Sequence[Path]) -> None:
    """Raises UsageError for a motion of the one that is in the other too."""
    _, both = distinct([*train, *validation])
    if both:
        raise UsageError(f"{both[0]}: would both train and validate")


def _is_motion(path: Path) -> bool:
    from mocap import formats
    from mocap.formats import native

    try:
        name = formats.detect(path).name
        return name in MOTION_FORMATS or (name == native.FORMAT.name and native.is_motion(path))
    except (PoserError, OSError):  # an OSError: it may not be opened
        return False


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError as e:
        raise PoserError(f"{path}: no such file") from e
    except OSError as e:
        raise PoserError(f"{path}: {e.strerror or e}") from e


def _ends(path: Path, size: int) -> bytes:
    """A digest of the first and the last bytes of a file."""
    with path.open("rb") as file:
        head = file.read(ENDS)
        file.seek(max(0, size - ENDS))
        return hashlib.sha256(head + file.read(ENDS)).digest()
