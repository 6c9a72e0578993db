"""Every format against every kind of damage: a cell is a case that is tested, or why there is none.

The cases run in the test files that they come from, those of NaN bursts in sensor data, which are gaps and
no damage, in `test_broken_gaps`; the reader of IMUPoser's torch files, its cases too, is in `learned`.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from mocap import formats
from tests.mocap.formats.broken import Cases
from tests.mocap.formats.test_amass import CASES as AMASS
from tests.mocap.formats.test_asfamc import CASES as ASFAMC
from tests.mocap.formats.test_broken_archives import NATIVE, QMT
from tests.mocap.formats.test_broken_gaps import BURSTS
from tests.mocap.formats.test_broken_named import CSV, CSV_FOLDER, MVNX
from tests.mocap.formats.test_broken_pickles import DIP, PICKLED, RELEASE
from tests.mocap.formats.test_broken_text import MTW, STO, TOTALCAPTURE
from tests.mocap.formats.test_bvh import CASES as BVH
from tests.mocap.formats.test_phones import CASES as PHONES

DAMAGE = (
    "truncated", "wrong shape", "NaN burst", "swapped units", "left-handed", "non-unit", "wrong rate",
    "empty", "huge", "malicious pickle",
)  # fmt: skip


@dataclass(frozen=True)
class Gap:
    """The burst is read as a gap: the name of the case in `BURSTS`."""

    name: str


@dataclass(frozen=True)
class Never:
    """The damage cannot be in the format, and why."""

    reason: str


Cell = str | Gap | Never
NO_PICKLE = Never("no pickle: text, or numbers of fixed types")
NO_RATE = Never("no rate in the file: that of the data set is assumed, and told")
QUATERNION = Never("quaternions and angles are right-handed whatever their numbers are")
ANGLES = Never("angles: any number is one")

# In the order of DAMAGE.
TABLE: dict[str, tuple[str, Cases, tuple[Cell, ...]]] = {
    "native recording": ("native", NATIVE, (
        "cut", "wrong shape", Gap("native recording"), "calibrated in g", "left-handed",
        "recording not orthonormal", "rate zero", "empty", "huge count", "pickle",
    )),
    "native raw recording": ("native", NATIVE, (
        "raw cut", "wrong length", Gap("native raw"), "acc in g", "raw left-handed", "not orthonormal",
        "rate nan", "raw empty", "raw huge count", "pickle for numbers",
    )),
    "AMASS, and native motions": ("amass", AMASS, (
        "cut", "63 columns", "nan", "in degrees", QUATERNION, ANGLES, "rate zero", "empty", "huge count",
        "malicious",
    )),
    "BVH": ("bvh", BVH, (
        "cut in the numbers", "channels too many", "nan",
        Never("angles in radians look like a body that hardly moves; lengths are judged by the legs"),
        QUATERNION, ANGLES, "tiny frame time", "empty", "billions of frames", NO_PICKLE,
    )),
    "ASF/AMC": ("asfamc", ASFAMC, (
        "cut inside a frame", "a value too many", "nan", "degrees said to be radians", QUATERNION, ANGLES,
        NO_RATE, "nothing", "huge file", NO_PICKLE,
    )),
    "DIP-IMU": ("dip", DIP, (
        "cut", "16 sensors", Gap("DIP-IMU"), "in g", "left-handed", "not orthonormal", NO_RATE, "empty",
        "huge count", "malicious",
    )),
    "DIP-IMU npz": ("dip", RELEASE, (
        "cut", "thin", Gap("DIP-IMU npz"), "in g", "left-handed", "normalised", NO_RATE, "empty",
        "huge count", "evil",
    )),
    "TotalCapture": ("totalcapture", TOTALCAPTURE, (
        "cut between frames", "frame skipped", Gap("TotalCapture"), "in g", QUATERNION, "non-unit", NO_RATE,
        "empty", "huge count", NO_PICKLE,
    )),
    "TotalCapture, uncalibrated": ("totalcapture", TOTALCAPTURE, (
        "cut", "names change", Gap("TotalCapture raw"), "raw in degrees", QUATERNION, "non-unit", NO_RATE,
        "empty", "many sensors", NO_PICKLE,
    )),
    "TotalCapture pkl": ("totalcapture", PICKLED, (
        "cut", "seven", Gap("TotalCapture pkl"), "in g", "left-handed", "not orthonormal", NO_RATE, "empty",
        "huge count", "malicious",
    )),
    "qmt": ("qmt", QMT, (
        "cut", "wrong shape", Gap("qmt"), "in g", QUATERNION, "non-unit", "time jumps", "empty", "bomb",
        NO_PICKLE,
    )),
    "OpenSense": ("opensense", STO, (
        "cut", "three numbers", Gap("OpenSense"), Never("orientations alone, which have no unit"),
        QUATERNION, "non-unit", "rate changes", "empty", "endless line", NO_PICKLE,
    )),
    "Xsens MTw": ("xsens_mtw", MTW, (
        "cut in a row", "no acc", Gap("Xsens MTw"), "in g", "left-handed", "not orthonormal", "two rates",
        "empty", "huge count", NO_PICKLE,
    )),
    "MVNX": ("mvnx", MVNX, (
        "cut", "count", Gap("MVNX"), "in g", QUATERNION, "sensor non-unit", "wrong rate", "empty",
        "endless text", NO_PICKLE,
    )),
    "phones": ("phones", PHONES, (
        "cut", "an axis missing", Gap("phones"), "gravity elsewhere", QUATERNION, "non-unit", "no clock",
        "empty", "huge gap", NO_PICKLE,
    )),
    "CSV": ("csv", CSV, (
        "cut", "short row", Gap("CSV"), "in degrees", QUATERNION, "non-unit", "rate contradicts", "empty",
        "huge gap", NO_PICKLE,
    )),
    "CSV folder": ("csv", CSV_FOLDER, (
        "one cut", "one without a column", Gap("CSV folder"), "one in g", QUATERNION, "one non-unit",
        "another rate", "nothing in it", "another day", NO_PICKLE,
    )),
}  # fmt: skip


@pytest.mark.parametrize("row", TABLE)
def test_no_cell_is_missing(row: str) -> None:
    _, cases, cells = TABLE[row]
    for damage, cell in zip(DAMAGE, cells, strict=True):
        if isinstance(cell, Gap):
            assert damage == "NaN burst" and cell.name in BURSTS
        elif isinstance(cell, str):
            assert cell in cases, f"{row}, {damage}: no case {cell!r}"
        else:
            assert damage not in ("truncated", "wrong shape", "NaN burst", "empty", "huge"), damage


def test_every_format_has_a_row() -> None:
    """A new reader of this package needs a row."""
    ours = {f.name for f in formats.registry()} - {"imuposer", "gltf"}  # glTF is only written
    assert {name for name, _, _ in TABLE.values()} == ours
