"""What a session writes as it goes, beside the file that it becomes at the end: `FILE.part`."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import PoserError
from mocap.formats._files import about, check_regular, locked
from mocap.orientation import Array
from poser.console import complain

FULL = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
)  # the disk, the user's share of it, the largest file
MOST_HEAD = 1 << 20  # bytes of the first line

Write = Callable[[Path, Mapping[str, Any], Array], None]
"""Makes a file whole: of its path, the head and the rows (N,W)."""


class Spool:
    """Rows of W numbers, appended to `FILE.part` as single precision, and made FILE by `finish`.

    head: what `write` needs beside the rows, as JSON. A disk that is full ends the taking, not the session:
    `lost` counts the rows that found no room. What a session left that was killed is made whole here, as
    FILE.rescued with its suffix, and said. Raises PoserError where another session writes to the same file.
    """

    def __init__(self, path: Path, width: int, head: Mapping[str, Any], write: Write):
        self.path, self._part = path, path.with_name(f"{path.name}.part")
        self._width, self._head, self._write = width, head, write
        self._handle: int | None = None
        self.count = self.lost = 0
        self._rescue()

    def append(self, row: Array) -> None:
        """Write a row (W,) down."""
        if self.lost:
            self.lost += 1
            return
        try:
            self._append(row.astype("<f4").tobytes())
            self.count += 1
        except OSError as e:
            if e.errno not in FULL:
                raise
            self.lost = 1
            complain(f"{self.path}: {e.strerror}; from here on no pose is kept in it", "live")

    def finish(self) -> None:
        """Make the file of what was written down; nothing where no row came.

        Where the disk has no room for both, the rows make room for it first. Raises OSError where there is
        none even then; the rows stay in FILE.part, as they do where the file cannot be written.
        """
        if self._handle is None:
            return
        rows = self._rows(self._part, self._width)
        try:
            self._write(self.path, self._head, rows)
        except OSError as e:
            if e.errno not in FULL:
                raise self._kept(e) from e
            os.ftruncate(self._handle, 0)
            try:
                self._write(self.path, self._head, rows)
            except BaseException:
                os.lseek(self._handle, 0, os.SEEK_SET)
                _whole(self._handle, _first_line(self._head, self._width) + rows.tobytes())
                raise self._kept(e) from e
        self._part.unlink()
        os.close(self._handle)
        self._handle = None

    def _kept(self, e: OSError) -> PoserError:
        return PoserError(
            f"{self.path}: {e.strerror}; what came is in {self._part}, and the next session that writes to "
            f"{self.path.name} makes a file of it"
        )

    def _append(self, data: bytes) -> None:
        if self._handle is None:
            with about(self._part):
                # A session in another process may just have begun.
                self._handle = os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
                locked(self._handle)
                _whole(self._handle, _first_line(self._head, self._width))
        _whole(self._handle, data)

    def _rescue(self) -> None:
        check_regular(self._part)
        if not self._part.exists():
            return
        handle = os.open(self._part, os.O_RDWR)
        try:
            if not locked(handle):
                raise PoserError(f"{self.path}: another session is writing to it")
            first = os.read(handle, MOST_HEAD).split(b"\n")[0]
            try:
                head = json.loads(first)
                rows = self._rows(self._part, int(head["width"]))
                if len(rows):
                    made = _free(self.path)
                    self._write(made, head["head"], rows)
                    told = f"left by a session that was killed; its {len(rows)} rows are in {made}"
                    complain(f"{self._part}: {told}", "live")
            except (ValueError, LookupError, TypeError) as e:
                raise PoserError(
                    f"{self._part}: is nothing that a session of poser live left; move it away"
                ) from e
            self._part.unlink()
        finally:
            os.close(handle)

    @staticmethod
    def _rows(part: Path, width: int) -> Array:
        """The whole rows of a file: the last one may have been cut."""
        with part.open("rb") as f:
            f.readline(MOST_HEAD)
            data = f.read()
        size = 4 * width
        rows: Array = np.frombuffer(data[: len(data) // size * size], "<f4").reshape(-1, width)
        return rows


def _first_line(head: Mapping[str, Any], width: int) -> bytes:
    return json.dumps({"width": width, "head": dict(head)}).encode() + b"\n"


def _whole(handle: int, data: bytes) -> None:
    """All of `data`: a system may take a part, and tell of a full disk with the rest."""
    left = memoryview(data)
    while left:
        left = left[os.write(handle, left) :]


def _free(path: Path) -> Path:
    """A name beside `path` that nothing has."""
    k = 1
    while (
        made := path.with_name(f"{path.stem}.rescued{k if k > 1 else ''}{path.suffix}")
    ).exists():
        k += 1
    return made
