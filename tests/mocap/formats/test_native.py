"""The native recordings: what is written is what is read."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import synthesis
from mocap.errors import FormatError
from mocap.formats import Options
from mocap.formats.native import FORMAT, read_raw, read_recording, write_raw, write_recording
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.sensors import SIX
from mocap.skeleton import Skeleton
from mocap.synthesis import motions


def _motion(rng: np.random.Generator, T: int = 40, height: float | None = None) -> Motion:
    w = np.cumsum(rng.normal(0, 0.02, (T, 24, 3)), axis=0)
    return Motion(100.0, ori.exp(w), rng.normal(0, 0.5, (T, 3)), Skeleton.default(height))


def _recording(rng: np.random.Generator, height: float | None = None) -> Recording:
    motion = _motion(rng, height=height)
    R = motion.R_world_joint[:, [18, 19, 4, 5, 15, 0]]
    valid = rng.random((40, 6)) > 0.1
    return Recording(
        100.0,
        SIX,
        R,
        rng.normal(0, 3, (40, 6, 3)),
        valid,
        reference=motion,
        calibration={"method": "n-pose", "angles": np.arange(3.0)},
        noise={"seed": np.int64(3)},
        start_s=2.5,
        notes=("first", "second"),
    )


def _raw(rng: np.random.Generator) -> RawRecording:
    motion = _motion(rng)
    return RawRecording(
        100.0,
        ("a", "b"),
        rng.normal(0, 1, (40, 2, 3)),
        rng.normal(0, 1, (40, 2, 3)),
        mag=rng.normal(0, 1, (40, 2, 3)),
        R_world_sensor=motion.R_world_joint[:, :2],
        reference=motion,
        truth={"R_bone_sensor": np.eye(3)},
        start_s=40.0,
        facing_rad=0.3,
        common_heading=False,
    )


@pytest.mark.parametrize("height", [None, 1.83])
def test_a_recording_returns(
    rng: np.random.Generator, tmp_path: Path, height: float | None
) -> None:
    first = _recording(rng, height)
    write_recording(tmp_path / "r.npz", first)
    back = read_recording(tmp_path / "r.npz")
    assert back.rate_hz == first.rate_hz and back.sensors == first.sensors
    assert back.start_s == 2.5 and back.notes == first.notes
    assert (back.valid == first.valid).all() and (back.joint == first.joint).all()
    # float32 keeps 7 digits of a rotation's entries and of some 10 m/s^2.
    assert np.nanmax(ori.angle_between(back.R_world_bone, first.R_world_bone)) < 1e-6
    np.testing.assert_allclose(back.acc_world, first.acc_world, atol=1e-5)
    np.testing.assert_array_equal(back.placement, first.placement)
    assert back.calibration == {"method": "n-pose", "angles": [0.0, 1.0, 2.0]}
    assert back.noise == {"seed": 3}
    assert back.reference is not None and first.reference is not None
    # The reference's joints, so also its bone lengths, come back in full.
    np.testing.assert_allclose(
        back.reference.p_world_joint, first.reference.p_world_joint, atol=1e-9
    )


def test_the_file_is_the_contract(rng: np.random.Generator, tmp_path: Path) -> None:
    first = _recording(rng)
    write_recording(tmp_path / "r.npz", first)
    with np.load(tmp_path / "r.npz", allow_pickle=False) as f:
        assert str(f["schema"]) == "poser-recording/1"
        assert f["R_world_bone"].dtype == f["acc_world"].dtype == np.float32
        assert f["R_world_bone"].shape == (40, 6, 3, 3) and list(f["sensors"]) == list(SIX)
        assert f["poses"].shape == (40, 72) and f["poses"].dtype == np.float64
        assert first.reference is not None
        J0 = Skeleton.default().offsets[0]
        np.testing.assert_allclose(f["trans"] + J0, first.reference.p_world_root, atol=1e-12)


def test_raw_returns(rng: np.random.Generator, tmp_path: Path) -> None:
    first = _raw(rng)
    write_raw(tmp_path / "r.npz", first)
    back = read_raw(tmp_path / "r.npz")
    assert back.sensors == first.sensors and back.start_s == 40.0
    assert back.facing_rad == 0.3 and back.common_heading is False
    for name in ("gyr", "acc", "mag", "R_world_sensor"):
        np.testing.assert_allclose(getattr(back, name), getattr(first, name), atol=1e-6)
    assert back.truth == {"R_bone_sensor": np.eye(3).tolist()}
    assert back.reference is not None and first.reference is not None
    np.testing.assert_allclose(
        back.reference.p_world_joint, first.reference.p_world_joint, atol=1e-9
    )


def test_only_the_required_fields(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "r.npz",
        schema="poser-recording/1",
        rate_hz=60,
        sensors=["pelvis"],
        R_world_bone=np.tile(np.eye(3, dtype=np.float32), (5, 1, 1, 1)),
        acc_world=np.zeros((5, 1, 3), np.float32),
    )
    back = read_recording(tmp_path / "r.npz")
    assert back.valid.all() and back.joint[0] == 0 and back.reference is None
    np.testing.assert_allclose(back.placement[0], (0, 0.02, -0.12))


def test_a_reference_on_another_stature(rng: np.random.Generator, tmp_path: Path) -> None:
    write_recording(tmp_path / "r.npz", _recording(rng))
    doc = FORMAT.read(tmp_path / "r.npz", Options(height=2.0))
    assert isinstance(doc.content, Recording) and doc.content.reference is not None
    assert doc.content.reference.skeleton.stature == pytest.approx(2.0, abs=1e-9)


def test_the_other_schema_is_named(rng: np.random.Generator, tmp_path: Path) -> None:
    write_raw(tmp_path / "r.npz", _raw(rng))
    with pytest.raises(FormatError, match=r"schema is 'poser-raw/1', expected 'poser-recording/1'"):
        read_recording(tmp_path / "r.npz")
    assert FORMAT.read(tmp_path / "r.npz", Options()).kind == "raw"


def test_an_interrupted_write_leaves_the_old_file(
    rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_raw(tmp_path / "r.npz", _raw(rng))
    before = (tmp_path / "r.npz").read_bytes()

    def interrupted(f: object, **_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_raw(tmp_path / "r.npz", _raw(rng))
    assert (tmp_path / "r.npz").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.npz"]


def test_a_header_that_declares_more_than_there_is(tmp_path: Path) -> None:
    """Eight terabytes declared in the array's own header must not be allocated."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }\n"
    npy = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(tmp_path / "r.npz", "w") as z:
        z.writestr("schema.npy", npy)
    with pytest.raises(FormatError, match="declares 8000000000080 bytes"):
        FORMAT.read(tmp_path / "r.npz", Options())


def test_a_bomb(tmp_path: Path) -> None:
    """30 MB of zeros of a byte each, in 30 kB: the ratio is of what they become."""
    np.savez(tmp_path / "small.npz", schema="poser-raw/1", sensors=["a"], rate_hz=60.0)
    with (
        zipfile.ZipFile(tmp_path / "small.npz", "a", zipfile.ZIP_DEFLATED) as z,
        z.open("acc.npy", "w", force_zip64=True) as f,
    ):
        np.save(f, np.zeros((10 << 20, 1, 3), np.int8))
    with pytest.raises(FormatError, match="array 'acc': 240 MiB packed in"):
        FORMAT.read(tmp_path / "small.npz", Options())


def test_units_against_the_schema_are_read_where_they_are_said(tmp_path: Path) -> None:
    """A file that somebody wrote in g and deg/s: refused with the option's name, read with it."""
    raw = synthesis.raw_recording(
        motions.builtin(60.0, 8.0), ("pelvis", "head"), synthesis.Noise(), 0
    )
    path = tmp_path / "raw.npz"
    write_raw(path, replace(raw, acc=raw.acc / ori.GRAVITY, gyr=np.degrees(raw.gyr)))
    with pytest.raises(FormatError, match=r"--units g\)"):
        FORMAT.read(path, Options())
    again = FORMAT.read(path, Options(units=frozenset({"g", "deg/s"}))).content
    assert isinstance(again, RawRecording)
    np.testing.assert_allclose(again.acc, raw.acc, atol=1e-9)
    np.testing.assert_allclose(again.gyr, raw.gyr, atol=1e-9)
