"""MVNX with frames missing, cut out of a take, and with the accelerations of other versions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.motion import Motion
from mocap.recording import Recording
from tests.mocap.formats import recording_files as files

_FRAME = re.compile(r'<frame [^>]*type="normal">.*?</frame>')


def read(path: Path, text: str) -> tuple[Recording, tuple[str, ...]]:
    path.write_text(text)
    doc = formats.read(path)
    assert isinstance(doc.content, Recording)
    return doc.content, doc.warnings


def without(text: str, gone: set[int]) -> str:
    """The file without some of its normal frames."""
    count = iter(range(10**6))
    return _FRAME.sub(lambda m: "" if next(count) in gone else m[0], text)


def test_missing_frames_are_gaps(tmp_path: Path) -> None:
    text = files.mvnx_text()
    want, _ = read(tmp_path / "a.mvnx", text)
    gone = {50, 51, 52, 120}
    got, said = read(tmp_path / "b.mvnx", without(text, gone))
    assert len(got) == len(want)
    there = np.array([t not in gone for t in range(len(want))])
    assert not got.valid[~there].any() and (got.valid[there] == want.valid[there]).all()
    np.testing.assert_allclose(got.acc_world[there], want.acc_world[there], atol=1e-9)
    assert any("4 of" in s and "are missing" in s for s in said)
    # The reference, which has no holes, is bridged over them.
    assert got.reference is not None and want.reference is not None
    off = ori.angle_between(got.reference.R_parent_joint, want.reference.R_parent_joint)
    assert np.rad2deg(off[there].max()) < 1e-3 and np.rad2deg(off.max()) < 5


def test_beyond_a_long_gap_the_larger_part_is_kept(tmp_path: Path) -> None:
    text = files.mvnx_text()
    want, _ = read(tmp_path / "a.mvnx", text)
    got, said = read(tmp_path / "b.mvnx", without(text, set(range(30, 60))))
    assert len(got) == len(want) - 60
    assert got.start_s == pytest.approx(60 / want.rate_hz, abs=1e-6)
    assert got.reference is not None and got.reference.start_s == pytest.approx(got.start_s)
    np.testing.assert_allclose(got.acc_world[5:-5], want.acc_world[65:-5], atol=1e-9)
    assert any("frames 0 to 59" in s for s in said)


def test_a_part_of_a_take_states_its_time(tmp_path: Path) -> None:
    """Frames exported from 0.5 s on: so that they line up with a .bvh of the whole take."""
    got, _ = read(tmp_path / "b.mvnx", without(files.mvnx_text(), set(range(30))))
    assert got.start_s == pytest.approx(30 / got.rate_hz, abs=1e-3)


@pytest.mark.parametrize("reading", ["in the sensors' axes with", "world's axes with", "without"])
def test_the_accelerations_of_other_versions(tmp_path: Path, reading: str) -> None:
    text = files.mvnx_text()
    want, _ = read(tmp_path / "a.mvnx", text)
    quats = iter(re.findall("<sensorOrientation>(.*?)</sensorOrientation>", text))

    def written(m: re.Match[str]) -> str:
        a = np.array(m[1].split(), float).reshape(-1, 3)
        R = ori.from_quat(np.array(next(quats).split(), float).reshape(-1, 4))
        if "without" not in reading:
            a = a + np.array([0, 0, ori.GRAVITY])
        if "sensors" in reading:
            a = np.einsum("sji,sj->si", R, a)
        return f"<sensorAcceleration>{' '.join(f'{x:.7g}' for x in a.ravel())}</sensorAcceleration>"

    other = re.sub("<sensorFreeAcceleration>(.*?)</sensorFreeAcceleration>", written, text)
    got, said = read(tmp_path / "b.mvnx", other)
    assert any("sensorAcceleration is read as" in s and reading in s for s in said)
    np.testing.assert_allclose(got.acc_world, want.acc_world, atol=1e-4)


def test_orientations_alone_are_a_recording(tmp_path: Path) -> None:
    text = re.sub("<sensorFreeAcceleration>.*?</sensorFreeAcceleration>", "", files.mvnx_text())
    got, said = read(tmp_path / "b.mvnx", text)
    assert got.ori_valid.all() and not got.acc_valid.any()
    assert any("orientations alone" in s for s in said)


def test_a_take_without_sensors_is_bridged_too(tmp_path: Path) -> None:
    (tmp_path / "a.mvnx").write_text(without(files.mvnx_text(sensors=False), {40, 41}))
    motion = formats.read(tmp_path / "a.mvnx").content
    assert isinstance(motion, Motion) and len(motion) == len(files.motion())
