"""Every recording format: what is read from a small file equals the motion it was written from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap import formats, synthesis
from mocap import orientation as ori
from mocap.calibration import measures as unit_checks
from mocap.errors import FormatError
from mocap.formats import (
    Document,
    Options,
    _physics,
    csv,
    dip,
    mvnx,
    opensense,
    qmt,
    totalcapture,
    xsens_mtw,
)
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from tests.mocap.formats import recording_files as files

NONE = Options()


def _raw(document: Document) -> RawRecording:
    assert isinstance(document.content, RawRecording)
    return document.content


def _same_raw(have: RawRecording, want: RawRecording, tolerance: float = 1e-6) -> None:
    """Equal in time and, sensor by sensor, in orientation and what it measured."""
    assert have.rate_hz == pytest.approx(want.rate_hz, rel=1e-4)
    assert set(have.sensors) == set(want.sensors) and len(have) == len(want)
    want = want.select(have.sensors)
    assert have.valid.all()
    np.testing.assert_allclose(have.acc, want.acc, atol=20 * tolerance)
    np.testing.assert_allclose(have.R_world_sensor, want.R_world_sensor, atol=tolerance)


# ---------------------------------------------------------------------------------------------- csv


@pytest.mark.parametrize("write", [files.csv_wide, files.csv_folder])
def test_csv(write: Callable[[Path], Path], tmp_path: Path) -> None:
    document = csv.FORMAT.read(write(tmp_path), NONE)
    want = files.raw()
    have = _raw(document)
    _same_raw(have, want)
    np.testing.assert_allclose(have.gyr, want.select(have.sensors).gyr, atol=1e-6)
    assert document.warnings == ()


def test_csv_writes_what_it_reads(tmp_path: Path) -> None:
    want = files.raw()
    assert csv.FORMAT.write is not None
    csv.FORMAT.write(tmp_path / "w.csv", want)
    document = csv.FORMAT.read(tmp_path / "w.csv", NONE)
    _same_raw(_raw(document), want)
    np.testing.assert_allclose(_raw(document).mag, want.mag, rtol=1e-6)


def _csv_scaled(tmp_path: Path, acc: float, gyr: float, header: str) -> Path:
    rec = files.raw()
    scaled = RawRecording(
        rec.rate_hz, rec.sensors, rec.gyr * gyr, rec.acc * acc, R_world_sensor=rec.R_world_sensor
    )
    lines = files.csv_lines(scaled, rec.sensors, header=header)
    (tmp_path / "u.csv").write_text("\n".join(lines) + "\n")
    return tmp_path / "u.csv"


DEG = 180 / np.pi


@pytest.mark.parametrize(
    ("header", "units"),
    [
        ("acc: g, gyr: deg/s", frozenset()),
        ("acc: m/s^2, gyr: rad/s", frozenset({"g", "deg/s"})),
        ("no units declared", frozenset()),
    ],
)
def test_csv_units(tmp_path: Path, header: str, units: frozenset[str]) -> None:
    """In g and deg/s: declared in the file, overridden by the user, or inferred from gravity."""
    path = _csv_scaled(tmp_path, 1 / ori.GRAVITY, DEG, header)
    document = csv.FORMAT.read(path, Options(units=units))
    want = files.raw()
    _same_raw(_raw(document), want)
    np.testing.assert_allclose(_raw(document).gyr, want.gyr, atol=1e-6)
    inferred = [w for w in document.warnings if "not declared; read as" in w]
    assert len(inferred) == (2 if header.startswith("no") else 0)


@pytest.mark.parametrize(
    ("acc", "gyr", "header", "message"),
    [
        (
            1 / ori.GRAVITY,
            1,
            "acc: m/s^2, gyr: rad/s",
            "1 when still, expected 9.81 m/s.2, so the unit is g",
        ),
        (1, 1, "acc: g, gyr: rad/s", "96.2 when still, .* it was m/s.2 already"),
        (1, DEG, "acc: m/s^2, gyr: rad/s", "57 times what the orientation turns: in degrees"),
        (
            1,
            1,
            "acc: m/s^2, gyr: deg/s",
            "57 times less than the orientation turns: in rad already",
        ),
        (1, 1, "acc: furlong", "unit 'furlong', expected one of m/s"),
        (1, 1, "world: x-up", "is 'x-up', expected y-up or z-up"),
        (1, 1, "world: y-up", "expected \\(0, 9.8, 0\\): y up"),
    ],
)
def test_csv_units_that_contradict_gravity(
    tmp_path: Path, acc: float, gyr: float, header: str, message: str
) -> None:
    with pytest.raises(FormatError, match=message):
        csv.FORMAT.read(_csv_scaled(tmp_path, acc, gyr, header), NONE)


def test_csv_degrees_without_orientation(tmp_path: Path) -> None:
    """Without quaternions, the turning of gravity in acc tells degrees from radians."""
    rec = files.raw(T=900)
    bare = RawRecording(rec.rate_hz, rec.sensors, rec.gyr * DEG, rec.acc)
    assert _physics.gyr_in_degrees(bare)
    right = RawRecording(rec.rate_hz, rec.sensors, rec.gyr, rec.acc)
    assert not _physics.gyr_in_degrees(right)
    assert _physics.raw(tmp_path, right) == []
    with pytest.raises(FormatError, match="times what gravity in acc turns: in degrees"):
        _physics.raw(tmp_path, bare)


def _bare(acc: float) -> RawRecording:
    """Noisy sensors without orientation, none of them ever still."""
    rec = synthesis.raw_recording(files.motion(T=600), files.LEGS, synthesis.Noise(), 1)
    return RawRecording(rec.rate_hz, rec.sensors, rec.gyr, acc * rec.acc)


def _undeclared(folder: Path, rec: RawRecording) -> Path:
    """`rec` as a table that does not say its units."""
    assert csv.FORMAT.write is not None
    csv.FORMAT.write(folder / "u.csv", rec)
    lines = (folder / "u.csv").read_text().splitlines()
    (folder / "u.csv").write_text("\n".join(lines[1:]) + "\n")
    return folder / "u.csv"


@pytest.mark.parametrize(
    ("unit", "acc"), [("g", 1 / ori.GRAVITY), ("mg", 1000 / ori.GRAVITY), ("m/s^2", 1.0)]
)
def test_csv_units_of_noisy_sensors(tmp_path: Path, unit: str, acc: float) -> None:
    """White noise of 0.35 m/s^2 an axis leaves no sensor still: the mean over half seconds tells."""
    want = _bare(1.0)
    assert np.isnan(unit_checks.gravity_size(want.acc, want.rate_hz)).all()
    document = csv.FORMAT.read(_undeclared(tmp_path, _bare(acc)), NONE)
    np.testing.assert_allclose(_raw(document).acc, want.acc, rtol=1e-6, atol=1e-5)
    (said,) = [w for w in document.warnings if "unit of acc" in w]
    assert f"not declared; read as {unit} (" in said and "in the mean over half seconds" in said
    assert any("not gravity: only orientations could tell" in a for a in document.assumptions)


@pytest.mark.parametrize("acc", [0.01, 0.3, 6.0])
def test_csv_undeclared_units_that_fit_none(tmp_path: Path, acc: float) -> None:
    with pytest.raises(FormatError, match=r"in none of m/s.2, g, mg"):
        csv.FORMAT.read(_undeclared(tmp_path, _bare(acc)), NONE)


def test_csv_undeclared_without_gravity(tmp_path: Path) -> None:
    """What is left without gravity is about 1 m/s^2, and no gravity in g."""
    rec = synthesis.raw_recording(files.motion(T=600), files.LEGS, synthesis.Noise(), 1)
    assert rec.R_world_sensor is not None
    free = rec.acc - np.einsum("tsji,j->tsi", rec.R_world_sensor, [0, ori.GRAVITY, 0])
    bare = RawRecording(rec.rate_hz, rec.sensors, rec.gyr, free)
    with pytest.raises(FormatError, match="gravity was removed"):
        _physics.raw(tmp_path, bare)
    with pytest.raises(FormatError, match="gravity"):
        csv.FORMAT.read(_undeclared(tmp_path, bare), NONE)


def test_csv_without_gyr(tmp_path: Path) -> None:
    path = _undeclared(tmp_path, _bare(1.0))
    lines = [line.split(",") for line in path.read_text().splitlines()]
    keep = [i for i, c in enumerate(lines[0]) if "gyr" not in c]
    path.write_text("\n".join(",".join(cells[i] for i in keep) for cells in lines) + "\n")
    warnings = csv.FORMAT.read(path, NONE).warnings
    assert "no sample of gyr from any sensor" in warnings
    assert not any("unit of gyr" in w for w in warnings)


def test_csv_gaps_empty_cells_and_odd_columns(tmp_path: Path) -> None:
    rec = files.raw()
    lines = files.csv_lines(rec, rec.sensors)
    lines[1] += ",pelvis.temperature"
    lines[2:] = [line + ",warm" for line in lines[2:]]
    cells = lines[30].split(",")
    lines[30] = ",".join([cells[0], "", *cells[2:]])  # pelvis.acc_x of frame 28 is lost
    del lines[60:63]  # frames 58 to 60 are lost
    (tmp_path / "gap.csv").write_text("\n".join(lines) + "\n")
    document = csv.FORMAT.read(tmp_path / "gap.csv", NONE)
    have = _raw(document)
    assert len(have) == len(rec)
    lost = np.argwhere(~have.valid)
    assert {tuple(x) for x in lost} == {(28, 0)} | {(t, s) for t in (58, 59, 60) for s in range(5)}
    text = " ".join(document.warnings)
    assert "3 of 240 samples are missing" in text and "pelvis 4" in text
    assert "columns not read: pelvis.temperature" in text


def test_csv_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    rec = files.raw()
    lines = files.csv_lines(rec, rec.sensors)
    text = [lines[0], *(x.replace(",", ";").replace(".", ",") for x in lines[2:])]
    text.insert(1, lines[1].replace(",", ";"))
    (tmp_path / "de.csv").write_text("\n".join(text) + "\n")
    _same_raw(_raw(csv.FORMAT.read(tmp_path / "de.csv", NONE)), rec)


def test_csv_orientation_alone(tmp_path: Path) -> None:
    """Quaternions without acc and gyr: valid by their orientation, gyr from its rate."""
    rec = files.raw(("pelvis", "left_foot"))
    lines = files.csv_lines(rec, rec.sensors)
    keep = [i for i, c in enumerate(lines[1].split(",")) if "acc" not in c and "gyr" not in c]
    lines[1:] = [",".join(line.split(",")[i] for i in keep) for line in lines[1:]]
    (tmp_path / "o.csv").write_text("\n".join(lines) + "\n")
    have = _raw(csv.FORMAT.read(tmp_path / "o.csv", NONE))
    assert have.valid.all() and np.isnan(have.acc).all()
    np.testing.assert_allclose(have.gyr[1:], rec.gyr[1:], atol=1e-5)


# ---------------------------------------------------------------------------------------------- qmt


def test_qmt_finds_the_mounting(tmp_path: Path) -> None:
    """R_world_sensor comes back although the file holds only the segments' orientations."""
    want = files.raw(rate=100.0, T=400)
    document = qmt.FORMAT.read(files.qmt(tmp_path), NONE)
    have = _raw(document)
    assert have.start_s == 40.0 and have.valid.all()
    off = ori.angle_between(have.R_world_sensor, want.select(have.sensors).R_world_sensor)
    assert np.rad2deg(off.max()) < 0.1
    assert "0.0%" in document.assumptions[1]


def test_the_real_recording(shared: Path) -> None:
    """The person of the qmt example: still accelerations are upright to 1 deg, on every segment."""
    document = qmt.FORMAT.read(shared / "data/qmt-fullbody/full_body_example_data.mat", NONE)
    rec = _raw(document)
    assert rec.R_world_sensor is not None
    assert len(rec) == 10_000 and rec.rate_hz == 100.0 and rec.start_s == 40.0
    assert len(rec.sensors) == 16 and {"pelvis", "lower_back", "right_hand"} <= set(rec.sensors)
    still = slice(2000, 3000)  # t = 60 to 70 s
    force = np.einsum("tsij,tsj->tsi", rec.R_world_sensor[still], rec.acc[still]).mean(axis=0)
    assert (np.hypot(force[:, 0], force[:, 2]) < 0.05).all()
    assert ((force[:, 1] > 9.65) & (force[:, 1] < 10.2)).all()
    # gyr turns R_world_sensor: the residual of the fit is 0.8 to 4.1 %.
    for s in range(16):
        assert unit_checks.rate_ratio(rec, s) == pytest.approx(1, abs=0.05)
    # The file's filter settles within 0.25 s; everything after is valid.
    assert rec.valid[25:].all() and not rec.valid[:10].any()
    # At 44 s the person stands with the trunk's x axes at about -107 deg.
    assert rec.facing_rad == pytest.approx(np.deg2rad(-107), abs=0.1)


# ------------------------------------------------------------------------------- OpenSense and MTw


def test_sto(tmp_path: Path) -> None:
    want = files.raw()
    document = opensense.FORMAT.read(files.sto(tmp_path), NONE)
    have = _raw(document)
    assert have.sensors == want.sensors and have.valid.all() and np.isnan(have.acc).all()
    np.testing.assert_allclose(have.R_world_sensor, want.R_world_sensor, atol=1e-9)
    np.testing.assert_allclose(have.gyr[1:], want.gyr[1:], atol=1e-6)


def test_mtw_folder(tmp_path: Path) -> None:
    document = xsens_mtw.FORMAT.read(files.mtw(tmp_path), NONE)
    _same_raw(_raw(document), files.raw(), 1e-5)
    assert document.warnings == ()


def test_mtw_lost_packets_and_late_starts(tmp_path: Path) -> None:
    """Frames are aligned by packet: a sensor that starts late and loses packets stays in step."""
    folder = files.mtw(tmp_path)
    path = folder / "MT_trial_00B40001.txt"
    lines = path.read_text().splitlines()
    del lines[103:106]  # packets of frames 100 to 102
    del lines[3:8]  # starts 5 frames later
    path.write_text("\n".join(lines) + "\n")
    document = xsens_mtw.FORMAT.read(folder, NONE)
    have, want = _raw(document), files.raw().slice(5, 240)
    assert len(have) == 235
    s = have.sensors.index("left_thigh")
    assert np.flatnonzero(~have.valid[:, s]).tolist() == [95, 96, 97]
    assert have.valid.sum() == have.valid.size - 3
    np.testing.assert_allclose(
        have.acc[have.valid], want.select(have.sensors).acc[have.valid], atol=1e-4
    )
    assert any("left_thigh 3" in w for w in document.warnings)


def test_mtw_names_by_the_user(tmp_path: Path) -> None:
    path = files.mtw(tmp_path) / "MT_trial_00B40002.txt"
    document = xsens_mtw.FORMAT.read(path, Options(mapping={"_00B40002": "left_wrist"}))
    assert document.content.sensors == ("left_wrist",)  # type: ignore[union-attr]


def test_names_from_a_file(tmp_path: Path) -> None:
    """A JSON object, or OpenSim's mapping file, names the sensors of any format."""
    path = files.csv_wide(tmp_path)
    (tmp_path / "names.json").write_text('{"pelvis": "lower_back"}')
    document = csv.FORMAT.read(path, Options(mapping=tmp_path / "names.json"))
    assert _raw(document).sensors[0] == "lower_back"
    xml = files.mtw(tmp_path) / "mapping.xml"
    document = opensense.FORMAT.read(files.sto(tmp_path), Options(mapping=xml))
    assert _raw(document).sensors == files.LEGS
    (tmp_path / "names.json").write_text('["pelvis"]')
    with pytest.raises(FormatError, match="not a JSON object of sensor names"):
        csv.FORMAT.read(path, Options(mapping=tmp_path / "names.json"))


def test_the_real_opensense_files(shared: Path) -> None:
    document = xsens_mtw.FORMAT.read(shared / "data/opensense", NONE)
    rec = _raw(document)
    assert set(rec.sensors) == {
        "sternum", "pelvis", *(f"{s}_{p}" for s in ("left", "right") for p in ("thigh", "shank", "foot"))
    }  # fmt: skip
    assert rec.rate_hz == 100.0 and rec.valid.all() and rec.R_world_sensor is not None
    force = np.einsum("tsij,tsj->tsi", rec.R_world_sensor, rec.acc).mean(axis=0)
    np.testing.assert_allclose(force, np.tile([0, 9.8, 0], (8, 1)), atol=0.15)
    sto = _raw(opensense.FORMAT.read(shared / "data/opensense/imuOrientations.sto", NONE))
    assert set(sto.sensors) == set(rec.sensors) and len(sto) == 2


# --------------------------------------------------------------------------------------------- mvnx


def test_mvnx(tmp_path: Path) -> None:
    document = mvnx.FORMAT.read(files.mvnx(tmp_path), NONE)
    rec = document.content
    assert isinstance(rec, Recording) and rec.reference is not None
    motion = files.mvn_motion()
    want = synthesis.recording(motion, tuple(files.MVN_SENSORS.values()))
    assert rec.sensors == want.sensors and rec.rate_hz == files.RATE
    assert np.rad2deg(ori.angle_between(rec.R_world_bone, want.R_world_bone)).max() < 0.01
    np.testing.assert_allclose(rec.acc_world[1:-1], want.acc_world[1:-1], atol=1e-4)
    assert (
        np.rad2deg(ori.angle_between(rec.reference.R_world_joint, motion.R_world_joint)).max()
        < 0.01
    )
    np.testing.assert_allclose(rec.reference.p_world_root, motion.p_world_root, atol=1e-4)
    assert rec.reference.skeleton.stature == pytest.approx(motion.skeleton.stature, abs=1e-4)


def test_mvnx_without_sensors_is_a_motion(tmp_path: Path) -> None:
    (tmp_path / "m.mvnx").write_text(files.mvnx_text(sensors=False))
    document = mvnx.FORMAT.read(tmp_path / "m.mvnx", NONE)
    assert isinstance(document.content, Motion)
    np.testing.assert_allclose(
        document.content.p_world_joint, files.mvn_motion().p_world_joint, atol=1e-4
    )


# ---------------------------------------------------------------------------------- DIP, TotalCapture


def _recording(document: Document) -> Recording:
    assert isinstance(document.content, Recording)
    return document.content


def test_dip_pickle(tmp_path: Path) -> None:
    document = dip.FORMAT.read(files.dip(tmp_path), NONE)
    have, want = _recording(document), files.recording(files.DIP_17)
    assert have.sensors == files.DIP_17 and have.rate_hz == 60
    np.testing.assert_allclose(have.R_world_bone, want.R_world_bone, atol=1e-9)
    np.testing.assert_allclose(have.acc_world, want.acc_world, atol=1e-9)
    assert have.reference is not None and want.reference is not None
    np.testing.assert_allclose(
        have.reference.R_world_joint, want.reference.R_world_joint, atol=1e-9
    )
    assert np.ptp(have.reference.p_world_root, axis=0).max() == 0


def test_dip_dropouts(tmp_path: Path) -> None:
    """NaN orientation and acceleration: invalid there, counted, and nowhere else."""
    data = files.dip_data()
    data["imu_ori"][50:60, 3] = np.nan
    data["imu_acc"][50:60, 3] = np.nan
    document = dip.FORMAT.read(files.dip(tmp_path, data), NONE)
    have = _recording(document)
    assert np.argwhere(~have.valid).tolist() == [[t, 3] for t in range(50, 60)]
    assert (
        "10 of 4080 samples" in document.warnings[0]
        and "left_shoulder_blade 10" in document.warnings[0]
    )


def test_dip_release(tmp_path: Path) -> None:
    path = files.dip_npz(tmp_path)
    document = dip.FORMAT.read(path, NONE)
    have, want = _recording(document), files.recording(files.SIX).slice(1, 239)
    to_root = np.swapaxes(want.R_world_bone[:, 5:], -1, -2)
    np.testing.assert_allclose(have.R_world_bone, to_root @ want.R_world_bone, atol=1e-9)
    assert have.reference is not None and want.reference is not None
    major = list(dip.JOINTS_15)
    np.testing.assert_allclose(
        have.reference.R_parent_joint[:, major], want.reference.R_parent_joint[:, major], atol=1e-9
    )
    assert len(dip.read_release(path)) == 2
    assert document.warnings == ("2 sequences in the file; only the first is read",)


def test_totalcapture(tmp_path: Path) -> None:
    """The files' conventions undone: bones, and accelerations without gravity, come back."""
    document = totalcapture.FORMAT.read(files.totalcapture(tmp_path), NONE)
    have = _recording(document)
    want = files.recording(tuple(files.TC_SENSORS.values()))
    assert have.sensors == want.sensors
    assert np.rad2deg(ori.angle_between(have.R_world_bone, want.R_world_bone)).max() < 0.001
    np.testing.assert_allclose(have.acc_world[1:-1], want.acc_world[1:-1], atol=1e-4)
    assert document.warnings == ()


def test_totalcapture_without_calibration_is_raw(tmp_path: Path) -> None:
    document = totalcapture.FORMAT.read(files.totalcapture(tmp_path, calibrated=False), NONE)
    rec = _raw(document)
    assert rec.R_world_sensor is not None and rec.mag is not None
    force = np.einsum("tsij,tsj->tsi", rec.R_world_sensor, rec.acc)[:60]
    np.testing.assert_allclose(force, np.broadcast_to([0, ori.GRAVITY, 0], force.shape), atol=1e-3)
    assert "no calibration files" in document.warnings[0]


def test_totalcapture_pickle(tmp_path: Path) -> None:
    """Legs first in the file, forearms first here."""
    document = totalcapture.FORMAT.read(files.tc_pkl(tmp_path), NONE)
    have, want = _recording(document), files.recording(files.SIX).slice(0, 239)
    assert have.sensors == files.SIX and len(have) == 239
    np.testing.assert_allclose(have.R_world_bone, want.R_world_bone, atol=1e-9)
    np.testing.assert_allclose(have.acc_world[1:-1], want.acc_world[1:-1], atol=1e-9)
    assert "lengths differ by 1" in document.warnings[0]


def test_pickles_are_told_apart(tmp_path: Path) -> None:
    for path, module in ((files.dip(tmp_path), dip), (files.tc_pkl(tmp_path), totalcapture)):
        found = [m for m in (dip, totalcapture) if m.FORMAT.sniff(path, path.read_bytes()[:4096])]
        assert found == [module]


@pytest.mark.parametrize("kind", ["qmt", "csv", "sto"])
def test_a_mapping_of_a_sensor_that_is_not_there(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if kind == "qmt":
        path = request.getfixturevalue("shared") / "data/qmt-fullbody/full_body_example_data.mat"
    elif kind == "sto":
        path = files.sto(tmp_path)
    else:
        path = tmp_path / "a.csv"
        path.write_text("t,pelvis.acc_x,pelvis.acc_y,pelvis.acc_z\n0,0,9.81,0\n0.01,0,9.81,0\n")
    with pytest.raises(FormatError, match=r"has no sensor 'foo' to map; it has \w+"):
        formats.read(path, Options(mapping={"foo": "pelvis"}))
