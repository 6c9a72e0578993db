"""Numpy archives, read without trusting what they declare.

An `.npz` is a zip of `.npy` members. Each has two declared sizes: that of the zip directory, which
bounds how far a member is inflated, and that of its own header, which numpy allocates before it
reads. Both are checked against each other and against limits before anything is loaded; pickled
objects are refused.
"""

from __future__ import annotations

import json
import math
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import FormatError
from mocap.formats import _unpickle

MAX_BYTES = 1 << 30  # of all wanted members together: over three hours of a full suit at 100 Hz
MAX_FLOATS = 2 << 30  # bytes of the same as the float64 that readers make of them
BOMB_BYTES, BOMB_RATIO = (
    64 << 20,
    200,
)  # of these float64: above this size, no recording packs so well

# What zipfile and numpy raise on bytes that are not what they should be.
BROKEN = (
    zipfile.BadZipFile, zlib.error, ValueError, EOFError, RuntimeError,
    KeyError, OverflowError, TypeError, SyntaxError, tokenize.TokenError, UserWarning, OSError,
)  # fmt: skip


def names(path: Path) -> frozenset[str]:
    """Names of the arrays in an archive, without `.npy`; empty where the file is no archive."""
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(n.removesuffix(".npy") for n in archive.namelist())
    except BROKEN:
        return frozenset()


def load(path: Path, wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """The arrays among `wanted` that the archive has.

    Raises FormatError where the archive is damaged, an array is pickled, declares another size than
    it has, or all of them together exceed `MAX_BYTES`.
    """
    wanted = set(wanted)
    try:
        archive = zipfile.ZipFile(path)
    except BROKEN as e:
        raise FormatError(path, "not a whole .npz archive: damaged or cut short") from e
    with archive:
        found = {i.filename.removesuffix(".npy"): i for i in archive.infolist()}
        found = {name: info for name, info in found.items() if name in wanted}
        total = sum(info.file_size for info in found.values())
        if total > MAX_BYTES:
            raise FormatError(
                path,
                f"declares {total / 2**20:.0f} MiB of data, at most {MAX_BYTES >> 20} are read",
            )
        becomes = {name: _becomes(path, archive, name, info) for name, info in found.items()}
        whole = sum(becomes.values())
        most = f"array {max(becomes, key=lambda name: becomes[name])!r}" if becomes else ""
        if whole > MAX_FLOATS:
            raise FormatError(
                path, f"{whole >> 20} MiB of numbers, at most {MAX_FLOATS >> 20} in a file", most
            )
        _refuse_bomb(path, whole, sum(info.compress_size for info in found.values()), most)
        return {name: _member(path, archive, name, info) for name, info in found.items()}


def _becomes(path: Path, archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> int:
    """Bytes that an array takes as readers keep it: its numbers as float64, so a byte in the file is eight.

    Raises FormatError where it is damaged, pickled, packed in a way that is not read, or not of the size that
    the archive says.
    """
    where = f"array {name!r}"
    _check_method(path, info, where)
    try:
        with warnings.catch_warnings(), archive.open(info) as stream:
            warnings.simplefilter("error")
            shape, dtype = _header(stream)
            declared = math.prod(shape) * dtype.itemsize + stream.tell()
    except (*BROKEN, RecursionError) as e:
        raise FormatError(path, "damaged or cut short", where) from e
    if dtype.hasobject:
        raise FormatError(path, "holds pickled objects, which are never loaded", where)
    if declared != info.file_size:
        size = str(declared) if abs(declared) < 10**18 else "over 10^18"
        raise FormatError(
            path, f"declares {size} bytes (shape {_short(shape)}), has {info.file_size}", where
        )
    return math.prod(shape) * (8 if dtype.kind in "iuf" else dtype.itemsize)


def _member(path: Path, archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> np.ndarray:
    try:
        with archive.open(info) as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)
    except (*BROKEN, RecursionError) as e:
        raise FormatError(path, "damaged or cut short", f"array {name!r}") from e


def load_objects(path: Path, name: str) -> list[Any]:
    """The items of a one-dimensional object array, unpickled without running anything in it.

    For foreign data sets whose archives hold sequences of different lengths. Raises FormatError as
    `load` does, and where the pickle holds more than arrays and plain containers.
    """
    where = f"array {name!r}"
    try:
        with zipfile.ZipFile(path) as archive:
            info = archive.getinfo(f"{name}.npy")
            if info.file_size > MAX_BYTES:
                raise FormatError(path, f"declares {info.file_size >> 20} MiB", where)
            _check_method(path, info, where)
            # What the pickle holds is not known yet: a byte of it may become a float64.
            _refuse_bomb(path, 8 * info.file_size, info.compress_size, where)
            with archive.open(info) as stream:
                shape, _ = _header(stream)
                data = stream.read()
    except (*BROKEN, RecursionError) as e:
        raise FormatError(path, "damaged or cut short", where) from e
    items = _unpickle.loads(data, path)
    if not isinstance(items, np.ndarray) or items.shape != shape or len(shape) != 1:
        raise FormatError(path, f"declares {shape}, expected a list of sequences", where)
    return list(items)


def _refuse_bomb(path: Path, becomes: int, packed: int, where: str) -> None:
    """Refuse what would become far more than the file is. The directory of a zip may overstate `packed`."""
    packed = min(packed, path.stat().st_size)
    if becomes > BOMB_BYTES and becomes > BOMB_RATIO * packed:
        raise FormatError(path, f"{becomes >> 20} MiB packed in {packed} bytes", where)


def _check_method(path: Path, info: zipfile.ZipInfo, where: str) -> None:
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FormatError(path, "compressed by a method other than deflate", where)


def _short(shape: tuple[int, ...]) -> str:
    """A shape for a message: what a damaged file declares may have thousands of digits, or of axes."""
    words = ", ".join(str(n) if abs(n) < 10**18 else "..." for n in shape[:8])
    return f"({words}{', ...' if len(shape) > 8 else ''})"


def _header(stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise ValueError(f"npy version {version}")
    return shape, dtype


class Fields:
    """The arrays of one file, taken out by name with their kind and shape checked."""

    def __init__(self, path: Path, arrays: dict[str, np.ndarray]):
        self.path, self.arrays = path, arrays

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def get(self, name: str) -> np.ndarray:
        """The array; raises FormatError where it is missing."""
        if name not in self.arrays:
            raise FormatError(self.path, f"field {name!r} is missing")
        return self.arrays[name]

    def floats(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """A real array of that shape as float64; None stands for any positive length."""
        a = self.get(name)
        if a.dtype.kind not in "fiu":
            raise FormatError(
                self.path, f"holds {a.dtype}, expected real numbers", f"field {name!r}"
            )
        self._shape(name, a, shape)
        with np.errstate(over="ignore", invalid="ignore"):
            return a.astype(np.float64)

    def integers(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """An integer array of that shape as int64."""
        a = self.get(name)
        if a.dtype.kind not in "iu":
            raise FormatError(self.path, f"holds {a.dtype}, expected integers", f"field {name!r}")
        self._shape(name, a, shape)
        return a.astype(np.int64)

    def bools(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """A boolean array of that shape (0 and 1 of other kinds are taken)."""
        a = self.get(name)
        if a.dtype.kind not in "bfiu" or not np.isin(a, (0, 1)).all():
            raise FormatError(self.path, "holds something other than yes and no", f"field {name!r}")
        self._shape(name, a, shape)
        return a.astype(bool)

    def number(self, name: str) -> float:
        """One finite number."""
        value = float(
            self.floats(name, ()) if self.get(name).ndim == 0 else self.floats(name, (1,))[0]
        )
        if not math.isfinite(value):
            raise FormatError(self.path, f"is {value}, expected a finite number", f"field {name!r}")
        return value

    def texts(self, name: str) -> tuple[str, ...]:
        """A list of strings (N,)."""
        a = self.get(name)
        if a.dtype.kind not in "US" or a.ndim != 1:
            raise FormatError(
                self.path, f"is {a.dtype} {a.shape}, expected a list of texts", f"field {name!r}"
            )
        return tuple(_text(v) for v in a)

    def text(self, name: str) -> str:
        """One string."""
        a = self.get(name)
        if a.dtype.kind not in "US" or a.size != 1:
            raise FormatError(
                self.path, f"is {a.dtype} {a.shape}, expected text", f"field {name!r}"
            )
        return _text(a.reshape(-1)[0])

    def mapping(self, name: str) -> dict[str, Any] | None:
        """A JSON object kept as text; None where the field is absent."""
        if name not in self.arrays:
            return None
        try:
            value = json.loads(self.text(name))
        except (ValueError, RecursionError) as e:
            raise FormatError(self.path, "is not JSON text", f"field {name!r}") from e
        if not isinstance(value, dict):
            raise FormatError(self.path, "is JSON, but not an object", f"field {name!r}")
        return value

    def _shape(self, name: str, a: np.ndarray, shape: tuple[int | None, ...]) -> None:
        fits = a.ndim == len(shape) and all(
            have == want or (want is None and have > 0)
            for have, want in zip(a.shape, shape, strict=True)
        )
        if not fits:
            want = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ")"
            raise FormatError(self.path, f"has shape {a.shape}, expected {want}", f"field {name!r}")


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
