"""Broken archives: native npz, MATLAB (see `broken`)."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from mocap import orientation as ori
from mocap import synthesis
from mocap.errors import FormatError
from mocap.formats import Document, Format, Options, native, qmt
from mocap.formats import _npz as archives
from mocap.recording import RawRecording, Recording
from mocap.synthesis import motions
from tests.mocap.formats import recording_files as files
from tests.mocap.formats.broken import (
    DEG,
    LEFT_HANDED,
    MEGABYTES,
    Break,
    Cases,
    cut,
    must_fail,
    must_read,
    one,
    parameters,
)

# ------------------------------------------------------------------------------------------ native


def _npz(write: Callable[[Path], Path], **changes: object) -> Break:
    """A good native file with arrays changed (a function of the old one), replaced, or dropped (None)."""

    def make(folder: Path) -> Path:
        path = write(folder)
        with np.load(path) as f:
            arrays = dict(f)
        for name, change in changes.items():
            if change is None:
                del arrays[name]
            else:
                arrays[name] = change(arrays[name]) if callable(change) else change
        np.savez_compressed(path, **arrays)
        return path

    return make


_REC, _RAW = files.native_recording, files.native_raw


def _member(write: Callable[[Path], Path], name: str, data: bytes) -> Break:
    return lambda folder: files.with_member(write(folder), folder / "broken.npz", name, data)


def _turned_up(R: np.ndarray) -> np.ndarray:
    return (ori.R_ZUP_YUP @ R).astype(np.float32)


def _pickled_npz(write: Callable[[Path], Path], field: str) -> Break:
    """A native file in which one array is a pickle that would write a file when loaded."""

    def make(folder: Path) -> Path:
        return _npz(write, **{field: files.objects([files.Evil(folder / "executed")])})(folder)

    return make


NATIVE: Cases = {
    "cut": (lambda d: cut(_REC(d), 0.5), "damaged or cut short"),
    "empty": (lambda d: cut(_REC(d), 0.0), "damaged or cut short"),
    "other schema": (_npz(_REC, schema="poser-recording/9"), "schema is 'poser-recording/9'"),
    "no schema": (_npz(_REC, schema=None), "field 'schema' is missing"),
    "no rate": (_npz(_REC, rate_hz=None), "field 'rate_hz' is missing"),
    "rate zero": (_npz(_REC, rate_hz=0.0), "rate_hz must lie between 1 and 10000"),
    "rate nan": (_npz(_RAW, rate_hz=np.nan), "field 'rate_hz': is nan"),
    "sensor twice": (_npz(_REC, sensors=np.array(["pelvis"] * 5)), "not unique"),
    "unknown place": (
        _npz(_REC, sensors=lambda s: one(s, (0,), "tail"), joint=None),
        "sensor place 'tail' unknown",
    ),
    "wrong shape": (_npz(_REC, acc_world=lambda a: a[:, :4]), r"has shape \(240, 4, 3\), expected"),
    "wrong length": (_npz(_RAW, gyr=lambda a: a[:-7]), r"'gyr': has shape \(233, 5, 3\)"),
    "no frames": (_npz(_RAW, acc=lambda a: a[:0]), r"has shape \(0, 5, 3\), expected \(N, 5, 3\)"),
    "complex": (_npz(_RAW, acc=lambda a: a + 1j), "holds complex64, expected real numbers"),
    "left-handed": (
        _npz(_REC, R_world_bone=lambda R: R @ LEFT_HANDED),
        "frame 1, sensor pelvis: R_world_bone is left-handed",
    ),
    "recording not orthonormal": (
        _npz(_REC, R_world_bone=lambda R: 1.3 * R),
        "frame 1, sensor pelvis: R_world_bone is not orthonormal .determinant 2.2, expected 1., as are 238",
    ),
    "not orthonormal": (
        _npz(_RAW, R_world_sensor=lambda R: 1.3 * R),
        "frame 0, sensor pelvis: R_world_sensor is not orthonormal",
    ),
    "acc in g": (_npz(_RAW, acc=lambda a: a / 9.81), "so the unit is g"),
    "gyr in degrees": (_npz(_RAW, gyr=lambda a: a * DEG), "57 times what the orientation turns"),
    "z up": (_npz(_RAW, R_world_sensor=_turned_up), r"expected \(0, 9.8, 0\): y up"),
    "gravity in": (_npz(_REC, acc_world=lambda a: a + np.array([0, 9.81, 0])), "gravity must be removed"),
    "calibrated in g": (
        _npz(_REC, acc_world=lambda a: a / 9.81), "0.1 times what the reference motion gives: in g"
    ),
    "reference nan": (_npz(_REC, poses=lambda p: one(p, (7, 3), np.nan)), "frame 7: poses"),
    "calibration not JSON": (_npz(_REC, calibration="{"), "field 'calibration': is not JSON"),
    "deep JSON": (_npz(_REC, noise="[" * 100_000), "field 'noise': is not JSON"),
    "joint 99": (_npz(_REC, joint=np.full(5, 99)), "joint must hold 5 indices in 0..23"),
    "placement far off": (_npz(_REC, placement=np.full((5, 3), 50.0)), "within 2 m"),
    "huge count": (_member(_REC, "acc_world.npy", files.lying_npy((10**12,))), "declares 8000000000"),
    "negative count": (_member(_REC, "acc_world.npy", files.lying_npy((-1,))), "acc_world"),
    "overflowing count": (
        _member(_REC, "acc_world.npy", files.lying_npy((2**40, 2**40, 2**40))), "declares"
    ),
    "no header": (_member(_REC, "acc_world.npy", b"\x93NUMPY"), "damaged or cut short"),
    "pickle": (_pickled_npz(_REC, "calibration"), "holds pickled objects, which are never loaded"),
    "pickle for numbers": (_pickled_npz(_RAW, "acc"), "holds pickled objects, which are never loaded"),
    "raw cut": (lambda d: cut(_RAW(d), 0.5), "damaged or cut short"),
    "raw empty": (lambda d: cut(_RAW(d), 0.0), "damaged or cut short"),
    "raw left-handed": (
        _npz(_RAW, R_world_sensor=lambda R: R @ LEFT_HANDED),
        "frame 0, sensor pelvis: R_world_sensor is left-handed",
    ),
    "raw huge count": (_member(_RAW, "acc.npy", files.lying_npy((10**12,))), "declares 8000000000"),
    "not npy": (_member(_REC, "acc_world.npy", b"hello"), "damaged or cut short"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "name"), [(_REC, "R_world_bone"), (_RAW, "R_world_sensor")])
@pytest.mark.parametrize("spoiled", [1.3, -1.0, 1e30])
def test_a_spoiled_rotation_is_a_missing_sample(
    make: Callable[[Path], Path], name: str, spoiled: float, tmp_path: Path
) -> None:
    """Scaled, left-handed, huge: one of many is no reason to refuse the rest."""
    path = _npz(make, **{name: lambda R: one(R, (9, 2), spoiled * R[9, 2])})(tmp_path)
    doc = native.FORMAT.read(path, Options())
    assert isinstance(doc.content, RawRecording | Recording)
    assert not doc.content.valid[9, 2] and doc.content.no_rotation is not None
    assert doc.content.no_rotation.tolist() == [0, 0, 1, 0, 0]
    assert any(
        "1 samples hold no rotation" in told and "right_thigh 1" in told for told in doc.warnings
    )


def _bomb(folder: Path) -> Path:
    """A recording whose archive holds 20 MiB of packed zeros, too."""
    path = _REC(folder)
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as z,
        z.open("noise.npy", "w", force_zip64=True) as f,
    ):
        np.save(f, np.zeros(20 << 20, np.int8))
    return path


def test_zip_bomb(tmp_path: Path) -> None:
    path = _bomb(tmp_path)
    must_fail(path, native.FORMAT, "array 'noise': 160 MiB packed in")


def test_a_directory_that_overstates_what_is_packed(tmp_path: Path) -> None:
    """A zip's directory may say that a bomb takes more room than the whole file has."""
    path = _bomb(tmp_path)
    with zipfile.ZipFile(path) as z:
        packed = z.getinfo("noise.npy").compress_size
    data = path.read_bytes()
    at = data.rindex(packed.to_bytes(4, "little"))
    path.write_bytes(data[:at] + (1 << 30).to_bytes(4, "little") + data[at + 4 :])
    with pytest.raises(FormatError):
        native.FORMAT.read(path, Options())


def test_a_declared_shape_of_many_digits(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({'9' * 3000}, 3)}}\n".encode()
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(path, "w") as z:
        z.writestr("poses.npy", data)
    with pytest.raises(FormatError, match=r"declares over 10\^18 bytes \(shape \(\.\.\., 3\)\)"):
        archives.load(path, ("poses",))


def test_one_sensor_that_never_delivers_makes_no_bomb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Orientations alone: all accelerations are NaN and pack to nothing, beside rotations that do not."""
    monkeypatch.setattr(archives, "BOMB_BYTES", 1 << 18)  # as if seconds were an hour
    made = synthesis.recording(motions.walk(20.0))
    bare = replace(made, acc_world=np.full_like(made.acc_world, np.nan))
    native.write_recording(tmp_path / "r.npz", bare)
    with zipfile.ZipFile(tmp_path / "r.npz") as z:
        acc = z.getinfo("acc_world.npy")
    assert acc.file_size > 50 * acc.compress_size
    assert len(native.read_recording(tmp_path / "r.npz")) == len(made)


def test_nan_bursts_are_gaps(tmp_path: Path) -> None:
    """Not broken: samples that are not finite become invalid, with a count."""

    def burst(a: np.ndarray) -> np.ndarray:
        a = a.copy()
        a[50:60, 2] = np.nan
        a[100:103, 0] = np.inf
        return a

    document = native.FORMAT.read(_npz(_RAW, acc=burst)(tmp_path), Options())
    assert document.warnings == (
        "13 of 1200 samples are missing or not finite (pelvis 3, right_thigh 10), the longest gap 10 "
        "frames",
    )
    assert isinstance(document.content, RawRecording)
    assert np.flatnonzero(~document.content.valid[:, 2]).tolist() == list(range(50, 60))
    # A calibrated sample without an acceleration still has its orientation.
    document = native.FORMAT.read(
        _npz(_REC, acc_world=burst, R_world_bone=burst)(tmp_path), Options()
    )
    assert isinstance(document.content, Recording)
    assert (~document.content.valid[2:-2]).sum() == 13


# --------------------------------------------------------------------------------------------- qmt


def _mat(change: Callable[[dict[str, object]], object]) -> Break:
    def make(folder: Path) -> Path:
        data = files.qmt_data(files.raw(rate=100.0, T=400))
        change(data)
        savemat(folder / "body.mat", data, do_compression=True)
        return folder / "body.mat"

    return make


def _segment(field: str, change: Callable[[np.ndarray], np.ndarray], name: str = "hip") -> Break:
    def apply(data: dict[str, object]) -> None:
        segment = data[name]
        assert isinstance(segment, dict)
        segment[field] = change(segment[field])

    return _mat(apply)


def _mat_bomb(folder: Path) -> Path:
    """2 GiB of zeros in a compressed element."""
    pack = zlib.compressobj(9)
    body = pack.compress(struct.pack("<II", 14, 2 << 30))
    body += b"".join(pack.compress(bytes(1 << 24)) for _ in range(16)) + pack.flush()
    good = files.qmt(folder).read_bytes()
    (folder / "bomb.mat").write_bytes(good + struct.pack("<II", 15, len(body)) + body)
    return folder / "bomb.mat"


def _mat_lying(folder: Path) -> Path:
    """An uncompressed variable that declares 10^9 rows."""
    savemat(folder / "lie.mat", files.qmt_data(files.raw(rate=100.0, T=400)))
    data = bytearray((folder / "lie.mat").read_bytes())
    at = data.index(struct.pack("<ii", 400, 1))
    data[at : at + 4] = struct.pack("<i", 10**9)
    (folder / "lie.mat").write_bytes(bytes(data))
    return folder / "lie.mat"


QMT: Cases = {
    "cut": (lambda d: cut(files.qmt(d), 0.5), "damaged or cut short"),
    "header only": (lambda d: cut(files.qmt(d), 0.001), "damaged or cut short|no variable t"),
    "no time": (_mat(lambda m: m.__delitem__("t")), "no variable t"),
    "no segment": (_mat(lambda m: [m.pop(k) for k in list(m) if k != "t"]), "no segment"),
    "wrong shape": (_segment("acc", lambda a: a[:, :2]), r"segment hip: acc: is float64 \(400, 2\)"),
    "wrong length": (_segment("quat", lambda a: a[:-1]), r"segment hip: quat: is float64 \(399, 4\)"),
    "text for numbers": (_segment("gyr", lambda a: np.array(["a"])), "segment hip: gyr: is"),
    "non-unit": (
        _segment("quat", lambda q: 1.3 * q),
        "frame 0, sensor pelvis: quat: quaternion of norm 1.3, expected 1",
    ),
    "in g": (_segment("acc", lambda a: a / 9.81), "sensor pelvis: acc: 1 when still"),
    "in degrees": (_segment("gyr", lambda a: a * DEG), "sensor pelvis: gyr: 57 times"),
    "time stands": (_mat(lambda m: m.update(t=np.zeros((400, 1)))), "variable t: 0 s after 0 s"),
    "time jumps": (
        _mat(lambda m: m.update(t=np.r_[0:200, 300:500][:, None] / 100)), "variable t: has gaps"
    ),
    "empty": (lambda d: cut(files.qmt(d), 0.0), "damaged or cut short"),
    "huge count": (_mat_lying, "declares more than|damaged"),
    "bomb": (_mat_bomb, "inflates to more than"),
}  # fmt: skip


# ---------------------------------------------------------------------------------------- the test


@pytest.mark.parametrize(
    ("reader", "make", "message"),
    parameters((native.FORMAT, NATIVE), (qmt.FORMAT, QMT)),
)
def test_broken(reader: Format, make: Break, message: str, tmp_path: Path) -> None:
    must_fail(make(tmp_path), reader, message)
    assert not (tmp_path / "executed").exists()


def test_good_files_pass(tmp_path: Path) -> None:
    """The files that the cases break are themselves read without an error."""
    for module, write in ((native, _REC), (native, _RAW), (qmt, files.qmt)):
        must_read(write(tmp_path), module.FORMAT)


def _greedy(megabytes: int) -> Format:
    """A reader that allocates so much for a moment, and then refuses the file."""

    def read(path: Path, _: Options) -> Document:
        np.empty(megabytes << 17)
        raise FormatError(path, "refused")

    return Format("greedy", (".x",), lambda path, head: True, read)


def test_must_fail_sees_what_a_reader_allocates(tmp_path: Path) -> None:
    """The measure fails for a reader that is too large, whatever was allocated before it."""
    must_fail(tmp_path / "a.x", _greedy(MEGABYTES // 10), "refused")
    with pytest.raises(AssertionError, match=f"{MEGABYTES + 100} MiB"):
        must_fail(tmp_path / "a.x", _greedy(MEGABYTES + 100), "refused")
