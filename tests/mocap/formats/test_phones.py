"""Exports of phone apps: one recording in every app's columns, signs and units, in one file or in several."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Document, Options, phones
from mocap.recording import RawRecording
from tests.mocap.formats import broken
from tests.mocap.formats import recording_files as files

G = ori.GRAVITY
Table = tuple[str, np.ndarray]


def read(path: Path, options: Options | None = None) -> tuple[RawRecording, Document]:
    doc = formats.read(path, options)
    assert isinstance(doc.content, RawRecording)
    return doc.content, doc


def write(path: Path, names: str, values: np.ndarray, delimiter: str = ",") -> None:
    rows = [delimiter.join(f"{v:.17g}" for v in row) for row in values]
    path.write_text(names.replace(",", delimiter) + "\n" + "\n".join(rows) + "\n")


def parts(rec: RawRecording, s: int) -> dict[str, np.ndarray]:
    assert rec.R_world_sensor is not None
    R = ori.R_ZUP_YUP @ rec.R_world_sensor[:, s]
    return {
        "t": np.arange(len(rec))[:, None] / rec.rate_hz, "force": rec.acc[:, s], "gyr": rec.gyr[:, s],
        "gravity": G * R[:, 2], "free": rec.acc[:, s] - G * R[:, 2], "quat": ori.to_quat(R),
        "inverse": ori.to_quat(np.swapaxes(R, -1, -2)),
    }  # fmt: skip


def sensorlog(path: Path, rec: RawRecording, s: int, inverse: bool = False) -> None:
    """iOS: accelerations in g, of gravity, not against it."""
    p = parts(rec, s)
    names = (
        "motionTimestamp_sinceReboot(s),"
        + ",".join(f"accelerometerAcceleration{a}(G)" for a in "XYZ")
        + ","
        + ",".join(f"motionRotationRate{a}(rad/s)" for a in "XYZ")
        + ","
        + ",".join(f"motionQuaternion{a}(R)" for a in "WXYZ")
    )
    quat = p["inverse"] if inverse else p["quat"]
    write(path, names, np.concatenate([1000 + p["t"], -p["force"] / G, p["gyr"], quat], axis=1))


def logger(folder: Path, rec: RawRecording, s: int, sign: float = 1.0, unit: float = 1.0) -> None:
    """Sensor Logger's folder: a file a sensor, each with stamps of its own."""
    folder.mkdir(exist_ok=True)
    p = parts(rec, s)
    start = 1_700_000_000.0
    for name, kind, shift in (("TotalAcceleration", "force", 0.0), ("Gyroscope", "gyr", 0.0)):
        values = p[kind] * (sign * unit if kind == "force" else 1.0)
        t = p["t"] + shift
        made = np.concatenate([(start + t) * 1e9, t, values[:, ::-1]], axis=1)
        write(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", made)
    made = np.concatenate([(start + p["t"]) * 1e9, p["t"], p["quat"][:, [3, 2, 1, 0]]], axis=1)
    write(folder / "Orientation.csv", "time,seconds_elapsed,qz,qy,qx,qw", made)


def same(got: RawRecording, want: RawRecording, s: int = 0, atol: float = 1e-5) -> None:
    assert got.R_world_sensor is not None and want.R_world_sensor is not None
    np.testing.assert_allclose(got.acc[:, 0], want.acc[:, s], atol=atol)
    np.testing.assert_allclose(got.gyr[:, 0], want.gyr[:, s], atol=atol)
    assert ori.angle_between(got.R_world_sensor[:, 0], want.R_world_sensor[:, s]).max() < 10 * atol


def test_a_watch(tmp_path: Path) -> None:
    want = files.raw()
    got, doc = read(files.watch(tmp_path), Options(mapping={"WristMotion": "left_wrist"}))
    assert got.sensors == ("left_wrist",) and got.rate_hz == pytest.approx(files.RATE)
    same(got, want)
    assert any("gravity and acceleration together" in a for a in doc.assumptions)


@pytest.mark.parametrize("inverse", [False, True])
def test_sensorlog(tmp_path: Path, inverse: bool) -> None:
    """Unit, sign and the way a quaternion turns are those that gravity allows, and are said."""
    want = files.raw()
    sensorlog(tmp_path / "phone.csv", want, 1, inverse)
    got, doc = read(tmp_path / "phone.csv")
    same(got, want, 1)
    told = next(a for a in doc.assumptions if "by gravity" in a)
    assert "accelerations turned round" in told and ("inverted" in told) == inverse


@pytest.mark.parametrize(("sign", "unit"), [(1.0, 1.0), (-1.0, 1.0), (-1.0, 1 / G), (1.0, 1 / G)])
def test_a_folder_is_a_device(tmp_path: Path, sign: float, unit: float) -> None:
    want = files.raw()
    logger(tmp_path / "left_pocket", want, 2, sign, unit)
    got, doc = read(tmp_path / "left_pocket")
    assert got.sensors == ("left_pocket",)
    same(got, want, 2, atol=1e-4)
    assert ("in g, by the size" in str(doc.assumptions)) == (unit != 1.0)


def test_sensors_with_stamps_of_their_own_are_put_on_one_grid(tmp_path: Path) -> None:
    want = files.raw()
    logger(tmp_path / "phone", want, 0)
    p = parts(want, 0)
    slow = slice(1, None, 2)
    t = p["t"][slow] + 0.003
    force = np.stack([np.interp(t[:, 0], p["t"][:, 0], v) for v in p["force"].T], axis=1)
    made = np.concatenate([(1_700_000_000.0 + t) * 1e9, t, force[:, ::-1]], axis=1)
    write(tmp_path / "phone" / "TotalAcceleration.csv", "time,seconds_elapsed,z,y,x", made)
    got, _ = read(tmp_path / "phone")
    inside = slice(5, -5)
    assert got.valid[inside].all()
    line = np.stack([np.interp(p["t"][:, 0], t[:, 0], v) for v in force.T], axis=1)
    np.testing.assert_allclose(got.acc[inside, 0], line[inside], atol=1e-3)


def test_a_folder_of_devices_is_a_take(tmp_path: Path) -> None:
    want = files.raw()
    for s, name in enumerate(("left_pocket", "right_pocket")):
        logger(tmp_path / name, want, s)
    got, _ = read(tmp_path)
    assert got.sensors == ("left_pocket", "right_pocket") and not got.common_heading
    np.testing.assert_allclose(got.acc[:-1], want.acc[: len(got) - 1, :2], atol=1e-3)


@pytest.mark.parametrize(("delimiter", "comma"), [(",", False), (";", True), ("\t", False)])
def test_phyphox(tmp_path: Path, delimiter: str, comma: bool) -> None:
    """Without an orientation: raw, as a sensor that poser calibrate fuses."""
    want = files.raw()
    p, folder = parts(want, 0), tmp_path / "left_pocket"
    folder.mkdir()
    for name, kind, unit in (("Acceleration", "force", "m/s^2"), ("Gyroscope", "gyr", "rad/s")):
        header = ",".join(['"Time (s)"', *(f'"{name} {a} ({unit})"' for a in "xyz")])
        path = folder / f"{name}.csv"
        write(path, header, np.concatenate([p["t"], p[kind]], axis=1), delimiter)
        if comma:
            head, _, rows = path.read_text().partition("\n")
            path.write_text(head + "\n" + rows.replace(".", ","))
    got, doc = read(folder)
    assert got.R_world_sensor is None and any("specific force" in a for a in doc.assumptions)
    np.testing.assert_allclose(got.acc[:, 0], want.acc[:, 0], atol=1e-5)
    np.testing.assert_allclose(got.gyr[:, 0], want.gyr[:, 0], atol=1e-5)


ALONE = {
    "Accelerometer.csv": ("time,seconds_elapsed,z,y,x", "Gyroscope and Orientation"),
    "acc.csv": (
        '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"',
        "Acceleration .with g. and Gyroscope",
    ),
}


@pytest.mark.parametrize("name", ALONE)
def test_accelerations_alone_say_what_else_to_export(tmp_path: Path, name: str) -> None:
    header, wanted = ALONE[name]
    n = header.count(",") + 1
    write(tmp_path / name, header, np.arange(100)[:, None] / 50 + np.full((100, n), 0.1))
    with pytest.raises(FormatError, match=f"acceleration alone.*{wanted}"):
        formats.read(tmp_path / name)


def changed(change: Callable[[list[str]], list[str]]) -> broken.Break:
    def make(folder: Path) -> Path:
        path = files.watch(folder)
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
        return path

    return make


def cell(row: int, column: int, value: str) -> broken.Break:
    def change(lines: list[str]) -> list[str]:
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return changed(change)


def columns(first: int, values: Callable[[np.ndarray], np.ndarray]) -> broken.Break:
    """Three columns replaced in every row."""

    def change(lines: list[str]) -> list[str]:
        table = [line.split(",") for line in lines[1:]]
        new = values(np.array([row[first : first + 3] for row in table], float))
        out = [
            ",".join([*r[:first], *map(str, v), *r[first + 3 :]])
            for r, v in zip(table, new, strict=True)
        ]
        return [lines[0], *out]

    return changed(change)


def scattered(lines: list[str]) -> list[str]:
    """Stamps as a Geiger counter's."""
    stamps = np.cumsum(np.random.default_rng(0).exponential(2e7, len(lines)))
    rows = [line[line.index(",") :] for line in lines[1:]]
    return [lines[0], *(f"{t:.0f}{row}" for t, row in zip(stamps, rows, strict=False))]


CASES: broken.Cases = {
    "cut": (lambda d: broken.cut(files.watch(d), 0.5), r"line \d+: \d+ values, expected 15"),
    "empty": (lambda d: broken.cut(files.watch(d), 0.0), "no table of a phone app"),
    "an axis missing": (
        changed(lambda x: [x[0].replace("gravityY", "gravityQ"), *x[1:]]), "no column gravityy"
    ),
    "gravity elsewhere": (columns(5, lambda g: np.r_[g[:120], -g[120:]]), "turns the acceleration to no"),
    "non-unit": (cell(80, 11, "3"), "quaternion of norm"),
    "no clock": (
changed(scattered), "expected a constant rate|must rise",
    ),
    "huge gap": (cell(240, 0, "9e18"), "a gap of"),
    "not a number": (cell(20, 4, "x"), "line 21, column rotationRateZ: 'x'"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_broken_files(tmp_path: Path, case: str) -> None:
    make, message = CASES[case]
    broken.must_fail(make(tmp_path), phones.FORMAT, message)
