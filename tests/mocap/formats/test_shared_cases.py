"""Small files of the field, as other programs write them: each gives its right value."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Document, Options
from mocap.motion import Motion
from mocap.recording import RawRecording


@pytest.fixture(scope="session")
def cases(shared: Path) -> Path:
    folder = shared / "cases"
    if not folder.is_dir():
        pytest.skip("shared/ holds no folder cases")
    return folder


def motion(path: Path, options: Options | None = None) -> tuple[Motion, Document]:
    doc = formats.read(path, options)
    assert isinstance(doc.content, Motion)
    return doc.content, doc


def table(path: Path, options: Options | None = None) -> tuple[RawRecording, Document]:
    doc = formats.read(path, options)
    assert isinstance(doc.content, RawRecording)
    return doc.content, doc


def lean_deg(m: Motion) -> np.ndarray:
    return np.asarray(np.degrees(np.arccos(np.clip(m.R_world_joint[:, 0, 1, 1], -1, 1))))


def turn_deg(m: Motion, joint: int) -> np.ndarray:
    """Angle of a joint's world rotation from that of frame 0."""
    R = m.R_world_joint[:, joint]
    return np.asarray(np.degrees(ori.angle_between(R[:1], R)))


NAMED = (
    "actor", "cmu", "reallusion", "org", "optitrack", "smpl_m", "deepmotion", "japanese", "theia", "unity",
)  # fmt: skip


@pytest.mark.parametrize("tool", NAMED)
def test_the_same_motion_under_every_tools_names(cases: Path, tool: str) -> None:
    got, doc = motion(cases / "names" / f"{tool}.bvh")
    want, _ = motion(cases / "names" / "mixamo.bvh")
    assert (len(got), got.rate_hz) == (30, 30)
    apart = ori.angle_between(got.R_world_joint, want.R_world_joint)
    assert np.degrees(apart).max() < 0.01
    np.testing.assert_allclose(got.p_world_root, want.p_world_root, atol=1e-6)
    assert any("is left_hip" in told for told in doc.assumptions)


def test_a_hierarchy_from_the_head_turns_its_pelvis(cases: Path) -> None:
    got, _ = motion(cases / "bvh" / "rooted_at_head.bvh")
    pelvis = turn_deg(got, 0)
    assert pelvis[0] == pytest.approx(0, abs=1e-4)
    assert pelvis[-1] == pytest.approx(40, abs=1.1)
    assert (np.diff(pelvis) > 0).all()
    assert turn_deg(got, 9).max() < 0.01


@pytest.mark.parametrize(
    ("name", "up", "height_m"),
    [("bvh/51_yrest_zmotion.bvh", "z", 1.54), ("amass/yup.npz", "y", 1.5)],
)
def test_another_axis_points_up(cases: Path, name: str, up: str, height_m: float) -> None:
    lying, doc = motion(cases / name)
    assert lean_deg(lying).min() > 80
    assert any("--up y or --up z" in told for told in doc.warnings)
    standing, doc = motion(cases / name, Options(up=up))  # type: ignore[arg-type]
    assert lean_deg(standing).max() < 5
    assert np.ptp(standing.p_world_joint[0, :, 1]) == pytest.approx(height_m, abs=0.05)
    assert not any("never upright" in told for told in doc.warnings)


SAME = {
    "10_frames_plus1": "'Frames:' line says 31",
    "25_all6_zero": "OFFSETs hold",
    "41_dupnames": "",
    "47_wrapped_rows": "",
    "17_ft_ms": "read as milliseconds",
}


@pytest.mark.parametrize("name", SAME)
def test_odd_bvh_files_are_the_plain_one(cases: Path, name: str) -> None:
    got, doc = motion(cases / "bvh" / f"{name}.bvh")
    want, _ = motion(cases / "bvh" / "00_base.bvh")
    assert (len(got), got.rate_hz) == (len(want), want.rate_hz) == (30, 30)
    np.testing.assert_allclose(got.R_world_joint, want.R_world_joint, atol=1e-6)
    np.testing.assert_allclose(got.p_world_root, want.p_world_root, atol=1e-6)
    assert SAME[name] in " ".join((*doc.assumptions, *doc.warnings))


def test_a_rounded_frame_time_is_60_hz(cases: Path) -> None:
    got, _ = motion(cases / "bvh" / "frame_time_0.0167.bvh")
    assert (got.rate_hz, len(got)) == (60, 30)


FORCE = (0.117279, 9.741081, 1.216522)  # of the first row of most tables: m/s^2, with gravity
RATE = (0.002367, 0.000751, 0.027747)  # rad/s
FREE = (-0.034948, 0.003926, 0.053284 + ori.GRAVITY)  # of those without gravity, in a z-up world
TABLES = {
    "dot_exporter.csv": (60.0, FORCE),
    "free.csv": (60.0, FREE),
    "free_declared.csv": (60.0, FREE),
    "jitter.csv": (60.0, FORCE),
    "sensorlog.csv": (60.0, FORCE),
    "tab_comma.csv": (60.0, FORCE),
    "trail.csv": (60.0, FORCE),
    "WristMotion.csv": (60.0, FORCE),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_one_sensor(cases: Path, name: str) -> None:
    got, _ = table(cases / "csv" / name)
    rate, force = TABLES[name]
    assert len(got) == 600
    assert got.rate_hz == pytest.approx(rate, rel=2e-4)
    assert got.valid.all()
    np.testing.assert_allclose(got.acc[0, 0], force, rtol=5e-4, atol=1e-3)
    np.testing.assert_allclose(got.gyr[0, 0], RATE, atol=1e-5)


def test_a_custom_dot_export_of_one_device(cases: Path) -> None:
    got, doc = table(cases / "csv" / "dot_custom.csv", Options(mapping={"Xsens DOT 1": "pelvis"}))
    assert (doc.format, got.sensors, got.rate_hz, len(got)) == ("xsens_dot", ("pelvis",), 60, 600)
    assert not any("no place of the table" in told for told in doc.warnings)
    assert np.linalg.norm(got.acc[:, 0], axis=1).mean() == pytest.approx(ori.GRAVITY, abs=0.2)


def test_a_clock_that_wanders_has_no_gaps(cases: Path) -> None:
    got, doc = table(cases / "csv" / "wandering_clock.csv")
    assert (got.rate_hz, len(got)) == (pytest.approx(100, rel=1e-4), 6000)
    assert got.valid.all()
    assert any("wanders" in told for told in doc.warnings)


def test_jitter_is_told(cases: Path) -> None:
    _, doc = table(cases / "csv" / "jitter.csv")
    assert any("jitter" in told for told in doc.warnings)


@pytest.mark.parametrize(
    ("name", "app", "needed"),
    [
        ("Accelerometer.csv", "Sensor Logger", "Gyroscope and Orientation"),
        ("phyphox_acc.csv", "phyphox", "Gyroscope"),
    ],
)
def test_an_acceleration_alone_says_what_else_to_record(
    cases: Path, name: str, app: str, needed: str
) -> None:
    with pytest.raises(FormatError, match=needed) as e:
        formats.read(cases / "csv" / name)
    assert app in str(e.value)


SMPL = {"p66": 120.0, "t523": 120.0, "split": 120.0, "fps": 30.0, "gvhmr": 30.0, "aist": 60.0}


@pytest.mark.parametrize("name", SMPL)
def test_smpl_motions_under_other_names_and_shapes(cases: Path, name: str) -> None:
    """Joint by joint the rotation vectors of the file; the root turned from z-up to y-up where it is."""
    path = cases / "amass" / f"{name}.npz"
    rate = SMPL[name]
    got, _ = motion(path, Options(rate_hz=rate) if name in ("gvhmr", "aist") else None)
    assert (got.rate_hz, len(got)) == (rate, 120)
    with np.load(path, allow_pickle=False) as data:
        fields = {k: data[k] for k in data.files}
    for names in (
        ("poses",),
        ("root_orient", "pose_body"),
        ("smpl_poses",),
        ("global_orient", "body_pose"),
    ):
        if set(names) <= set(fields):
            vectors = np.concatenate([fields[k].reshape(120, -1) for k in names], axis=1)
    body = ori.exp(vectors.reshape(120, -1, 3))[:, 1:22]
    assert np.degrees(ori.angle_between(got.R_parent_joint[:, 1:22], body)).max() < 0.01


@pytest.mark.parametrize("name", ["aist", "gvhmr"])
def test_smpl_motions_without_a_rate_ask_for_it(cases: Path, name: str) -> None:
    with pytest.raises(FormatError, match="--rate HZ"):
        formats.read(cases / "amass" / f"{name}.npz")
