"""Detection of recording formats, and the checks their readers share: units, axes, time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import calibration, formats, synthesis
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Options, _physics, opensense
from mocap.recording import RawRecording
from mocap.words import sentence
from tests.mocap.formats import recording_files as files

# ---------------------------------------------------------------------------------------- detection


OURS = (
    "native", "dip", "totalcapture", "qmt", "opensense", "xsens_mtw", "mvnx", "csv",
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("native", files.native_recording), ("native", files.native_raw), ("dip", files.dip),
        ("dip", files.dip_npz), ("totalcapture", files.totalcapture),
        ("totalcapture", files.tc_pkl), ("qmt", files.qmt), ("opensense", files.sto),
        ("xsens_mtw", files.mtw), ("xsens_mtw", lambda d: files.mtw(d) / "MT_trial_00B40001.txt"),
        ("mvnx", files.mvnx), ("csv", files.csv_wide), ("csv", files.csv_folder),
    ],
)  # fmt: skip
def test_detection(
    name: str, write: Callable[[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Suffix and content name the format, also of folders whose name has a dot."""
    monkeypatch.setattr(formats, "_MODULES", OURS)
    path = write(tmp_path)
    if path.is_dir():
        path = path.rename(path.with_name("session.v2"))
    assert formats.detect(path).name == name
    doc = formats.read(path)
    assert doc.format == name
    assert doc.kind in formats.detect(path).kinds


@pytest.mark.parametrize(
    "suffix", [".npz", ".pkl", ".mat", ".sto", ".txt", ".mvnx", ".csv", ".sensors", ".x"]
)
def test_strangers(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other content under a known suffix, an unknown suffix, nothing at all: one sentence each."""
    monkeypatch.setattr(formats, "_MODULES", OURS)
    path = tmp_path / f"file{suffix}"
    for content, message in (
        (b"hello", "that are read|unknown"),
        (b"", "the file is empty"),
    ):
        path.write_bytes(content)
        with pytest.raises(FormatError, match=message):
            formats.read(path)
    path.unlink()
    with pytest.raises(FormatError, match="no such file"):
        formats.read(path)


# ------------------------------------------------------------------------------------------- checks


@pytest.mark.parametrize("seed", range(3))
def test_realistic_noise_raises_no_alarm(tmp_path: Path, seed: int) -> None:
    """Noise of the size that real sensors have is no contradiction; lost samples are reported."""
    noise = synthesis.Noise()
    moving = files.motion(T=600)
    for doubts in (
        _physics.raw(tmp_path, synthesis.raw_recording(moving, files.DIP_17, noise, seed)),
        _physics.calibrated(tmp_path, synthesis.recording(moving, files.DIP_17, noise, seed)),
    ):
        assert [f.code for f in doubts] == ["missing-samples"]


def test_a_spike_is_told_and_blamed_on_nothing_else(tmp_path: Path) -> None:
    rec = synthesis.raw_recording(files.motion(T=600), files.LEGS, synthesis.Noise(), 1)
    rec = replace(rec, valid=np.ones_like(rec.valid), gyr=np.nan_to_num(rec.gyr), mag=None)
    acc = rec.acc.copy()
    acc[400, 3] = 1e6
    for R in (rec.R_world_sensor, None):
        doubts = _physics.raw(tmp_path, replace(rec, acc=acc, R_world_sensor=R))
        (odd,) = [f for f in doubts if f.code != "missing-samples"]
        said = sentence(odd)
        assert said.startswith("sensor left_shank: 1 sample beyond what sensors can measure")
        assert "the first at 6.67 s: acc 1e+06 m/s^2" in said


def test_a_sensor_without_acc_is_told(tmp_path: Path) -> None:
    rec = files.raw(T=600)
    acc = rec.acc.copy()
    acc[:, 1] = np.nan
    told = _physics.raw(tmp_path, replace(rec, acc=acc))
    assert list(map(sentence, told)) == ["no sample of acc from left_thigh"]


@pytest.mark.parametrize("noise", [None, synthesis.Noise()])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: -a, "acc_world: opposite to what the reference motion gives"),
        (lambda a: 1000 * a, "in cm/s.2 or mg"),
        (lambda a: a + np.array([0, ori.GRAVITY, 0]), "gravity must be removed$"),
        (lambda a: a + np.array([0, 0, ori.GRAVITY]), "removed, and it should be along .y"),
        (lambda a: a + np.array([20.0, 0, 0]), "neither gravity nor movement"),
    ],
)
def test_what_is_wrong_with_acc_world(
    tmp_path: Path, noise: synthesis.Noise | None, change: Callable, message: str
) -> None:
    """The cause that is named is the one there is, with and without a reference."""
    rec = synthesis.recording(files.motion(T=600), files.DIP_17, noise, 1)
    wrong = replace(rec, acc_world=change(rec.acc_world))
    with pytest.raises(FormatError, match=message):
        _physics.calibrated(tmp_path, wrong)
    if "reference" not in message:
        with pytest.raises(FormatError, match=message):
            _physics.calibrated(tmp_path, replace(wrong, reference=None))


def test_a_table_of_orientations_can_be_calibrated(tmp_path: Path) -> None:
    """`.sto` has no accelerations, yet its orientations make a recording for SOP."""
    rec = opensense.FORMAT.read(files.sto(tmp_path), Options()).content
    assert isinstance(rec, RawRecording)
    have, _ = calibration.calibrate(rec, pose="t", at=0.5, facing=0.0, strict=False)
    want = files.recording(rec.sensors)
    assert have.ori_valid.all() and not have.acc_valid.any()
    assert np.rad2deg(ori.angle_between(have.R_world_bone, want.R_world_bone)).max() < 0.05
