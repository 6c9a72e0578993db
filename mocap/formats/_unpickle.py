"""Pickles of foreign data sets, read without running anything in them.

A pickle is a program. This one may only build numbers, texts, plain containers and numpy arrays: every
other name it asks for, and every instruction that makes an object of a class, ends the reading. Array
sizes are checked against the bytes that are there before numpy sees them. Never admit
`torch.storage._load_from_bytes`: it runs a whole unrestricted load inside.
"""

from __future__ import annotations

import io
import math
import pickle
import re
import struct
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mocap.errors import FormatError

MAX_BYTES = 2 << 30
MAX_INTEGER = 32  # bytes: sizes and counts take 8
MAX_AXES = 32
_KEYS = (str, bytes, int, float, bool, type(None), np.generic)
_PLAIN = re.compile(r"[<>|=]?(?:[fiucbSUO?]\d{0,7}|bool)")
_NDARRAY = "numpy.ndarray"  # stands for the class, and cannot be called
# Instructions that make instances of classes, or reach outside the pickle.
_REFUSED = (
    "PERSID", "BINPERSID", "EXT1", "EXT2", "EXT4", "INST", "OBJ", "NEWOBJ", "NEWOBJ_EX", "NEXT_BUFFER",
    "READONLY_BUFFER",
)  # fmt: skip


def load(path: Path, extra: Mapping[str, type] | None = None) -> Any:
    """What a pickle file holds: numbers, texts, bytes, containers, arrays.

    Texts of Python 2 are read as latin-1. extra: inert classes by the name that the pickle knows them
    under ("chumpy.ch.Ch"), made without arguments and given their state through `__setstate__`. Raises
    FormatError where the file is damaged, too large, or asks for anything else.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise FormatError(path, f"{size >> 20} MiB, at most {MAX_BYTES >> 20} are unpickled")
    return loads(path.read_bytes(), path, extra)


def loads(data: bytes, path: Path, extra: Mapping[str, type] | None = None) -> Any:
    """The same of bytes that come from `path`."""
    try:
        return _Unpickler(data, path, extra or {}).load()
    except FormatError:
        raise
    except MemoryError as e:
        raise FormatError(path, "the pickle declares more than fits into memory") from e
    # The bytes are a program: it may fail in any way a program can.
    except Exception as e:
        raise FormatError(path, "not a whole pickle: damaged or cut short") from e


class _Unpickler(pickle._Unpickler):
    """The interpreter in Python, whose instructions can be replaced one by one."""

    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)

    def __init__(self, data: bytes, path: Path, extra: Mapping[str, type]):
        super().__init__(io.BytesIO(data), fix_imports=False, encoding="latin1")
        self.path, self.extra = path, extra
        self.stack: list[Any]

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in for a name; raises FormatError where there is none."""
        full = f"{module}.{name}".replace("numpy._core.", "numpy.core.")
        if full in _KNOWN:
            return _KNOWN[full]
        if full in self.extra:
            return _Maker(self.extra[full])
        if full in ("copy_reg._reconstructor", "copyreg._reconstructor") and self.extra:
            return _reconstructor
        raise FormatError(
            self.path, f"asks for {full[:80]!r}; only arrays and plain containers are unpickled"
        )

    def refuse(self) -> None:
        raise FormatError(
            self.path, "makes objects of classes; only arrays and plain containers are unpickled"
        )

    def make(self) -> None:
        """NEWOBJ: an instance of an extra class, else refused."""
        self.stack.pop()
        maker = self.stack.pop()
        if not isinstance(maker, _Maker):
            self.refuse()
        self.stack.append(maker())

    def reduce(self) -> None:
        """REDUCE: a call, of one of the stand-ins only."""
        args = self.stack.pop()
        call = self.stack.pop()
        if not (isinstance(call, _Maker) or call in _CALLABLE):
            self.refuse()
        self.stack.append(call() if isinstance(call, _Maker) else call(*args))

    def build(self) -> None:
        """BUILD: the state of an array, of its type, or of an extra class."""
        state = self.stack.pop()
        target = self.stack[-1]
        if type(target) is np.ndarray:
            _fill(target, state)
        elif isinstance(target, np.dtype):
            _set_order(target, state)
        elif type(target) in self.extra.values():
            target.__setstate__(state)
        else:
            self.refuse()

    def byte_array(self) -> None:
        """BYTEARRAY8, without allocating what it declares before it is there."""
        (size,) = struct.unpack("<Q", self.read(8))  # type: ignore[attr-defined]
        data = self.read(min(size, MAX_BYTES))  # type: ignore[attr-defined]
        if len(data) != size:
            raise EOFError
        self.append(bytes(data))  # type: ignore[attr-defined]

    def plain_key(self, key: Any) -> Any:
        """A key or member as it is. Raises FormatError for a container: hashing nested ones may never end."""
        if not isinstance(key, _KEYS) or isinstance(key, np.ndarray):
            found = type(key).__name__
            raise FormatError(self.path, f"has a {found} as a key; only plain values are keys")
        return key

    def set_item(self) -> None:
        """SETITEM: one pair into a dictionary."""
        value = self.stack.pop()
        key = self.plain_key(self.stack.pop())
        self._target(dict)[key] = value

    def set_items(self) -> None:
        """SETITEMS: pairs into a dictionary."""
        items = self.pop_mark()  # type: ignore[attr-defined]
        target = self._target(dict)
        for k in range(0, len(items), 2):
            target[self.plain_key(items[k])] = items[k + 1]

    def make_dict(self) -> None:
        """DICT: a dictionary of the pairs since the mark."""
        items = self.pop_mark()  # type: ignore[attr-defined]
        pairs = zip(items[::2], items[1::2], strict=True)
        self.stack.append({self.plain_key(k): v for k, v in pairs})

    def add_items(self) -> None:
        """ADDITEMS: members into a set."""
        items = self.pop_mark()  # type: ignore[attr-defined]
        self._target(set).update(self.plain_key(x) for x in items)

    def frozen_set(self) -> None:
        """FROZENSET: of the members since the mark."""
        items = self.pop_mark()  # type: ignore[attr-defined]
        self.stack.append(frozenset(self.plain_key(x) for x in items))

    def _target(self, kind: type) -> Any:
        """The container on top, which must be of this kind."""
        if not isinstance(self.stack[-1], kind):
            self.refuse()
        return self.stack[-1]

    def long_number(self) -> None:
        """LONG1: an integer of at most MAX_INTEGER bytes."""
        self._long(self.read(1)[0])  # type: ignore[attr-defined]

    def longer_number(self) -> None:
        """LONG4: the same."""
        (size,) = struct.unpack("<i", self.read(4))  # type: ignore[attr-defined]
        self._long(size)

    def _long(self, size: int) -> None:
        if not 0 <= size <= MAX_INTEGER:
            raise FormatError(self.path, f"holds an integer of {size} bytes, at most {MAX_INTEGER}")
        data = self.read(size)  # type: ignore[attr-defined]
        self.append(int.from_bytes(data, "little", signed=True))  # type: ignore[attr-defined]

    def text_number(self) -> None:
        """INT and LONG of protocol 0: digits on a line."""
        line = self.readline()[:-1]  # type: ignore[attr-defined]
        if line in (b"00", b"01"):
            self.append(line == b"01")  # type: ignore[attr-defined]
            return
        if len(line) > 3 * MAX_INTEGER:
            raise FormatError(self.path, f"holds an integer of {len(line)} digits")
        self.append(int(line.rstrip(b"L") or b"0", 10))  # type: ignore[attr-defined]


for _name in _REFUSED:
    _Unpickler.dispatch[getattr(pickle, _name)[0]] = _Unpickler.refuse
_Unpickler.dispatch[pickle.NEWOBJ[0]] = _Unpickler.make
_Unpickler.dispatch[pickle.REDUCE[0]] = _Unpickler.reduce
_Unpickler.dispatch[pickle.BUILD[0]] = _Unpickler.build
_Unpickler.dispatch[pickle.BYTEARRAY8[0]] = _Unpickler.byte_array
_Unpickler.dispatch[pickle.SETITEM[0]] = _Unpickler.set_item
_Unpickler.dispatch[pickle.SETITEMS[0]] = _Unpickler.set_items
_Unpickler.dispatch[pickle.DICT[0]] = _Unpickler.make_dict
_Unpickler.dispatch[pickle.ADDITEMS[0]] = _Unpickler.add_items
_Unpickler.dispatch[pickle.FROZENSET[0]] = _Unpickler.frozen_set
_Unpickler.dispatch[pickle.LONG1[0]] = _Unpickler.long_number
_Unpickler.dispatch[pickle.LONG4[0]] = _Unpickler.longer_number
_Unpickler.dispatch[pickle.INT[0]] = _Unpickler.text_number
_Unpickler.dispatch[pickle.LONG[0]] = _Unpickler.text_number


class _Maker:
    """Makes instances of an extra class, whatever arguments the pickle has for it."""

    def __init__(self, kind: type):
        self.kind = kind

    def __call__(self) -> Any:
        return self.kind()


def _reconstructor(maker: Any, *_: Any) -> Any:
    """copyreg's: an instance of an extra class."""
    if not isinstance(maker, _Maker):
        raise TypeError
    return maker()


def _array(kind: Any, *_: Any) -> np.ndarray:
    """numpy's _reconstruct: an empty array, whose state follows."""
    if kind != _NDARRAY:
        raise TypeError
    return np.ndarray((0,), np.int8)


def _dtype(text: Any, *_: Any) -> np.dtype[Any]:
    """numpy.dtype of a plain kind: no structures, no subarrays, nothing larger than its text says."""
    if isinstance(text, bytes):
        text = text.decode("latin1")
    if not isinstance(text, str) or not _PLAIN.fullmatch(text):
        raise TypeError
    return np.dtype(text, False, True)


def _set_order(dtype: np.dtype[Any], state: Any) -> None:
    """The byte order of a plain type; its other state must say nothing new."""
    order = state[1].decode("latin1") if isinstance(state[1], bytes) else state[1]
    if order not in ("<", ">", "|", "=") or any(s is not None for s in state[2:5]):
        raise TypeError
    sized = dtype.kind in "SU"
    if sized and state[5] != dtype.itemsize:
        raise ValueError
    size, alignment, flags = state[5:8] if sized else (-1, -1, 63 if dtype.hasobject else 0)
    dtype.__setstate__((3, order, None, None, None, size, alignment, flags))  # type: ignore[attr-defined]


def _count(shape: Any) -> int:
    if not isinstance(shape, tuple) or len(shape) > MAX_AXES:
        raise TypeError
    if not all(type(n) is int and 0 <= n <= MAX_BYTES for n in shape):
        raise TypeError
    return math.prod(shape)


def _fill(array: np.ndarray, state: Any) -> None:
    """An array's shape, type and data, which must be as many as the shape says."""
    shape, dtype, fortran, data = state[-4:]
    count = _count(shape)
    if not isinstance(dtype, np.dtype):
        raise TypeError
    if isinstance(data, str):
        data = data.encode("latin1")
    if dtype.hasobject != isinstance(data, list):
        raise TypeError
    if len(data) != count * (1 if dtype.hasobject else dtype.itemsize):
        raise ValueError
    array.__setstate__((1, shape, dtype, bool(fortran), data))  # type: ignore[arg-type]


def _scalar(dtype: Any, data: Any) -> Any:
    """One number of a plain type."""
    if isinstance(data, str):
        data = data.encode("latin1")
    if not isinstance(dtype, np.dtype) or dtype.hasobject or len(data) != dtype.itemsize:
        raise TypeError
    return np.frombuffer(data, dtype)[0]


def _from_buffer(data: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """numpy's _frombuffer, the array of protocol 5."""
    if not isinstance(dtype, np.dtype) or dtype.hasobject or order not in ("C", "F"):
        raise TypeError
    if len(data) != _count(shape) * dtype.itemsize:
        raise ValueError
    return np.frombuffer(data, dtype).reshape(shape, order=order)


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    """codecs.encode, as Python 3 writes bytes for Python 2."""
    if encoding != "latin1" or not isinstance(text, str):
        raise TypeError
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """bytes(), as Python 3 writes empty bytes for Python 2."""
    return b""


def _set(members: Any = ()) -> set[Any]:
    """set of plain values, as Python 2 pickles it."""
    if not isinstance(members, list | tuple) or not all(isinstance(x, _KEYS) for x in members):
        raise TypeError
    return set(members)


def _frozen(members: Any = ()) -> frozenset[Any]:
    """frozenset of plain values."""
    return frozenset(_set(members))


def _ordered(*_: Any) -> OrderedDict[Any, Any]:
    return OrderedDict()


_KNOWN: dict[str, Any] = {
    "numpy.ndarray": _NDARRAY,
    "numpy.dtype": _dtype,
    "numpy.core.multiarray._reconstruct": _array,
    "numpy.core.multiarray.scalar": _scalar,
    "numpy.core.numeric._frombuffer": _from_buffer,
    "_codecs.encode": _encode,
    "collections.OrderedDict": _ordered,
    "__builtin__.bytes": _no_bytes,
    "__builtin__.set": _set,
    "builtins.set": _set,
    "__builtin__.frozenset": _frozen,
    "builtins.frozenset": _frozen,
}
_CALLABLE: tuple[Callable[..., Any], ...] = (
    _dtype, _array, _scalar, _from_buffer, _encode, _no_bytes, _ordered, _set, _frozen, _reconstructor,
)  # fmt: skip
