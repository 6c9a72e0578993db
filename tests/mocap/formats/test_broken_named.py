"""Broken XML and tables with names in them: MVNX, CSV (see `broken`)."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap.formats import Format, csv, mvnx
from tests.mocap.formats import recording_files as files
from tests.mocap.formats.broken import (
    BOMB,
    Break,
    Cases,
    changed,
    cut,
    must_fail,
    must_read,
    parameters,
    replaced,
)

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


def _mvnx_values(tag: str, change: Callable[[np.ndarray], np.ndarray]) -> Break:
    """The numbers of every element of one tag changed."""

    def write(found: re.Match[str]) -> str:
        values = change(np.array(found[1].split(), float))
        return f"<{tag}>" + " ".join(f"{v:.7g}" for v in values) + f"</{tag}>"

    def make(folder: Path) -> Path:
        path = files.mvnx(folder)
        text, count = re.subn(f"<{tag}>([^<]*)</{tag}>", write, path.read_text())
        assert count > 1
        path.write_text(text)
        return path

    return make


_FREE, _ALL_UP = "sensorFreeAcceleration", np.tile([0, 0, 9.81], len(files.MVN_SENSORS))

MVNX: Cases = {
    "empty": (lambda d: cut(files.mvnx(d), 0.0), "line 1: broken XML"),
    "in g": (_mvnx_values(_FREE, lambda a: a / 9.81), "0.1 times what the reference .* in g"),
    "gravity in": (_mvnx_values(_FREE, lambda a: a + _ALL_UP), "gravity must be removed"),
    "centimetres": (
        _mvnx_values("position", lambda p: 100 * p),
        r"position: the farthest segment lies \d+ from the pelvis, expected metres",
    ),
    "pelvis lost": (
        _mvnx_frame(_sub("<position>[^ ]+", "<position>nan")),
        "frame 100, sensor Pelvis: position: not finite",
    ),
    "sensor non-unit": (
        _mvnx_values("sensorOrientation", lambda q: 1.3 * q),
        "frame 0, sensor Pelvis: sensorOrientation: quaternion of norm 1.3",
    ),
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
    "empty": (lambda d: cut(files.csv_wide(d), 0.0), "no row of data"),
    "in g": (
        lambda d: _scaled(files.csv_wide(d), "acc", 1 / 9.81), "sensor pelvis: acc: 1 when still"
    ),
    "in degrees": (
        lambda d: _scaled(files.csv_wide(d), "gyr", 180 / np.pi), "sensor pelvis: gyr: 57 times"
    ),
    "endless line": (_csv_row(lambda c: [*c, " " * (1 << 21)]), "line 53: longer than"),
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


def _scaled(path: Path, quantity: str, factor: float) -> Path:
    lines = path.read_text().splitlines()
    columns = [i for i, name in enumerate(lines[1].split(",")) if f".{quantity}_" in name]
    for row in range(2, len(lines)):
        cells = lines[row].split(",")
        for i in columns:
            cells[i] = f"{factor * float(cells[i]):.9g}"
        lines[row] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    return path


def _in_milliseconds(path: Path) -> Path:
    lines = path.read_text().splitlines()
    for i in range(2, len(lines)):
        t, _, rest = lines[i].partition(",")
        lines[i] = f"{1000 * float(t):.6g},{rest}"
    path.write_text("\n".join(lines) + "\n")
    return path


def _folder(change: Callable[[Path], object]) -> Break:
    return changed(files.csv_folder, change)


CSV_FOLDER: Cases = {
    "one in g": (
        _folder(lambda d: replaced(d / "pelvis.csv", "acc: m/s^2", "acc: g")), "declares acc 'g', another"
    ),
    "one without a column": (
        _folder(lambda d: replaced(d / "pelvis.csv", "acc_y", "acc_q")), "sensor pelvis: no column acc_y"
    ),
    "one non-unit": (
        _folder(lambda d: replaced(d / "pelvis.csv", "-0.9660457", "-2")),
        "frame 0, sensor pelvis: quat: quaternion of norm 2.0",
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


# ---------------------------------------------------------------------------------------- the test


@pytest.mark.parametrize(
    ("reader", "make", "message"),
    parameters((mvnx.FORMAT, MVNX), (csv.FORMAT, CSV), (csv.FORMAT, CSV_FOLDER)),
)
def test_broken(reader: Format, make: Break, message: str, tmp_path: Path) -> None:
    must_fail(make(tmp_path), reader, message)


def test_good_files_pass(tmp_path: Path) -> None:
    """The files that the cases break are themselves read without an error."""
    for module, write in ((mvnx, files.mvnx), (csv, files.csv_wide), (csv, files.csv_folder)):
        must_read(write(tmp_path), module.FORMAT)
