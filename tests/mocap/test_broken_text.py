"""Broken text files: OpenSense, Xsens MTw, MVNX, CSV, TotalCapture's `.sensors` (see `broken`)."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import recording_files as files
from broken import BOMB, LEFT_HANDED, Break, Cases, cut, must_fail, parameters, replaced

from mocap.formats import Document, Format, Options, csv, mvnx, opensense, totalcapture, xsens_mtw

# ---------------------------------------------------------------------------- OpenSense, Xsens MTw


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


STO: Cases = {
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
        out, rec = files.mtw(folder), files.raw()
        assert rec.R_world_sensor is not None
        acc, R = rec.acc.copy(), rec.R_world_sensor.copy()
        acc[:, 1], R[:, 1] = change(acc[:, 1], R[:, 1])
        fake = replace(rec, acc=acc)
        object.__setattr__(fake, "R_world_sensor", R)
        (out / _DEVICE).write_text(files.mtw_text(fake, 1))
        return out

    return make


MTW: Cases = {
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


# -------------------------------------------------------------------------------------------- mvnx


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


MVNX: Cases = {
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


# --------------------------------------------------------------------------------------------- csv


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


CSV: Cases = {
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


CSV_FOLDER: Cases = {
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


# ------------------------------------------------------------------------------------ TotalCapture


def _tc_raw(change: Callable[[Path], object]) -> Break:
    def make(folder: Path) -> Path:
        path = files.totalcapture(folder)
        change(path)
        return path

    return make


def _cell(line: int, column: int, new: str) -> Break:
    """One cell of one line (both from 0) written anew."""

    def change(path: Path) -> None:
        lines = path.read_text().splitlines()
        cells = lines[line].split("\t")
        cells[column] = new
        lines[line] = "\t".join(cells)
        path.write_text("\n".join(lines) + "\n")

    return _tc_raw(change)


_BONE, _REF = "s1_acting1_calib_imu_bone.txt", "s1_acting1_calib_imu_ref.txt"

TOTALCAPTURE: Cases = {
    "cut": (_tc_raw(lambda p: cut(p, 0.4999)), "line .* values|holds .* cut short"),
    "cut between frames": (
        _tc_raw(lambda p: p.write_text("\n".join(p.read_text().splitlines()[:15]) + "\n")),
        "declares 240 frames of 13 sensors, holds 1: cut short",
    ),
    "huge count": (_cell(0, 1, "999999999999"), "declares 999999999999 frames of 13 sensors, holds 240"),
    "no count": (_cell(0, 0, "thirteen"), "line 1: 'thirteen.*expected the numbers of sensors"),
    "many sensors": (_cell(0, 0, "9000"), "declares 9000 sensors"),
    "frame skipped": (_cell(15, 0, "7"), "line 16: frame 7, expected 2"),
    "names change": (_cell(16, 0, "Tail"), "line 17: sensor 'Tail', expected 'Head'"),
    "unknown name": (
        _tc_raw(lambda p: replaced(p, "Head", "Tail", 999)), "sensor 'Tail', expected one of Head"
    ),
    "not a number": (_cell(30, 1, "abc"), "line 31, column value 1: 'abc' is not a number"),
    "non-unit": (_cell(30, 1, "9"), "frame 2, sensor Head: orientation: quaternion of norm"),
    "calibration cut": (_tc_raw(lambda p: cut(p.with_name(_BONE), 0.5)), f"{_BONE}: line|no line for"),
    "calibration zero": (
        _tc_raw(lambda p: p.with_name(_REF).write_text(
            "13\n" + "".join(f"{n} 0 0 0 0\n" for n in files.TC_SENSORS))),
        f"{_REF}: a quaternion is zero",
    ),
    "calibrations exchanged": (
        _tc_raw(lambda p: p.with_name(_REF).write_bytes(p.with_name(_BONE).read_bytes())),
        "expected .0, 9.8, 0.: y up",
    ),
    "other bones": (
        _tc_raw(lambda p: p.with_name(_BONE).write_bytes(p.with_name(_REF).read_bytes())),
        "the calibration files do not mean what is assumed",
    ),
    "positions cut": (_tc_raw(lambda p: cut(p.with_name("gt_skel_gbl_pos.txt"), 0.5)), "line .* values"),
}  # fmt: skip


# ---------------------------------------------------------------------------------------- the test


@pytest.mark.parametrize(
    ("reader", "make", "message"),
    parameters(
        (opensense.FORMAT, STO),
        (xsens_mtw.FORMAT, MTW),
        (mvnx.FORMAT, MVNX),
        (csv.FORMAT, CSV),
        (csv.FORMAT, CSV_FOLDER),
        (totalcapture.FORMAT, TOTALCAPTURE),
    ),
)
def test_broken(reader: Format, make: Break, message: str, tmp_path: Path) -> None:
    must_fail(make(tmp_path), reader, message)
    assert not (tmp_path / "executed").exists()


def test_good_files_pass(tmp_path: Path) -> None:
    """The files that the cases break are themselves read without an error."""
    for module, write in (
        (opensense, files.sto),
        (xsens_mtw, files.mtw),
        (mvnx, files.mvnx),
        (csv, files.csv_wide),
        (csv, files.csv_folder),
        (totalcapture, files.totalcapture),
    ):
        path = write(tmp_path)
        head = path.read_bytes()[:4096] if path.is_file() else b""
        assert module.FORMAT.sniff(path, head)
        assert isinstance(module.FORMAT.read(path, Options()), Document)
