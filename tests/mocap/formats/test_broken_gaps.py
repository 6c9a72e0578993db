"""Bursts of NaN in sensor data: not a broken file but a gap, counted by sensor, in every format."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap.formats import (
    Document,
    Format,
    Options,
    csv,
    dip,
    mvnx,
    native,
    opensense,
    phones,
    qmt,
    totalcapture,
    xsens_mtw,
)
from mocap.recording import RawRecording, Recording
from tests.mocap.formats import recording_files as files

BURST = slice(100, 110)
Burst = Callable[[Path], None]


def _arrays(*names: str) -> Burst:
    """Sensor 2 of these arrays of an npz archive."""

    def apply(path: Path) -> None:
        with np.load(path) as f:
            arrays = dict(f)
        for name in names:
            arrays[name][BURST, 2] = np.nan
        np.savez(path, **arrays)

    return apply


def _release(path: Path) -> None:
    data = files.dip_npz_data()
    data["orientation"][0][BURST, 18:27] = np.nan
    data["acceleration"][0][BURST, 6:9] = np.nan
    np.savez(path, **{k: files.objects(v) for k, v in data.items()})  # type: ignore[arg-type]


def _pickle(
    data: Callable[[], dict[str, np.ndarray]],
    write: Callable[[Path, object], Path],
    *names: str,
) -> Burst:
    def apply(path: Path) -> None:
        fields = data()
        for name in names:
            fields[name][BURST, 2] = np.nan
        write(path.parent, fields)

    return apply


def _qmt(path: Path) -> None:
    data = files.qmt_data(files.raw(rate=100.0, T=400))
    for array in data["upper_leg_right"].values():  # type: ignore[attr-defined]
        array[BURST] = np.nan
    files.qmt(path.parent, data)


def _cells(
    separator: str, head: int, first: int, count: int, new: str = "nan", name: str = ""
) -> Burst:
    """Cells of a text table: `head` lines before the rows, `count` columns from `first` on."""

    def apply(path: Path) -> None:
        path = path / name if name else path
        lines = path.read_text().splitlines()
        for i in range(head + BURST.start, head + BURST.stop):
            cells = lines[i].split(separator)
            cells[first : first + count] = [new] * count
            lines[i] = separator.join(cells)
        path.write_text("\n".join(lines) + "\n")

    return apply


def _totalcapture(first: int, last: int) -> Burst:
    """Cells `first` to `last` (0: the name) of the pelvis, third in each frame."""

    def apply(path: Path) -> None:
        lines = path.read_text().splitlines()
        for t in range(BURST.start, BURST.stop):
            at = 1 + t * (1 + len(files.TC_SENSORS)) + 3
            cells = lines[at].split("\t")
            assert cells[0] == "Pelvis"
            cells[first : last + 1] = ["nan"] * (last + 1 - first)
            lines[at] = "\t".join(cells)
        path.write_text("\n".join(lines) + "\n")

    return apply


def _mvnx(*tags: str) -> Burst:
    """The third sensor, the head, of these elements."""

    def apply(path: Path) -> None:
        text = path.read_text()
        for tag, width in (("sensorOrientation", 4), ("sensorFreeAcceleration", 3)):
            if tag in tags:
                text = _in_elements(text, tag, width)
        path.write_text(text)

    return apply


def _in_elements(text: str, tag: str, width: int) -> str:
    count = iter(range(files.FRAMES))

    def write(found: re.Match[str]) -> str:
        values = found[1].split()
        if BURST.start <= next(count) < BURST.stop:
            values[2 * width : 3 * width] = ["NaN"] * width
        return f"<{tag}>{' '.join(values)}</{tag}>"

    return re.sub(f"<{tag}>([^<]*)</{tag}>", write, text)


def _uncalibrated(folder: Path) -> Path:
    return files.totalcapture(folder, calibrated=False)


BURSTS: dict[str, tuple[Format, Callable[[Path], Path], Burst]] = {
    "native recording": (native.FORMAT, files.native_recording, _arrays("R_world_bone", "acc_world")),
    "native raw": (native.FORMAT, files.native_raw, _arrays("gyr", "acc", "R_world_sensor")),
    "DIP-IMU": (dip.FORMAT, files.dip, _pickle(files.dip_data, files.dip, "imu_ori", "imu_acc")),
    "DIP-IMU npz": (dip.FORMAT, files.dip_npz, _release),
    "TotalCapture": (totalcapture.FORMAT, files.totalcapture, _totalcapture(1, 13)),
    "TotalCapture raw": (totalcapture.FORMAT, _uncalibrated, _totalcapture(1, 13)),
    "TotalCapture pkl": (
        totalcapture.FORMAT, files.tc_pkl, _pickle(files.tc_pkl_data, files.tc_pkl, "ori", "acc")
    ),
    "qmt": (qmt.FORMAT, files.qmt, _qmt),
    "OpenSense": (opensense.FORMAT, files.sto, _cells("\t", 5, 3, 1, "NaN")),
    "OpenSense, one number": (opensense.FORMAT, files.sto, _cells("\t", 5, 3, 1, "1,nan,0,0")),
    "Xsens MTw": (
        xsens_mtw.FORMAT, files.mtw, _cells("\t", 3, 3, 12, "", "MT_trial_00B40002.txt")
    ),
    "MVNX": (mvnx.FORMAT, files.mvnx, _mvnx("sensorOrientation", "sensorFreeAcceleration")),
    "phones": (phones.FORMAT, files.watch, _cells(",", 1, 2, 13, "")),
    "CSV": (csv.FORMAT, files.csv_wide, _cells(",", 2, 21, 10)),
    "CSV folder": (csv.FORMAT, files.csv_folder, _cells(",", 2, 1, 10, "", "right_thigh.csv")),
}  # fmt: skip

HALF: dict[str, tuple[Format, Callable[[Path], Path], Burst, str]] = {
    "native orientation": (
        native.FORMAT, files.native_recording, _arrays("R_world_bone"), "orientation"
    ),
    "native acceleration": (
        native.FORMAT, files.native_recording, _arrays("acc_world"), "acceleration"
    ),
    "native raw orientation": (
        native.FORMAT, files.native_raw, _arrays("R_world_sensor"), "orientation"
    ),
    "DIP-IMU orientation": (
        dip.FORMAT, files.dip, _pickle(files.dip_data, files.dip, "imu_ori"), "orientation"
    ),
    "DIP-IMU acceleration": (
        dip.FORMAT, files.dip, _pickle(files.dip_data, files.dip, "imu_acc"), "acceleration"
    ),
    "TotalCapture raw orientation": (
        totalcapture.FORMAT, _uncalibrated, _totalcapture(1, 4), "orientation"
    ),
    "MVNX orientation": (mvnx.FORMAT, files.mvnx, _mvnx("sensorOrientation"), "orientation"),
    "MVNX acceleration": (mvnx.FORMAT, files.mvnx, _mvnx("sensorFreeAcceleration"), "acceleration"),
}  # fmt: skip


def _both(
    reader: Format, write: Callable[[Path], Path], burst: Burst, folder: Path
) -> tuple[Document, Document]:
    """The good file, and the same with the burst."""
    path = write(folder)
    good = reader.read(path, Options())
    burst(path)
    return good, reader.read(path, Options())


def _rotations(x: RawRecording | Recording) -> np.ndarray:
    R = x.R_world_bone if isinstance(x, Recording) else x.R_world_sensor
    assert R is not None
    return R


def _acc(x: RawRecording | Recording) -> np.ndarray:
    return x.acc_world if isinstance(x, Recording) else x.acc


def _same_elsewhere(good: Document, broken: Document) -> tuple[int, str]:
    """The sensor hit; that nothing else changed is asserted."""
    a, b = good.content, broken.content
    assert isinstance(a, RawRecording | Recording) and isinstance(b, RawRecording | Recording)
    assert a.sensors == b.sensors and len(a) == len(b)
    hit = np.isfinite(_rotations(a)) & ~np.isfinite(_rotations(b))
    hit_acc = np.isfinite(_acc(a)) & ~np.isfinite(_acc(b))
    where = hit.any((2, 3)) | hit_acc.any(2)
    (s,) = np.flatnonzero(where.any(axis=0))
    assert np.flatnonzero(where[:, s]).tolist() == list(range(BURST.start, BURST.stop))
    others = [k for k in range(len(a.sensors)) if k != s]
    np.testing.assert_array_equal(_rotations(a)[:, others], _rotations(b)[:, others])
    np.testing.assert_array_equal(_acc(a)[:, others], _acc(b)[:, others])
    return int(s), a.sensors[s]


@pytest.mark.parametrize("case", BURSTS)
def test_a_burst_is_a_gap(case: str, tmp_path: Path) -> None:
    good, broken = _both(*BURSTS[case], tmp_path)
    s, name = _same_elsewhere(good, broken)
    a, b = good.content, broken.content
    assert isinstance(a, RawRecording | Recording) and isinstance(b, RawRecording | Recording)
    lost = a.valid & ~b.valid
    assert np.argwhere(lost).tolist() == [[t, s] for t in range(BURST.start, BURST.stop)]
    assert not (b.valid & ~a.valid).any()
    said = next(w for w in broken.warnings if "samples are missing or not finite" in w)
    assert re.search(rf"\b{name} 1[02]\b.*the longest gap 10 frames", said), said


@pytest.mark.parametrize("case", HALF)
def test_half_a_sample_is_used_and_told(case: str, tmp_path: Path) -> None:
    """A sample that has lost its orientation or its acceleration alone stays valid."""
    *how, what = HALF[case]
    good, broken = _both(*how, tmp_path)  # type: ignore[arg-type]
    s, name = _same_elsewhere(good, broken)
    a, b = good.content, broken.content
    assert isinstance(a, RawRecording | Recording) and isinstance(b, RawRecording | Recording)
    np.testing.assert_array_equal(a.valid, b.valid)
    values = _acc(b) if what == "acceleration" else _rotations(b).reshape(len(b), len(b.sensors), 9)
    assert np.isnan(values[BURST, s]).all()
    assert f"10 of {b.valid.size} samples have no {what} ({name} 10)" in broken.warnings
    assert not any(f"have no {what}" in w for w in good.warnings)
