"""The option that an error names mends the file: `--units g` and `--units deg/s` are honoured everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap.errors import FormatError
from mocap.formats import (
    Format,
    Options,
    csv,
    dip,
    mvnx,
    native,
    qmt,
    totalcapture,
    xsens_mtw,
)
from mocap.recording import RawRecording, Recording
from tests.mocap.formats import recording_files as files
from tests.mocap.formats.broken import Break, Cases
from tests.mocap.formats.test_broken_archives import NATIVE
from tests.mocap.formats.test_broken_named import CSV, MVNX
from tests.mocap.formats.test_broken_pickles import DIP, PICKLED, RELEASE
from tests.mocap.formats.test_broken_text import TOTALCAPTURE


def _all_in_g(folder: Path) -> Path:
    """Every device of an MTw export; the case breaks one alone, which no option could mend."""
    out = files.mtw(folder)
    for path in out.glob("MT_*.txt"):
        lines = path.read_text().splitlines()
        for i, line in enumerate(lines[3:], 3):
            cells = line.split("\t")
            cells[3:6] = [f"{float(c) / 9.80665:.9f}" for c in cells[3:6]]
            lines[i] = "\t".join(cells)
        path.write_text("\n".join(lines) + "\n")
    return out


def _case(cases: Cases, name: str) -> Break:
    return cases[name][0]


def _every(field: str, factor: float) -> Break:
    """A qmt file with one quantity of all segments multiplied."""

    def make(folder: Path) -> Path:
        data = files.qmt_data(files.raw(rate=100.0, T=400))
        for segment in data.values():
            if isinstance(segment, dict):
                segment[field] = factor * segment[field]
        return files.qmt(folder, data)

    return make


G, DEG = 1 / 9.80665, 180 / np.pi
TOLD: dict[str, tuple[Format, Break, Callable[[Path], Path], str]] = {
    "native raw g": (native.FORMAT, _case(NATIVE, "acc in g"), files.native_raw, "g"),
    "native raw deg/s": (native.FORMAT, _case(NATIVE, "gyr in degrees"), files.native_raw, "deg/s"),
    "native g": (native.FORMAT, _case(NATIVE, "calibrated in g"), files.native_recording, "g"),
    "qmt g": (qmt.FORMAT, _every("acc", G), files.qmt, "g"),
    "qmt deg/s": (qmt.FORMAT, _every("gyr", DEG), files.qmt, "deg/s"),
    "MTw g": (xsens_mtw.FORMAT, _all_in_g, files.mtw, "g"),
    "MVNX g": (mvnx.FORMAT, _case(MVNX, "in g"), files.mvnx, "g"),
    "CSV g": (csv.FORMAT, _case(CSV, "in g"), files.csv_wide, "g"),
    "CSV deg/s": (csv.FORMAT, _case(CSV, "in degrees"), files.csv_wide, "deg/s"),
    "DIP-IMU g": (dip.FORMAT, _case(DIP, "in g"), files.dip, "g"),
    "DIP-IMU npz g": (dip.FORMAT, _case(RELEASE, "in g"), files.dip_npz, "g"),
    "TotalCapture g": (totalcapture.FORMAT, _case(TOTALCAPTURE, "in g"), files.totalcapture, "g"),
    "TotalCapture deg/s": (
        totalcapture.FORMAT, _case(TOTALCAPTURE, "raw in degrees"),
        lambda d: files.totalcapture(d, calibrated=False), "deg/s",
    ),
    "TotalCapture pkl g": (totalcapture.FORMAT, _case(PICKLED, "in g"), files.tc_pkl, "g"),
}  # fmt: skip


@pytest.mark.parametrize("case", TOLD)
def test_the_units_that_the_error_names(case: str, tmp_path: Path) -> None:
    reader, make, write, unit = TOLD[case]
    (tmp_path / "broken").mkdir()
    path = make(tmp_path / "broken")
    with pytest.raises(FormatError, match=rf"--units {unit}"):
        reader.read(path, Options())
    mended = reader.read(path, Options(units=frozenset([unit]))).content
    good = reader.read(write(tmp_path), Options()).content
    if isinstance(good, Recording):
        assert isinstance(mended, Recording)
        pairs = [(mended.acc_world, good.acc_world)]
    else:
        assert isinstance(mended, RawRecording) and isinstance(good, RawRecording)
        pairs = [(mended.acc, good.acc), (mended.gyr, good.gyr)]
    for have, want in pairs:
        # The cases divide by 9.81, not by 9.80665, and text keeps seven digits.
        np.testing.assert_allclose(have, want, rtol=5e-4, atol=1e-2)
