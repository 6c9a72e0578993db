"""Breaking small good files, and demanding one sentence from whoever reads them."""

from __future__ import annotations

import re
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap.errors import FormatError, PoserError
from mocap.formats import Document, Format, Options

Break = Callable[[Path], Path]
Cases = dict[str, tuple[Break, str]]
SECONDS, MEGABYTES = 10.0, 400
LEFT_HANDED = np.diag([1.0, 1, -1])
DEG = 180 / np.pi
BOMB = '<!DOCTYPE mvnx [<!ENTITY a "0"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>'


@contextmanager
def at_most(megabytes: float) -> Iterator[None]:
    """What the block allocates, numpy's arrays included, stays below this at every moment.

    Counted by tracemalloc, which slows a reader down two to four times; a process's largest size so far
    would be cheaper, but after one large test it grows no more.
    """
    already = tracemalloc.is_tracing()
    if not already:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    try:
        yield
    finally:
        peak = (tracemalloc.get_traced_memory()[1] - before) / 2**20
        if not already:
            tracemalloc.stop()
        assert peak < megabytes, f"{peak:.0f} MiB"


def changed(write: Callable[[Path], Path], change: Callable[[Path], object]) -> Break:
    """A good file or folder as `write` makes it, then changed in place."""

    def make(folder: Path) -> Path:
        out = write(folder)
        change(out)
        return out

    return make


def must_fail(path: Path, reader: Format, message: str = "") -> None:
    """Reading fails with one sentence about this file that matches `message`, fast and small.

    Fast is by the processor's time, which a busy machine does not stretch.
    """
    start = time.process_time()
    with pytest.raises(PoserError) as caught, at_most(MEGABYTES):
        reader.read(path, Options())
    text = str(caught.value)
    assert "\n" not in text and len(text) - len(str(path)) < 800, text
    if isinstance(caught.value, FormatError):
        # The error may be in a file beside or inside it.
        assert str(path if path.is_dir() else path.parent) in text, text
    assert re.search(message, text), text
    assert time.process_time() - start < SECONDS


def must_read(path: Path, reader: Format) -> None:
    """A good file is recognised and read, so that a broken one fails by what was broken."""
    head = path.read_bytes()[:4096] if path.is_file() else b""
    assert reader.sniff(path, head)
    assert isinstance(reader.read(path, Options()), Document)


def cut(path: Path, keep: float) -> Path:
    """The file with only the first part of its bytes."""
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    return path


def replaced(path: Path, old: str, new: str, count: int = 1) -> Path:
    """A text file with `old` replaced, which it must hold."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))
    return path


def one(array: np.ndarray, at: tuple[int, ...], value: object) -> np.ndarray:
    """A copy of an array with one place written anew."""
    array = array.copy()
    array[at] = value
    return array


def parameters(*groups: tuple[Format, Cases]) -> Iterable[Any]:
    """All cases for `pytest.mark.parametrize(("reader", "make", "message"), ...)`."""
    return [
        pytest.param(reader, make, message, id=f"{reader.name}: {case}")
        for reader, cases in groups
        for case, (make, message) in cases.items()
    ]
