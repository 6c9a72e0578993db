"""Text tables: lines with their numbers, cells as numbers, errors that name both."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mocap.errors import FormatError
from mocap.formats._files import check_regular
from mocap.orientation import Array

MAX_LINE = 1 << 20


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """(line number from 1, text without its end) of a UTF-8 file, one line in memory at a time.

    Raises FormatError for a line over `MAX_LINE` characters and for bytes that are no text.
    """
    check_regular(path)
    with path.open(encoding="utf-8-sig", errors="replace", newline=None) as f:
        number = 0
        while line := f.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise FormatError(path, f"longer than {MAX_LINE} characters", f"line {number}")
            if "\0" in line:
                raise FormatError(path, "holds zero bytes, expected text", f"line {number}")
            yield number, line.rstrip("\n")


def number(path: Path, text: str, where: str) -> float:
    """A cell as a float; raises FormatError showing what it holds."""
    try:
        return float(text)
    except ValueError as e:
        shown = text.strip()[:40]
        raise FormatError(path, f"{shown!r} is not a number", where) from e


class Rows:
    """Numbers collected row by row without a Python object for each."""

    def __init__(self, path: Path, names: Sequence[str]):
        self.path, self.names, self.values = path, names, array("d")

    def add(self, line: int, cells: Sequence[str]) -> None:
        """One row of cells in the order of `names`; raises FormatError naming line and column."""
        if len(cells) != len(self.names):
            raise FormatError(
                self.path, f"{len(cells)} values, expected {len(self.names)}", f"line {line}"
            )
        try:
            self.values.extend([float(c) for c in cells])
        except ValueError:
            for name, cell in zip(self.names, cells, strict=True):
                number(self.path, cell, f"line {line}, column {name}")

    def table(self) -> Array:
        """(N, columns) of what was added."""
        return np.array(self.values, float).reshape(-1, len(self.names))
