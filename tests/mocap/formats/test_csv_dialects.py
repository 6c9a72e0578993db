"""Tables as other programs write them: delimiters, decimal signs, odd columns, no gravity, clocks apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Document
from mocap.recording import RawRecording
from tests.mocap.formats import recording_files as files


def read(path: Path) -> tuple[RawRecording, Document]:
    doc = formats.read(path)
    assert isinstance(doc.content, RawRecording)
    return doc.content, doc


def lines(rec: RawRecording | None = None) -> list[str]:
    rec = rec or files.raw()
    return files.csv_lines(rec, rec.sensors)


def _decimal_comma(delimiter: str) -> Callable[[list[str]], list[str]]:
    def change(made: list[str]) -> list[str]:
        head = [made[0], made[1].replace(",", delimiter)]
        return head + [r.replace(",", delimiter).replace(".", ",") for r in made[2:]]

    return change


DIALECTS: dict[str, Callable[[list[str]], list[str]]] = {
    "tabs": lambda x: [x[0], *(r.replace(",", "\t") for r in x[1:])],
    "semicolons": lambda x: [x[0], *(r.replace(",", ";") for r in x[1:])],
    "blanks": lambda x: [x[0], *(r.replace(",", "  ") for r in x[1:])],
    "tabs, decimal comma": _decimal_comma("\t"),
    "semicolons, decimal comma": _decimal_comma(";"),
    "quoted, decimal comma": lambda x: [
        *x[:2],
        *(",".join(f'"{c.replace(".", ",")}"' for c in r.split(",")) for r in x[2:]),
    ],
    "a comma at every end": lambda x: [x[0], *(r + "," for r in x[1:])],
    "commas at the rows' ends": lambda x: [*x[:2], *(r + ",," for r in x[2:])],
    "a line sep=": lambda x: ["sep=,", *x],
    "words before the header": lambda x: ["Subject:,17", "", "Trial:,walk", *x],
    "a column of words": lambda x: [x[0], x[1] + ",note", *(r + ",fine" for r in x[2:])],
    "comments among the rows": lambda x: [*x[:50], "# a break", *x[50:]],
    "capitals and blanks": lambda x: [x[0], x[1].upper().replace(",", " , "), *x[2:]],
    "Windows": lambda x: ["\ufeff" + x[0] + "\r", *(r + "\r" for r in x[1:])],
}  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_is_the_same_table(tmp_path: Path, dialect: str) -> None:
    (tmp_path / "x.csv").write_text("\n".join(DIALECTS[dialect](lines())) + "\n", encoding="utf-8")
    got, _ = read(tmp_path / "x.csv")
    want = files.raw()
    assert tuple(n.lower() for n in got.sensors) == want.sensors
    np.testing.assert_allclose(got.acc, want.acc, atol=1e-6)
    assert got.R_world_sensor is not None and want.R_world_sensor is not None
    assert ori.angle_between(got.R_world_sensor, want.R_world_sensor).max() < 1e-5


def free(rec: RawRecording) -> RawRecording:
    """Accelerations in the sensors' axes without gravity."""
    assert rec.R_world_sensor is not None
    return replace(rec, acc=rec.acc - ori.GRAVITY * rec.R_world_sensor[:, :, 1])


@pytest.mark.parametrize(
    "header", ["acc: m/s^2, gyr: rad/s, world: z-up", "gyr: rad/s, world: z-up"]
)
def test_gravity_is_put_back_by_the_orientation(tmp_path: Path, header: str) -> None:
    want = files.raw()
    made = files.csv_lines(free(want), want.sensors, header=header)
    (tmp_path / "x.csv").write_text("\n".join(made) + "\n")
    got, doc = read(tmp_path / "x.csv")
    np.testing.assert_allclose(got.acc, want.acc, atol=1e-5)
    assert any("holds no gravity: it is put back" in a for a in doc.assumptions)


def test_without_orientation_gravity_is_asked_for(tmp_path: Path) -> None:
    want = free(files.raw())
    made = [",".join(r.split(",")[:7]) for r in files.csv_lines(want, want.sensors[:1])[1:]]
    (tmp_path / "x.csv").write_text("\n".join(["# acc: m/s^2, gyr: rad/s", *made]) + "\n")
    with pytest.raises(
        FormatError, match="gravity was removed: export the acceleration with gravity"
    ):
        formats.read(tmp_path / "x.csv")


def test_clocks_that_run_apart_are_followed(tmp_path: Path) -> None:
    """Two sensors for ten minutes, one clock 100 ppm fast: what happens at once stays at once."""
    n, rate = 36_000, 60.0
    base = np.arange(n) / rate
    for k, name in enumerate(("left_shank", "right_shank")):
        turn = 1 + 1e-4 * k
        true = base[base * turn < base[-1]] * turn
        acc = np.stack([0 * true, 9.81 + np.sin(0.7 * true), np.sin(2 * true)], axis=1)
        rows = np.concatenate([true[:, None], acc, 0.2 * acc], axis=1)
        text = "t,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z\n"
        text += "\n".join(",".join(f"{v:.7g}" for v in row) for row in rows)
        (tmp_path / f"{name}.csv").write_text("# acc: m/s^2, gyr: rad/s\n" + text + "\n")
    got, doc = read(tmp_path)
    late = slice(-400, -100)
    ok = got.valid[late].all(axis=1)
    assert ok.mean() > 0.95
    assert np.abs(got.acc[late][ok, 0] - got.acc[late][ok, 1]).max() < 0.06
    assert any("off the others'" in w for w in doc.warnings)
