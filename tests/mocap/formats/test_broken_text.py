"""Broken text files: OpenSense, Xsens MTw, TotalCapture's `.sensors` (see `broken`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap.formats import Format, opensense, totalcapture, xsens_mtw
from tests.mocap.formats import recording_files as files
from tests.mocap.formats.broken import (
    BOMB,
    DEG,
    LEFT_HANDED,
    Break,
    Cases,
    changed,
    cut,
    must_fail,
    must_read,
    parameters,
    replaced,
)

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


def _sto_slower(folder: Path) -> Path:
    """From frame 120 on the rows come 1.4 times more slowly."""
    path = files.sto(folder)
    lines = path.read_text().splitlines()
    for t in range(120, files.FRAMES):
        _, tab, rest = lines[5 + t].partition("\t")
        lines[5 + t] = f"{(120 + 1.4 * (t - 120)) / files.RATE:.6f}{tab}{rest}"
    path.write_text("\n".join(lines) + "\n")
    return path


STO: Cases = {
    "empty": (lambda d: cut(files.sto(d), 0.0), "no line 'endheader'"),
    "a far row": (_sto_last(lambda s: "1e9" + s[s.index("\t") :]), "frame 239, time: a gap of 1e.09 s"),
    "rate changes": (_sto_slower, "frame 1.., time: a step of .* expected a constant rate"),
    "time lost": (_sto_last(lambda s: "nan" + s[s.index("\t") :]), "frame 239, time: is nan"),
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
    return changed(files.mtw, lambda out: change(out / _DEVICE))


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
    "cut in a row": (_mtw(lambda p: cut(p, 0.5)), "line 1.*values, expected 15|not a rotation|ortho"),
    "empty": (_mtw(lambda p: cut(p, 0)), "the file is empty"),
    "no rate": (_mtw(lambda p: [replaced(q, "Update", "Some") for q in p.parent.glob("MT*")]), "--rate HZ"),
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
    "not orthonormal": (
        _mtw_raw(lambda a, R: (a, 1.3 * R)), "frame 0, sensor left_thigh: Mat: not orthonormal"
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


# ------------------------------------------------------------------------------------ TotalCapture


def _tc_raw(change: Callable[[Path], object]) -> Break:
    return changed(files.totalcapture, change)


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


def _tc_scaled(first: int, last: int, factor: float, calibrated: bool = True) -> Break:
    """Cells `first` to `last` (0: the name) of every sensor's line multiplied."""

    def make(folder: Path) -> Path:
        path = files.totalcapture(folder, calibrated)
        lines = path.read_text().splitlines()
        for i, line in enumerate(lines[1:], 1):
            cells = line.split("\t")
            if len(cells) > 1:
                scaled = (f"{factor * float(c):.8g}" for c in cells[first : last + 1])
                lines[i] = "\t".join([*cells[:first], *scaled, *cells[last + 1 :]])
        path.write_text("\n".join(lines) + "\n")
        return path

    return make


TOTALCAPTURE: Cases = {
    "empty": (_tc_raw(lambda p: cut(p, 0)), "line 1: '', expected the numbers of sensors"),
    "in g": (_tc_scaled(5, 7, 1 / 9.81), "sensor head: acc: 1 when still, expected 9.81"),
    "raw in g": (_tc_scaled(5, 7, 1 / 9.81, False), "sensor head: acc: 1 when still, expected 9.81"),
    "in degrees": (_tc_scaled(8, 10, DEG), "sensor head: gyr: 57 times what the orientation turns"),
    "raw in degrees": (_tc_scaled(8, 10, DEG, False), "sensor head: gyr: 57 times"),
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
        (totalcapture, files.totalcapture),
    ):
        must_read(write(tmp_path), module.FORMAT)
