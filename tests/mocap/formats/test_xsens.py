"""Exports of MT Manager and the DOT app in all their shapes: the same recording, whatever the spelling."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Document, Options
from mocap.recording import RawRecording
from tests.mocap.formats import recording_files as files

RATE = files.RATE
DEVICES = ("00B42961", "00B42962", "00B429C7")


def euler_deg(R: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (N,3) deg of R = Rz Ry Rx."""
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1, 1))
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return np.rad2deg(np.stack([roll, pitch, yaw], axis=1))


def columns(rec: RawRecording, s: int, dot: bool) -> dict[str, np.ndarray]:
    """All a program may write of one sensor, by column."""
    assert rec.R_world_sensor is not None
    R = ori.R_ZUP_YUP @ rec.R_world_sensor[:, s]
    free = np.einsum("tij,tj->ti", R, rec.acc[:, s]) - np.array([0, 0, ori.GRAVITY])
    n = np.arange(len(rec))
    out = {"PacketCounter": (65400 + n) % 65536}
    out["SampleTimeFine"] = np.round(1e6 + 1e6 * n / RATE) if dot else np.round(1e4 * n / RATE)
    for name, values in (("Acc", rec.acc[:, s]), ("FreeAcc", free)):
        out |= {f"{name}_{a}": values[:, k] for k, a in enumerate("XYZ")}
    gyr = np.rad2deg(rec.gyr[:, s]) if dot else rec.gyr[:, s]
    out |= {f"Gyr_{a}": gyr[:, k] for k, a in enumerate("XYZ")}
    out |= {f"Mat[{r + 1}][{c + 1}]": R[:, r, c] for c in range(3) for r in range(3)}
    names = [f"Quat_{a}" for a in "WXYZ"] if dot else [f"Quat_q{k}" for k in range(4)]
    out |= dict(zip(names, ori.to_quat(R).T, strict=True))
    names = [f"Euler_{a}" for a in "XYZ"] if dot else ["Roll", "Pitch", "Yaw"]
    return out | dict(zip(names, euler_deg(R).T, strict=True))


ACC, FREE, GYR = (tuple(f"{n}_{a}" for a in "XYZ") for n in ("Acc", "FreeAcc", "Gyr"))
MAT = tuple(f"Mat[{r}][{c}]" for c in (1, 2, 3) for r in (1, 2, 3))
QUAT, WXYZ = tuple(f"Quat_q{k}" for k in range(4)), tuple(f"Quat_{a}" for a in "WXYZ")
RPY, EULER = ("Roll", "Pitch", "Yaw"), tuple(f"Euler_{a}" for a in "XYZ")


def text(
    rec: RawRecording,
    s: int,
    wanted: tuple[str, ...],
    delimiter: str = "\t",
    dot: bool = False,
    head: str = "// Update Rate: {rate:.1f}Hz\n",
    keep: np.ndarray | None = None,
    comma: bool = False,
) -> str:
    have = columns(rec, s, dot)
    rows = np.stack([have[c] for c in wanted], axis=1)
    lines = [
        delimiter.join(f"{v:.9g}" for v in row)
        for row in rows[slice(None) if keep is None else keep]
    ]
    if comma:
        lines = [line.replace(".", ",") for line in lines]
    return head.format(rate=RATE) + delimiter.join(wanted) + "\n" + "\n".join(lines) + "\n"


def read(path: Path, options: Options | None = None) -> tuple[RawRecording, Document]:
    doc = formats.read(path, options)
    assert isinstance(doc.content, RawRecording)
    return doc.content, doc


def same(got: RawRecording, want: RawRecording, sensors: tuple[int, ...] = (0,)) -> None:
    """Accelerations, rates and orientations of these sensors, to the digits of the file."""
    assert got.R_world_sensor is not None and want.R_world_sensor is not None
    k = list(sensors)
    np.testing.assert_allclose(got.acc, want.acc[:, k], atol=1e-5)
    np.testing.assert_allclose(got.gyr, want.gyr[:, k], atol=1e-5)
    assert ori.angle_between(got.R_world_sensor, want.R_world_sensor[:, k]).max() < 1e-5


SHAPES: dict[str, Callable[[RawRecording, int], str]] = {
    "tab": lambda r, s: text(r, s, ("PacketCounter", *ACC, *GYR, *MAT)),
    "comma": lambda r, s: text(r, s, ("PacketCounter", *ACC, *GYR, *QUAT), ","),
    "semicolon": lambda r, s: text(r, s, ("PacketCounter", *ACC, *GYR, *QUAT), ";"),
    "blanks": lambda r, s: text(r, s, ("PacketCounter", *ACC, *GYR, *QUAT), " "),
    "decimal comma": lambda r, s: text(r, s, ("PacketCounter", *ACC, *GYR, *QUAT), ";", comma=True),
    "Euler angles": lambda r, s: text(r, s, ("PacketCounter", *ACC, *GYR, *RPY)),
    "free acceleration": lambda r, s: text(r, s, ("PacketCounter", *FREE, *GYR, *QUAT)),
    "no rate": lambda r, s: text(r, s, ("PacketCounter", "SampleTimeFine", *ACC, *GYR, *QUAT), head=""),
    "no counter": lambda r, s: text(r, s, (*ACC, *GYR, *QUAT)),
    "DOT": lambda r, s: text(
        r, s, ("PacketCounter", "SampleTimeFine", *WXYZ, *ACC, *GYR), ",", True, "sep=,\n"
    ),
    "DOT, custom mode": lambda r, s: text(
        r, s, ("PacketCounter", "SampleTimeFine", *EULER, *FREE, *GYR), ",", True,
        "DeviceTag:,Left thigh\nOutputRate:,60Hz\n\n",
    ),
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".txt", ".csv"])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_is_the_same_recording(tmp_path: Path, shape: str, suffix: str) -> None:
    want = files.raw()
    path = tmp_path / f"any prefix_{DEVICES[0]}{suffix}"
    path.write_text(SHAPES[shape](want, 0))
    got, doc = read(path)
    assert got.rate_hz == pytest.approx(RATE, rel=1e-3)
    assert doc.format == ("xsens_dot" if "DOT" in shape else "xsens_mtw")
    assert got.sensors == (("Left thigh",) if "custom" in shape else (DEVICES[0],))
    same(got, want)


def test_orientations_alone(tmp_path: Path) -> None:
    want = files.raw()
    path = tmp_path / f"MT_{DEVICES[0]}.txt"
    path.write_text(text(want, 0, ("PacketCounter", *QUAT)))
    got, doc = read(path)
    assert got.valid.all() and not np.isfinite(got.acc).any() and np.isfinite(got.gyr).all()
    assert any("no rates in the file" in a for a in doc.assumptions)


@pytest.mark.parametrize("shape", ["comma", "DOT", "Euler angles"])
def test_a_folder_is_a_take(tmp_path: Path, shape: str) -> None:
    """One file a device; what one of them lost stays a gap; --map names them."""
    want = files.raw()
    for s, device in enumerate(DEVICES):
        made = SHAPES[shape](want, s).split("\n")
        if s == 1:
            del made[-60:-50]
        (tmp_path / f"MT_0120_001-000_{device}.csv").write_text("\n".join(made))
    names = dict(zip(DEVICES, want.sensors, strict=False))
    got, doc = read(tmp_path, Options(mapping=names))
    assert got.sensors == want.sensors[:3]
    lost = ~got.valid
    assert lost[:, 1].sum() == 10 and not lost[:, [0, 2]].any()
    np.testing.assert_allclose(got.acc[got.valid], want.acc[:, :3][got.valid], atol=1e-5)
    assert any("10 of" in w and want.sensors[1] in w for w in doc.warnings)


def test_devices_start_one_after_the_other(tmp_path: Path) -> None:
    """DOTs that share a clock line up by it, and by nothing else."""
    want = files.raw()
    for s, device in enumerate(DEVICES):
        keep = np.arange(7 * s, len(want))
        wanted = ("SampleTimeFine", *WXYZ, *ACC, *GYR)
        made = text(want, s, wanted, ",", True, "sep=,\n", keep)
        (tmp_path / f"{device}_2021.csv").write_text(made)
    got, _ = read(tmp_path)
    np.testing.assert_allclose(got.acc, want.acc[14:, :3], atol=1e-5)


def test_clocks_that_have_nothing_in_common_are_told(tmp_path: Path) -> None:
    want = files.raw()
    for s, device in enumerate(DEVICES[:2]):
        made = SHAPES["DOT"](want, s)
        if s:
            rows = made.split("\n")
            for k in range(2, len(rows) - 1):
                cells = rows[k].split(",")
                cells[1] = f"{float(cells[1]) + 3.6e9:.0f}"
                rows[k] = ",".join(cells)
            made = "\n".join(rows)
        (tmp_path / f"{device}_2021.csv").write_text(made)
    got, doc = read(tmp_path)
    same(got, want, (0, 1))
    assert any("not synchronised" in w for w in doc.warnings)


def test_two_takes_in_a_folder_are_refused(tmp_path: Path) -> None:
    want = files.raw()
    for trial in ("walk", "run"):
        (tmp_path / f"MT_{trial}_{DEVICES[0]}.txt").write_text(SHAPES["tab"](want, 0))
    with pytest.raises(FormatError, match=r"2 trials \(MT_run, MT_walk\)"):
        formats.read(tmp_path)


def test_gravity_along_another_axis_is_told(tmp_path: Path) -> None:
    """Converted files may have y up; what gravity says counts."""
    want = files.raw()
    assert want.R_world_sensor is not None
    turned = RawRecording(
        want.rate_hz, want.sensors, want.gyr, want.acc,
        R_world_sensor=ori.R_YUP_ZUP @ want.R_world_sensor,
    )  # fmt: skip
    (tmp_path / f"{DEVICES[0]}.txt").write_text(SHAPES["tab"](turned, 0))
    got, doc = read(tmp_path / f"{DEVICES[0]}.txt")
    same(got, want)
    assert any("gravity is along y" in a for a in doc.assumptions)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    want = files.raw()
    path = tmp_path / "a.txt"
    path.write_text(text(want, 0, ("PacketCounter", *ACC)))
    with pytest.raises(
        FormatError, match=r"no column Mat\[1\]\[1\], Quat_q0 or Roll, and no Acc_X with Gyr_X"
    ):
        formats.read(path)
    path.write_text(text(want, 0, ("PacketCounter", *ACC, *GYR, *QUAT), head=""))
    with pytest.raises(FormatError, match="say --rate HZ"):
        formats.read(path)
    assert read(path, Options(rate_hz=RATE))[0].rate_hz == RATE
    path.write_text(text(want, 0, ("PacketCounter", *ACC, *RPY)).replace("\t", "\t1", 1))
    with pytest.raises(FormatError):
        formats.read(path)
