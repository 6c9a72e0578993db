"""Tables of other tools: the delimiter, the decimal sign and where the header lies are found, not told.

Before the header there may be a line `sep=,`, comments and lines of names and values. Delimiters are tab,
semicolon, comma or blanks; where it is not the comma, a comma in a number is the decimal sign, and so it
is in quoted cells. Cells that are empty, and columns that nobody asked for, are no numbers and no fault.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mocap.errors import FormatError
from mocap.formats import _text
from mocap.orientation import Array

DELIMITERS = ("\t", ";", ",", None)  # None: blanks
MAX_PREAMBLE = 200  # lines before the header
Known = Callable[[list[str]], bool]


@dataclass(frozen=True, eq=False)
class Table:
    """preamble: the lines before the header; header: column names; `columns` reads the numbers."""

    path: Path
    preamble: tuple[str, ...]
    header: tuple[str, ...]
    line: int
    delimiter: str | None
    rows: Iterator[tuple[int, str]]

    def columns(self, wanted: Sequence[int]) -> Array:
        """(N, len(wanted)) numbers of these columns; empty cells are NaN.

        Raises FormatError naming line and column for a cell that is no number, for a row of another length
        than the header's, and where there is no row.
        """
        numbers = _text.Rows(self.path, [self.header[i] for i in wanted])
        for number, line in self.rows:
            if not line.strip() or line.startswith("#"):
                continue
            cells = _cells(line, self.delimiter)
            while len(cells) > len(self.header) and not cells[-1]:
                cells.pop()
            if len(cells) != len(self.header):
                found = f"{len(cells)} values, expected {len(self.header)}"
                raise FormatError(self.path, found, f"line {number}")
            numbers.add(number, [_number(cells[i]) or "nan" for i in wanted])
        table = numbers.table()
        if not len(table):
            raise FormatError(self.path, "no row of data")
        return table


def open_table(path: Path, known: Known, expected: str) -> Table:
    """The table whose header is the first line that, cut at some delimiter, is `known`.

    expected: what such a header has, for the error where there is none.
    """
    rows = _text.lines(path)
    preamble: list[str] = []
    said: str | None = None
    first = 0
    for number, line in rows:
        if line.lower().startswith("sep=") and len(line.strip()) <= 5:
            said = line[4:5] or "\t"
        elif line.strip():
            first = first or number
            cut = {d: _header(line, d) for d in ((said,) if said else DELIMITERS)}
            fits = [d for d, cells in cut.items() if known(cells)]
            if fits:
                best = max(fits, key=lambda d: (d is not None and len(cut[d]) > 1, len(cut[d])))
                return Table(path, tuple(preamble), tuple(cut[best]), number, best, rows)
            preamble.append(line)
        if len(preamble) > MAX_PREAMBLE:
            break
    if not preamble:
        raise FormatError(path, "no row of data")
    raise FormatError(path, f"no column such as {expected}", f"line {first}")


def _header(line: str, delimiter: str | None) -> list[str]:
    """Column names, without the empty ones that a delimiter at the end makes."""
    cells = _cells(line, delimiter)
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    if '"' in line:
        return [c.strip() for c in next(csv.reader([line], delimiter=delimiter))]
    return [c.strip() for c in line.split(delimiter)]


def _number(cell: str) -> str:
    """A cell with a point as its decimal sign."""
    return cell.replace(",", ".", 1) if "," in cell else cell
