"""What came is kept: rows as a raw recording, which calibrates and plays as the session did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap import calibration, sensors, synthesis
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.formats import read
from mocap.recording import RawRecording
from mocap.synthesis import motions
from poser.live.assembler import Row
from poser.live.packets import Packet
from poser.live.recorder import Recorder
from poser.live.sources.playback import Playback
from tests.poser.live.sources.conftest import Time
from tests.poser.live.test_alignment import rows

# The heading walks in orientations alone, not in rates: here rates are made of orientations.
QUIET = synthesis.Noise(loss=0.02, heading_walk_deg=0.0)


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    motion = motions.joined([motions.stand(2.0), motions.walk(3.0)])
    return synthesis.raw_recording(motion, sensors.SIX, QUIET, rng=3)


def kept(path: Path, some: list[Row], own: bool = False) -> RawRecording:
    recorder = Recorder(path, sensors.SIX, 60.0, own)
    for row in some:
        recorder.take([row])
    recorder.close()
    content = read(path).content
    assert isinstance(content, RawRecording)
    return content


def test_rows_come_back_as_they_were_measured(raw: RawRecording, tmp_path: Path) -> None:
    back = kept(tmp_path / "r.npz", rows(raw))
    assert back.common_heading and back.sensors == raw.sensors and len(back) == len(raw)
    np.testing.assert_allclose(back.acc, raw.acc, atol=1e-4)
    np.testing.assert_allclose(back.R_world_sensor, raw.R_world_sensor, atol=1e-6)
    seen = back.valid & raw.valid
    seen[1:] &= seen[:-1]  # the first sample behind a gap has no sample before it
    np.testing.assert_allclose(back.gyr[seen], raw.gyr[seen], atol=1e-3)
    assert (back.valid <= raw.valid).all() and back.valid.mean() > raw.valid.mean() - 0.01


def test_it_calibrates_as_the_measurement_does(raw: RawRecording, tmp_path: Path) -> None:
    _, found = calibration.calibrate(kept(tmp_path / "r.npz", rows(raw)), at=1.0, facing=0.0)
    _, expected = calibration.calibrate(raw, at=1.0, facing=0.0)
    off = ori.angle_between(found.R_bone_sensor, expected.R_bone_sensor)
    assert np.rad2deg(off).max() < 0.3


def test_rows_that_were_left_out_and_headings(raw: RawRecording, tmp_path: Path) -> None:
    some = [row for k, row in enumerate(rows(raw)) if not 100 <= k < 130]
    back = kept(tmp_path / "r.npz", some, own=True)
    assert not back.common_heading
    assert len(back) == len(raw) and not back.valid[100:130].any()
    assert list(tmp_path.iterdir()) == [tmp_path / "r.npz"]


def test_without_a_row_there_is_no_file(tmp_path: Path) -> None:
    Recorder(tmp_path / "r.npz", sensors.SIX, 60.0).close()
    assert list(tmp_path.iterdir()) == []


def played(raw: RawRecording, seconds: float, again: bool = False) -> list[Packet]:
    time = Time()

    def sleep(s: float) -> None:
        time.now += s

    playback = Playback(raw, time, again, sleep)
    playback.open()
    found: list[Packet] = []
    until = time.now + seconds
    while time.now < until and not playback.ended:
        found += [p for p, _, _ in playback.receive(0.002)]
    return found


def test_a_recording_is_played_at_its_own_pace(raw: RawRecording) -> None:
    assert raw.R_world_sensor is not None
    found = played(raw, 1.0)
    assert 59 <= max(p.seq or 0 for p in found) <= 61
    for p in found[:50]:
        k, s = round(p.time_s * 60), raw.sensors.index(p.device)
        np.testing.assert_allclose(p.R_world_sensor, raw.R_world_sensor[k, s])
    whole = played(raw, 100.0)
    assert len(whole) == np.isfinite(raw.R_world_sensor).all((-1, -2)).sum()


def test_again_and_again(raw: RawRecording) -> None:
    short = raw.slice(0, 30)
    found = played(short, 2.0, again=True)
    assert max(p.time_s for p in found) > 1.9
    assert len({p.time_s for p in found}) >= 118


def test_without_orientations_it_cannot_be_played(raw: RawRecording) -> None:
    with pytest.raises(PoserError, match="holds no orientations"):
        Playback(replace(raw, R_world_sensor=None))
