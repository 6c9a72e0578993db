"""Numbers and structs of MATLAB's level 5 files, by the layout of MathWorks' "MAT-File Format".

scipy's reader is compiled and trusts what a file declares: damage ends the whole process instead of
raising. Here every size is compared with the bytes that are there before it is used, and nothing nests,
so that damage is an error whatever it is. What the readers do not need (cells, text, objects, sparse
and complex numbers) is named, not read.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mocap.errors import FormatError

Numbers = NDArray[Any]
Field = Numbers | str
"""Numbers without axes of length 1, or in words what stands there instead."""
Variable = Field | dict[str, Field]

MAX_BYTES = 1 << 30  # of a file's variables, unpacked
_MAX_AXES, _MAX_FIELDS = 32, 4096  # more would take time to count, and no MATLAB writes them
_HEADER = 128
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_STRUCT, _OPAQUE, _NUMERIC = 2, 17, range(6, 16)
_CLASSES = {
    1: "cells",
    2: "a struct",
    3: "an object",
    4: "text",
    5: "a sparse matrix",
    16: "a function",
}
_COMPLEX = 0x800
_Elements = Iterator[tuple[int, memoryview]]


class _Damaged(ValueError):
    """Bytes that are not what the format says must stand there."""


def read(path: Path, names: Collection[str]) -> dict[str, Variable]:
    """The variables of `names` that a file holds; a single struct as its fields.

    Numbers have the type in which they are stored, which may be narrower than MATLAB's. Raises
    FormatError for a file that is damaged, is no MAT-file of level 5, or unpacks to over `MAX_BYTES` or
    200 times its size (64 MiB are always allowed).
    """
    found: dict[str, Variable] = {}
    try:
        with path.open("rb") as f:
            for order, body in _matrices(path, f):
                name, rest = _named(body, order)
                if name in found:
                    raise FormatError(path, "stands in the file twice", f"variable {name}")
                if name in names:
                    found[name] = _variable(*rest, order)
    except (_Damaged, zlib.error) as e:
        raise FormatError(path, "not a whole MATLAB 5 file: damaged or cut short") from e
    return found


def _matrices(path: Path, file: BinaryIO) -> Iterator[tuple[str, memoryview]]:
    """Byte order ("<" or ">") and content of each variable, unpacked one at a time."""
    size = path.stat().st_size
    limit = min(MAX_BYTES, max(64 << 20, 200 * size))
    header = file.read(_HEADER)
    order = {b"IM": "<", b"MI": ">"}.get(header[126:])
    if order is None or struct.unpack(order + "H", header[124:126])[0] >> 8 != 1:
        raise _Damaged("no level 5 header")
    left, total = size - _HEADER, 0
    while tag := file.read(8):
        kind, count = struct.unpack(order + "II", tag.ljust(8, b"\0"))
        left -= 8 + count
        # Before the bytes are read: a count that lies would ask for 4 GiB.
        if left < 0:
            raise _Damaged("cut short")
        if count > limit - total:
            raise FormatError(path, f"holds more than {limit >> 20} MiB")
        body = memoryview(file.read(count))
        if kind == _COMPRESSED:
            kind, body = _unpacked(path, body, limit - total, order)
        if kind != _MATRIX:
            raise _Damaged(f"element {kind} where a variable must be")
        total += len(body)
        yield order, body


def _unpacked(path: Path, packed: memoryview, limit: int, order: str) -> tuple[int, memoryview]:
    """Type and content of the element in a zlib stream, of at most `limit` bytes."""
    unpack = zlib.decompressobj()
    body = unpack.decompress(packed, limit + 1)
    if len(body) > limit:
        raise FormatError(path, f"inflates to more than {limit >> 20} MiB")
    if not unpack.eof:
        raise _Damaged("a packed variable is cut short")
    return next(_elements(memoryview(body), order), (0, memoryview(b"")))


def _elements(data: memoryview, order: str) -> _Elements:
    """Type and content of the elements in `data`, which are padded to 8 bytes each."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise _Damaged("a tag is cut short")
        kind, count = struct.unpack_from(order + "II", data, at)
        start = at + 8
        if kind >> 16:  # a small element: its data lie in the tag
            kind, count, start = kind & 0xFFFF, kind >> 16, at + 4
        if start + count > len(data) or (start == at + 4 and count > 4):
            raise _Damaged("an element is longer than what holds it")
        yield kind, data[start : start + count]
        at = at + 8 if start == at + 4 else start + count + -count % 8


def _take(elements: _Elements, *kinds: int) -> memoryview:
    """The content of the next element, which must be of one of these types."""
    kind, content = next(elements, (0, memoryview(b"")))
    if kind not in kinds:
        raise _Damaged(f"element {kind}, expected one of {kinds}")
    return content


def _named(body: memoryview, order: str) -> tuple[str, tuple[_Elements, int, tuple[int, ...]]]:
    """A matrix's name and what `_variable` needs: the elements that follow, flags, dimensions."""
    elements = _elements(body, order)
    flags = _take(elements, _UINT32)
    if len(flags) != 8:
        raise _Damaged("flags of the wrong length")
    flag = int(struct.unpack_from(order + "I", flags)[0])
    if flag & 0xFF == _OPAQUE:  # has neither dimensions nor, here, a name
        return "", (elements, flag, ())
    dims = _take(elements, _INT32, _UINT32)
    if len(dims) % 4 or not 1 <= len(dims) // 4 <= _MAX_AXES:
        raise _Damaged("dimensions of the wrong length")
    shape = struct.unpack(f"{order}{len(dims) // 4}i", dims)
    name = bytes(_take(elements, _INT8, _UTF8)).decode("latin-1")
    return name, (elements, flag, shape)


def _variable(elements: _Elements, flag: int, shape: tuple[int, ...], order: str) -> Variable:
    if flag & 0xFF != _STRUCT or math.prod(shape) != 1:
        return _value(elements, flag, shape, order)
    width = _take(elements, _INT32)
    length = struct.unpack(order + "i", width)[0] if len(width) == 4 else 0
    names = bytes(_take(elements, _INT8))
    if length <= 0 or len(names) % length or len(names) // length > _MAX_FIELDS:
        raise _Damaged("field names of the wrong length")
    fields: dict[str, Field] = {}
    for at in range(0, len(names), length):
        content = _take(elements, _MATRIX)
        key = names[at : at + length].split(b"\0")[0].decode("latin-1")
        # MATLAB writes a field that was never set as an element without content.
        fields[key] = _value(*_named(content, order)[1], order) if content else np.empty(0)
    return fields


def _value(elements: _Elements, flag: int, shape: tuple[int, ...], order: str) -> Field:
    kind = flag & 0xFF
    if kind not in _NUMERIC:
        return _CLASSES.get(kind, "of an unknown class")
    if flag & _COMPLEX:
        return "complex numbers"
    stored, content = next(elements, (0, memoryview(b"")))
    if stored not in _NUMBERS:
        raise _Damaged(f"element {stored}, expected numbers")
    dtype = np.dtype(order + _NUMBERS[stored])
    if min(shape, default=-1) < 0 or math.prod(shape) * dtype.itemsize != len(content):
        raise _Damaged("dimensions and bytes differ")
    numbers = np.frombuffer(content, dtype)
    return numbers.reshape(shape, order="F").squeeze() if numbers.size else numbers
