"""Files that are not what they claim to be: one sentence naming the file and the place, nothing else.

Each case breaks a small good file in one way. A reader must answer with a PoserError within seconds,
without using much memory, whatever the file declares.
"""

from __future__ import annotations

import re
import resource
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import recording_files as files
from scipy.io import savemat

from mocap import orientation as ori
from mocap.errors import FormatError, PoserError
from mocap.formats import Document, Options, csv, mvnx, native, opensense, qmt, xsens_mtw
from mocap.recording import RawRecording, Recording

Break = Callable[[Path], Path]
READERS = {
    m.FORMAT.name: m.FORMAT for m in (csv, mvnx, native, opensense, qmt, xsens_mtw)
}  # fmt: skip
SECONDS, MEGABYTES = 10.0, 400
LEFT_HANDED = np.diag([1.0, 1, -1])
DEG = 180 / np.pi
BOMB = '<!DOCTYPE mvnx [<!ENTITY a "0"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>'


def must_fail(path: Path, name: str, message: str = "") -> None:
    """Reading fails with one sentence about this file that matches `message`, fast and small."""
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    with pytest.raises(PoserError) as caught:
        READERS[name].read(path, Options())
    text = str(caught.value)
    assert "\n" not in text and len(text) - len(str(path)) < 400, text
    if isinstance(caught.value, FormatError):
        # A folder's error may name one of its files.
        assert str(path) in text, text
    assert re.search(message, text), text
    assert time.monotonic() - start < SECONDS
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < MEGABYTES * 1024, f"{grown // 1024} MiB"


def cut(path: Path, keep: float) -> Path:
    """The file with only the first part of its bytes."""
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    return path


def replaced(path: Path, old: str, new: str, count: int = 1) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))
    return path


# ------------------------------------------------------------------------------------------- native


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


def _one(array: np.ndarray, at: tuple[int, ...], value: object) -> np.ndarray:
    array = array.copy()
    array[at] = value
    return array


def _turned_up(R: np.ndarray) -> np.ndarray:
    return (ori.R_ZUP_YUP @ R).astype(np.float32)


NATIVE: dict[str, tuple[Break, str]] = {
    "cut": (lambda d: cut(_REC(d), 0.5), "damaged or cut short"),
    "empty": (lambda d: cut(_REC(d), 0.0), "damaged or cut short"),
    "other schema": (_npz(_REC, schema="poser-recording/9"), "schema is 'poser-recording/9'"),
    "no schema": (_npz(_REC, schema=None), "field 'schema' is missing"),
    "no rate": (_npz(_REC, rate_hz=None), "field 'rate_hz' is missing"),
    "rate zero": (_npz(_REC, rate_hz=0.0), "rate_hz must lie between 1 and 10000"),
    "rate nan": (_npz(_RAW, rate_hz=np.nan), "field 'rate_hz': is nan"),
    "sensor twice": (_npz(_REC, sensors=np.array(["pelvis"] * 5)), "not unique"),
    "unknown place": (
        _npz(_REC, sensors=lambda s: _one(s, (0,), "tail"), joint=None),
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
    "not orthonormal": (
        _npz(_RAW, R_world_sensor=lambda R: _one(R, (9, 2), 1.3 * R[9, 2])),
        "frame 9, sensor right_thigh: R_world_sensor is not a rotation",
    ),
    "acc in g": (_npz(_RAW, acc=lambda a: a / 9.81), "so the unit is g"),
    "gyr in degrees": (_npz(_RAW, gyr=lambda a: a * DEG), "57 times what the orientation turns"),
    "z up": (_npz(_RAW, R_world_sensor=_turned_up), r"expected \(0, 9.8, 0\): y up"),
    "gravity in": (_npz(_REC, acc_world=lambda a: a + np.array([0, 9.81, 0])), "gravity must be removed"),
    "calibrated in g": (
        _npz(_REC, acc_world=lambda a: a / 9.81), "0.1 times what the reference motion gives: in g"
    ),
    "reference nan": (_npz(_REC, poses=lambda p: _one(p, (7, 3), np.nan)), "frame 7: poses"),
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
    "not npy": (_member(_REC, "acc_world.npy", b"hello"), "damaged or cut short"),
}  # fmt: skip


def _pickled_npz(folder: Path) -> Path:
    path = _REC(folder)
    with np.load(path) as f:
        arrays = dict(f)
    arrays["calibration"] = files.objects([files.Evil(folder / "executed")])
    np.savez(path, **arrays)
    return path


def test_a_pickle_inside_npz(tmp_path: Path) -> None:
    must_fail(_pickled_npz(tmp_path), "native", "holds pickled objects, which are never loaded")
    assert not (tmp_path / "executed").exists()


def test_zip_bomb(tmp_path: Path) -> None:
    path = _REC(tmp_path)
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as z,
        z.open("noise.npy", "w", force_zip64=True) as f,
    ):
        for _ in range(600):
            f.write(bytes(1 << 20))
    must_fail(path, "native", "array 'noise': 600 MiB packed in")


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


# ---------------------------------------------------------------------------------------------- qmt


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


QMT: dict[str, tuple[Break, str]] = {
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
    "huge count": (_mat_lying, "declares more than|damaged"),
    "bomb": (_mat_bomb, "inflates to more than"),
}  # fmt: skip


# ------------------------------------------------------------------------------------------ OpenSim


def _sto(old: str, new: str) -> Break:
    return lambda d: replaced(files.sto(d), old, new)


def _sto_last(change: Callable[[str], str]) -> Break:
    def make(folder: Path) -> Path:
        path = files.sto(folder)
        lines = path.read_text().splitlines()
        lines[-1] = change(lines[-1])
        path.write_text("\n".join(lines) + "\n")
        return path

    return make


STO: dict[str, tuple[Break, str]] = {
    "cut": (lambda d: cut(files.sto(d), 0.5003), "line 1.., column .*numbers|columns, expected"),
    "no end of header": (_sto("endheader", "begin"), "no line 'endheader'"),
    "no rows": (lambda d: cut(files.sto(d), 0.0015), "endheader|no row|time"),
    "vectors": (_sto("=Quaternion", "=Vec3"), "DataType is 'Vec3', expected 'Quaternion'"),
    "three numbers": (_sto_last(lambda s: s.rpartition(",")[0]), "line 245, column tibia_r_imu: 3 numbers"),
    "not a number": (_sto_last(lambda s: s[:-3] + "abc"), "line 245, column .*abc' is not a number"),
    "a column less": (_sto_last(lambda s: s.rpartition("\t")[0]), "line 245: 5 columns, expected 6"),
    "time falls": (_sto_last(lambda s: "1" + s[s.index("\t") :]), "frame 239, time: 1 s after"),
    "non-unit": (
        _sto_last(lambda s: s.rpartition("\t")[0] + "\t1,1,0,0"),
        "frame 239, sensor right_shank: quaternion: quaternion of norm 1.41",
    ),
    "zero bytes": (_sto_last(lambda s: s + "\0"), "holds zero bytes"),
    "endless line": (_sto_last(lambda s: s + " " * (1 << 21)), "line 245: longer than"),
}  # fmt: skip

_DEVICE = "MT_trial_00B40001.txt"


def _mtw(change: Callable[[Path], object]) -> Break:
    def make(folder: Path) -> Path:
        out = files.mtw(folder)
        change(out / _DEVICE)
        return out

    return make


def _mtw_raw(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Break:
    """One device's file written again with acc (T,3) and R (T,3,3) changed."""

    def make(folder: Path) -> Path:
        from dataclasses import replace

        out, rec = files.mtw(folder), files.raw()
        assert rec.R_world_sensor is not None
        acc, R = rec.acc.copy(), rec.R_world_sensor.copy()
        acc[:, 1], R[:, 1] = change(acc[:, 1], R[:, 1])
        fake = replace(rec, acc=acc)
        object.__setattr__(fake, "R_world_sensor", R)
        (out / _DEVICE).write_text(files.mtw_text(fake, 1))
        return out

    return make


MTW: dict[str, tuple[Break, str]] = {
    "cut in a row": (_mtw(lambda p: cut(p, 0.5)), "line 1.*columns, expected 15|not a rotation|ortho"),
    "empty": (_mtw(lambda p: cut(p, 0)), "no row of data"),
    "no rate": (_mtw(lambda p: [replaced(q, "Update", "Some") for q in p.parent.glob("MT*")]), "say rate"),
    "two rates": (_mtw(lambda p: replaced(p, "60.0Hz", "100.0Hz")), r"files run at \[60.0, 100.0\] Hz"),
    "no acc": (_mtw(lambda p: replaced(p, "Acc_X", "Acc_Q")), "no column Acc_X"),
    "no orientation": (_mtw(lambda p: replaced(p, "Mat[1][1]", "M")), "no column Mat"),
    "not a number": (_mtw(lambda p: replaced(p, "65500", "ABC")), "line 4, column PacketCounter: 'ABC'"),
    "packets fall": (_mtw(lambda p: replaced(p, "65510\t", "65500\t")), "row 11, PacketCounter: 65500 after"),
    "huge count": (_mtw(lambda p: replaced(p, "65500\t", "900000000\t")), "PacketCounter"),
    "left-handed": (
        _mtw_raw(lambda a, R: (a, R @ LEFT_HANDED)),
        "frame 0, sensor left_thigh: Mat: left-handed",
    ),
    "transposed": (_mtw_raw(lambda a, R: (a, np.swapaxes(R, -1, -2))), "orientation: turns the mean"),
    "in g": (_mtw_raw(lambda a, R: (a / 9.81, R)), "sensor left_thigh: acc: 1 when still"),
    "two trials": (_mtw(lambda p: p.rename(p.with_name("MT_trial_b_1.txt"))), "2 trials"),
    "hostile mapping": (
        lambda d: replaced(files.mtw(d) / "mapping.xml", "<OpenSim", BOMB + "<OpenSim").parent,
        "mapping.xml: line 2: declares a document type",
    ),
    "broken mapping": (
        lambda d: cut(files.mtw(d) / "mapping.xml", 0.9).parent, "mapping.xml: line .*broken XML"
    ),
}  # fmt: skip


# --------------------------------------------------------------------------------------------- mvnx


def _mvnx(old: str, new: str, count: int = 1) -> Break:
    return lambda d: replaced(files.mvnx(d), old, new, count)


def _mvnx_frame(change: Callable[[str], str], frame: int = 100) -> Break:
    def make(folder: Path) -> Path:
        path = files.mvnx(folder)
        lines = path.read_text().split("\n")
        at = next(i for i, x in enumerate(lines) if 'type="normal"' in x) + frame
        lines[at] = change(lines[at])
        path.write_text("\n".join(lines))
        return path

    return make


def _sub(pattern: str, new: str) -> Callable[[str], str]:
    return lambda text: re.sub(pattern, new, text, count=1)


MVNX: dict[str, tuple[Break, str]] = {
    "cut": (lambda d: cut(files.mvnx(d), 0.5), r"line \d+: broken XML"),
    "no frames": (_mvnx('type="normal"', 'type="tpose"', 999), "no frame of type normal"),
    "entities": (_mvnx("<mvnx", BOMB + "<mvnx"), "line 2: declares a document type or entities"),
    "external": (
        _mvnx("<mvnx", '<!DOCTYPE a SYSTEM "file:///etc/passwd"><mvnx'), "declares a document type"
    ),
    "count": (
        _mvnx_frame(_sub("<position>[^ ]+ ", "<position>")),
        r"line \d+, frame 100: position: 68 numbers, expected 69",
    ),
    "not a number": (_mvnx_frame(_sub("<position>[^ ]+", "<position>x")), "frame 100: position: 'x'"),
    "nan": (
        _mvnx_frame(_sub("<orientation>[^ ]+", "<orientation>nan")),
        "frame 100, sensor Pelvis: orientation: not finite",
    ),
    "non-unit": (
        _mvnx_frame(_sub("<orientation>[^ ]+", "<orientation>3")),
        "frame 100, sensor Pelvis: orientation: quaternion of norm",
    ),
    "missing tag": (
        _mvnx_frame(_sub("<sensorOrientation>.*</sensorOrientation>", "")),
        "frame 100: no <sensorOrientation>",
    ),
    "time falls": (_mvnx_frame(_sub('time="[0-9]+"', 'time="5"')), "frame 100, time: 0.005 s after"),
    "wrong rate": (_mvnx('frameRate="60"', 'frameRate="240"'), "times run at 60 Hz, frameRate is 240"),
    "many names": (_mvnx("<sensors>", "<sensors>" + "<sensor/>" * 500), "more than 200 of <sensor>"),
    "not XML": (lambda d: replaced(files.mvnx(d), "<?xml", "xml"), "line 1: broken XML"),
    "endless text": (_mvnx_frame(_sub("<position>", "<position>" + "1 " * 3_000_000)), "characters in one"),
}  # fmt: skip


# ---------------------------------------------------------------------------------------------- csv


def _csv(old: str, new: str) -> Break:
    return lambda d: replaced(files.csv_wide(d), old, new)


def _csv_row(change: Callable[[list[str]], list[str]], row: int = 50) -> Break:
    def make(folder: Path) -> Path:
        path = files.csv_wide(folder)
        lines = path.read_text().splitlines()
        lines[2 + row] = ",".join(change(lines[2 + row].split(",")))
        path.write_text("\n".join(lines) + "\n")
        return path

    return make


CSV: dict[str, tuple[Break, str]] = {
    "cut": (lambda d: cut(files.csv_wide(d), 0.5), r"line \d+: \d+ values, expected 51"),
    "header alone": (lambda d: cut(files.csv_wide(d), 0.002), "no row|no column|no sensor|such as"),
    "no acc_y": (_csv("pelvis.acc_y", "pelvis.acc_q"), "sensor pelvis: no column acc_y"),
    "column twice": (_csv("pelvis.acc_y", "pelvis.acc_x"), "'pelvis.acc_x' occurs twice"),
    "no sensor at all": (_csv(".", "_"), "no column acc_x|no row|no column such as"),
    "not a number": (_csv_row(lambda c: [c[0], "abc", *c[2:]]), "line 53, column pelvis.acc_x: 'abc'"),
    "short row": (_csv_row(lambda c: c[:-1]), "line 53: 50 values, expected 51"),
    "time falls": (_csv_row(lambda c: ["0", *c[1:]]), "frame 50, column t: 0 s after"),
    "time missing": (_csv_row(lambda c: ["", *c[1:]]), "frame 50, column t: is nan"),
    "huge gap": (_csv_row(lambda c: ["1e9", *c[1:]], 239), "a gap of 1e.09 s"),
    "non-unit": (_csv_row(lambda c: [*c[:-4], "1", "1", "0", "0"]), "frame 50, sensor right_shank: quat"),
    "unknown unit": (_csv("m/s^2", "stone"), "unit 'stone', expected one of"),
    "rate contradicts": (_csv("# acc", "# rate_hz: 100, acc"), "runs at 60 Hz, 100 Hz was said"),
    "rate is no number": (_csv("# acc", "# rate_hz: fast, acc"), "'fast' is not a number|60 Hz"),
    "milliseconds": (
        lambda d: _in_milliseconds(files.csv_wide(d)), "steps of 16.7, expected seconds"
    ),
}  # fmt: skip


def _in_milliseconds(path: Path) -> Path:
    lines = path.read_text().splitlines()
    for i in range(2, len(lines)):
        t, _, rest = lines[i].partition(",")
        lines[i] = f"{1000 * float(t):.6g},{rest}"
    path.write_text("\n".join(lines) + "\n")
    return path


def _folder(change: Callable[[Path], object]) -> Break:
    def make(folder: Path) -> Path:
        out = files.csv_folder(folder)
        change(out)
        return out

    return make


CSV_FOLDER: dict[str, tuple[Break, str]] = {
    "one in g": (
        _folder(lambda d: replaced(d / "pelvis.csv", "acc: m/s^2", "acc: g")), "declares acc 'g', another"
    ),
    "one cut": (_folder(lambda d: cut(d / "pelvis.csv", 0.5)), "pelvis.csv: line"),
    "nothing in it": (_folder(lambda d: [p.unlink() for p in d.iterdir()]), "0 CSV files, expected"),
    "another day": (
        _folder(lambda d: _later(d / "pelvis.csv", 1e5)), "the files' times hardly overlap"
    ),
    "another rate": (_folder(lambda d: _in_milliseconds(d / "pelvis.csv")), "expected seconds|other files"),
}  # fmt: skip


def _later(path: Path, seconds: float) -> None:
    lines = path.read_text().splitlines()
    for i in range(2, len(lines)):
        t, _, rest = lines[i].partition(",")
        lines[i] = f"{seconds + float(t):.9g},{rest}"
    path.write_text("\n".join(lines) + "\n")


# ------------------------------------------------------------------------------------------ the test

_ALL = (
    ("native", NATIVE), ("qmt", QMT), ("opensense", STO), ("xsens_mtw", MTW), ("mvnx", MVNX),
    ("csv", CSV), ("csv", CSV_FOLDER),
)  # fmt: skip
CASES = [
    pytest.param(name, make, message, id=f"{name}: {case}")
    for name, cases in _ALL
    for case, (make, message) in cases.items()
]


@pytest.mark.parametrize(("name", "make", "message"), CASES)
def test_broken(name: str, make: Break, message: str, tmp_path: Path) -> None:
    must_fail(make(tmp_path), name, message)


def test_good_files_pass(tmp_path: Path) -> None:
    """The files that the cases break are themselves read without an error."""
    for name, write in (
        ("native", _REC), ("native", _RAW), ("qmt", files.qmt), ("opensense", files.sto),
        ("xsens_mtw", files.mtw), ("mvnx", files.mvnx), ("csv", files.csv_wide),
        ("csv", files.csv_folder),
    ):  # fmt: skip
        path = write(tmp_path)
        head = path.read_bytes()[:4096] if path.is_file() else b""
        assert READERS[name].sniff(path, head)
        assert isinstance(READERS[name].read(path, Options()), Document)
