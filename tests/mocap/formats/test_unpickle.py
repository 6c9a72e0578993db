"""The unpickler: arrays and containers of every protocol come through, nothing else does."""

from __future__ import annotations

import collections
import os
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest

from mocap.errors import FormatError
from mocap.formats import _unpickle

HERE = Path("data.pkl")
ARRAYS = (
    np.arange(12.0).reshape(3, 4),
    np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    np.arange(6, dtype=">i4"),
    np.array([True, False]),
    np.array(["left", "right"]),
    np.array([b"ab", b"c"]),
    np.zeros((0, 3)),
    np.array(3.5),
    np.arange(3, dtype=np.float32),
)


@pytest.mark.parametrize("protocol", range(6))
def test_what_data_sets_hold(protocol: int) -> None:
    data = {
        "arrays": list(ARRAYS), "scalar": np.float64(2.5), "int": np.int32(7), "text": "Grüße", "n": None,
        "nested": [{"a": (1, 2.5, True)}], "bytes": b"\x00\xff", "big": 10**30, "set": {1, 2},
        "ordered": collections.OrderedDict(x=1),
    }  # fmt: skip
    back = _unpickle.loads(pickle.dumps(data, protocol), HERE)
    for have, want in zip(back.pop("arrays"), data.pop("arrays"), strict=True):  # type: ignore[call-overload]
        # numpy itself turns foreign byte orders into the machine's as it unpickles.
        assert have.dtype == want.dtype.newbyteorder("=") or protocol == 5
        assert have.shape == want.shape
        np.testing.assert_array_equal(have, want)
    assert back == data


@pytest.mark.parametrize("protocol", [2, 4])
def test_sequences_of_different_lengths(protocol: int) -> None:
    want = np.empty(2, object)
    want[:] = [np.zeros((3, 2)), np.ones((5, 2))]
    back = _unpickle.loads(pickle.dumps(want, protocol), HERE)
    assert back.shape == (2,) and [len(x) for x in back] == [3, 5]


def _python2(
    raw: bytes, shape: bytes = b"K\x02\x85", kind: bytes = b"f8", last: bytes = b"b."
) -> bytes:
    """An array of doubles as Python 2 and an old numpy pickled it: byte strings, numpy.core."""
    return (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\nq\x01cnumpy\nndarray\nq\x02K\x00\x85U\x01b\x87Rq\x03"
        b"(K\x01" + shape + b"cnumpy\ndtype\nq\x04U" + bytes([len(kind)]) + kind + b"K\x00K\x01\x87Rq\x05"
        b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U"
        + bytes([len(raw)]) + raw + b"t" + last
    )  # fmt: skip


def test_python_2() -> None:
    back = _unpickle.loads(_python2(struct.pack("<2d", 1.5, -2.0)), HERE)
    np.testing.assert_array_equal(back, [1.5, -2.0])


class Calls:
    """Pickled as a call of any function."""

    def __init__(self, function: object, *args: object):
        self.function, self.args = function, args

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return self.function, self.args


class Plain:
    """An ordinary object with state."""

    def __init__(self) -> None:
        self.x = 1


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize(
    "evil",
    [
        Calls(os.system, "touch executed"),
        Calls(eval, "open('executed', 'w')"),
        Calls(getattr, "x", "upper"),
        Calls(np.load, "x.npy"),
        Calls(np.zeros, 10**13),
        Calls(np.ndarray, (10**13,)),
        Calls(bytearray, 10**13),
        Plain(),
        os.getcwd,
        Path("x"),
    ],
    ids=lambda e: getattr(getattr(e, "function", e), "__name__", type(e).__name__),
)
def test_nothing_is_run(
    protocol: int, evil: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FormatError, match=r"data\.pkl: .*(asks for|makes objects|damaged|arrays)"):
        _unpickle.loads(pickle.dumps([evil], protocol), HERE)
    assert list(tmp_path.iterdir()) == []


def test_torch_storages_are_named() -> None:
    text = b"\x80\x02ctorch.storage\n_load_from_bytes\nC\x01x\x85R."
    with pytest.raises(FormatError, match=r"asks for 'torch\.storage\._load_from_bytes'"):
        _unpickle.loads(text, HERE)


@pytest.mark.parametrize(
    "data",
    [
        _python2(bytes(16), shape=b"K\x03\x85"),  # three numbers declared, two there
        _python2(bytes(16), shape=b"\x8a\x06\x00\x00\x00\x00\x00\x01\x85"),  # a trillion declared
        _python2(bytes(16), shape=b"J\xff\xff\xff\xff\x85"),  # a negative count
        _python2(bytes(16), kind=b"O8"),  # bytes for pointers
        _python2(bytes(16), kind=b"f8,f8"),  # a structure
        _python2(bytes(16), kind=b"V9"),
        _python2(bytes(16), last=b""),  # no end
        b"",
        b"\x80\x02.",
        b"\x80\x63N.",  # protocol 99
        b"\x96\xff\xff\xff\xff\xff\xff\xff\x7f.",  # a byte array of 2^63 bytes
        b"\x95\xff\xff\xff\xff\xff\xff\xff\x7f.",  # a frame of 2^63 bytes
        b"\x8e\xff\xff\xff\xff\xff\xff\x00\x00.",  # bytes of 2^48
        b"cnumpy\nndarray\n)R.",  # the class itself called
        b"Pid\n.",
        b"(i__main__\nx\n.",
        b"\x82\x01.",
        b"(" * 100_000 + b".",
        b"]" * 100_000 + b"a" * 99_999 + b"x",
    ],
)
def test_broken(data: bytes) -> None:
    with pytest.raises(FormatError) as caught:
        _unpickle.loads(data, HERE)
    assert "\n" not in str(caught.value)


class Inert:
    """A stand-in for a class that a data set's pickle names."""

    def __setstate__(self, state: object) -> None:
        self.state = state


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_extra_classes_keep_their_state(protocol: int) -> None:
    name = f"{Plain.__module__}.{Plain.__qualname__}"
    data = pickle.dumps([Plain()], protocol)
    if protocol == 0:
        data = data.replace(b"c__builtin__\nobject\n", b"N")  # the base class is not needed
    (back,) = _unpickle.loads(data, HERE, {name: Inert})
    assert isinstance(back, Inert) and back.state == {"x": 1}
