"""MATLAB files: right ones as scipy reads them, damaged ones refused, where scipy's reader may crash."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from mocap import formats
from mocap.errors import FormatError
from mocap.formats import Document, _mat5, qmt
from tests.mocap.formats import recording_files as files
from tests.mocap.formats.broken import must_fail

DAMAGED, STRUCTURE = 48, 500  # files that are read as qmt, and in all, of each way of storing


def _assert_same(ours: object, theirs: object) -> None:
    theirs = np.asarray(theirs)
    assert isinstance(ours, np.ndarray)
    assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("packed", [False, True])
def test_right_files_read_as_by_scipy(packed: bool, tmp_path: Path) -> None:
    """Every kind of number, small elements, odd lengths that are padded, three axes, nothing at all."""
    rng = np.random.default_rng(3)
    kinds = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
    fields = {k: rng.integers(0, 99, (5, 3)).astype(k) for k in kinds}
    more = {
        "one": 2.5,
        "axes": rng.normal(size=(2, 3, 4)),
        "none": np.empty((0, 3)),
        "row": [[1, 2]],
    }
    path = tmp_path / "a.mat"
    data = {"t": np.arange(7.0), "small": np.uint8([1, 2]), "hip": fields | more}
    savemat(path, data, do_compression=packed)
    ours = _mat5.read(path, data)
    theirs = loadmat(path, squeeze_me=True, struct_as_record=False)
    for name in ("t", "small"):
        _assert_same(ours[name], theirs[name])
    hip = ours["hip"]
    assert isinstance(hip, dict) and list(hip) == theirs["hip"]._fieldnames
    for name, value in hip.items():
        _assert_same(value, getattr(theirs["hip"], name))


def test_the_real_file(shared: Path) -> None:
    path = shared / "data/qmt-fullbody/full_body_example_data.mat"
    theirs = loadmat(path, squeeze_me=True, struct_as_record=False)
    ours = _mat5.read(path, {"t", *qmt.PLACES})
    _assert_same(ours["t"], theirs["t"])
    for name in qmt.PLACES:
        segment = ours[name]
        assert isinstance(segment, dict)
        for field in ("acc", "gyr", "quat"):
            _assert_same(segment[field], getattr(theirs[name], field))


def _element(order: str, kind: int, content: bytes) -> bytes:
    return struct.pack(order + "II", kind, len(content)) + content + bytes(-len(content) % 8)


@pytest.mark.parametrize("order", ["<", ">"])
def test_byte_orders(order: str, tmp_path: Path) -> None:
    """A variable written by hand, its name in the tag's own four bytes; scipy writes one order only."""
    mark = b"IM" if order == "<" else b"MI"
    small = struct.pack(order + "I", 1 << 16 | 1) + b"t\0\0\0"
    body = (
        _element(order, 6, struct.pack(order + "II", 6, 0))
        + _element(order, 5, struct.pack(order + "ii", 3, 1))
        + small
        + _element(order, 3, struct.pack(order + "3h", -1, 2, 300))
    )
    path = tmp_path / "a.mat"
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(order + "H", 0x100) + mark
    path.write_bytes(head + _element(order, 14, body))
    ours = _mat5.read(path, {"t"})["t"]
    _assert_same(ours, loadmat(path, squeeze_me=True)["t"])
    np.testing.assert_array_equal(ours, [-1, 2, 300])


def test_what_is_not_numbers_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    cells = np.array([None, None])
    cells[:] = [np.ones(2), "a"]
    fields = {"c": cells, "s": {"x": 1.0}, "t": "text", "z": np.array([1j, 2])}
    twice = np.zeros(2, dtype=[("x", "f8")])
    savemat(path, {"hip": fields, "many": twice, "other": np.eye(2)})
    found = _mat5.read(path, {"hip", "many"})
    words = {"c": "cells", "s": "a struct", "t": "text", "z": "complex numbers"}
    assert found == {"hip": words, "many": "a struct"}


@pytest.mark.parametrize(("field", "says"), [("t", "variable t: is text"), ("hip", "no segment")])
def test_a_variable_of_the_wrong_class(field: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"t": np.arange(3.0), "hip": {"acc": np.ones((3, 3))}, field: "text"})
    must_fail(path, qmt.FORMAT, says)


def test_twice(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"t": np.arange(3.0)})
    data = path.read_bytes()
    path.write_bytes(data + data[128:])
    with pytest.raises(FormatError, match="variable t: stands in the file twice"):
        _mat5.read(path, {"t"})


def _crashing(path: Path) -> Path:
    """Numbers stored as a type that the format does not have: a null pointer in scipy's reader."""
    savemat(path, {"t": np.arange(40.0)[:, None], "hip": {"acc": np.ones((40, 3))}})
    data = path.read_bytes()
    tag = struct.pack("<II", 9, 40 * 8)
    assert data.count(tag) == 1
    path.write_bytes(data.replace(tag, struct.pack("<II", 10, 40 * 8)))
    return path


def test_what_crashes_scipy_is_refused(tmp_path: Path) -> None:
    """The last line only shows that the file is of that kind; a scipy that raises is as well."""
    path = _crashing(tmp_path / "crash.mat")
    must_fail(path, qmt.FORMAT, "not a whole MATLAB 5 file: damaged or cut short")
    code = "import sys, scipy.io; scipy.io.loadmat(sys.argv[1])"
    assert subprocess.run([sys.executable, "-c", code, path], capture_output=True).returncode != 0


def _damage(data: bytes, rng: random.Random) -> bytes:
    """Bytes dropped in the middle, the end cut, or one to eight bytes changed."""
    at, kind = rng.randrange(len(data)), rng.choice(("drop", "cut", "flip", "flip"))
    if kind == "drop":
        return data[:at] + data[at + rng.randint(1, 200) :]
    if kind == "cut":
        return data[:at]
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        k = rng.randrange(len(data))
        if rng.random() < 0.5:  # near a variable's start, where what it declares stands
            k = min(max(data.rfind(b"\x0e\0\0\0", 0, k), 120) + rng.randrange(64), len(data) - 1)
        changed[k] ^= rng.randint(1, 255)
    return bytes(changed)


@pytest.mark.parametrize("packed", [False, True])
def test_damage(packed: bool, tmp_path: Path) -> None:
    """A document or a sentence, whatever is damaged; structure alone (quick) is tried more often."""
    path, rng, said = tmp_path / "a.mat", random.Random(11), set()
    savemat(path, files.qmt_data(files.raw(rate=100.0, T=150)), do_compression=packed)
    good = path.read_bytes()
    for k in range(STRUCTURE):
        path.write_bytes(_damage(good, rng))
        try:
            if k < DAMAGED:
                assert isinstance(formats.read(path), Document)
            else:
                _mat5.read(path, {"t", *qmt.PLACES})
        except FormatError as e:
            said.add(str(e))
    assert all("\n" not in text and text.startswith(str(path)) for text in said)
    # Damage reached the numbers too; packed files have a checksum before them.
    assert len(said) >= (1 if packed else 2), said
