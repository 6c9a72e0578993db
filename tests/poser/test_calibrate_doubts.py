"""What the reader doubts of a raw recording stands among the diagnostics of `poser calibrate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.formats import native
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, raw_recording
from mocap.synthesis.motions import builtin
from poser.__main__ import main


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    motion = builtin(60.0, 22.6).turned(0.7)
    return replace(raw_recording(motion, places.SIX, NOISES["none"], 0), reference=None)


def test_the_readers_doubts_are_diagnostics(
    raw: RawRecording, tmp_path: Path, answer: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert raw.R_world_sensor is not None
    R = np.array(raw.R_world_sensor)
    s = raw.sensors.index("head")
    R[:, s] = ori.rot_x(np.radians(20)) @ R[:, s]
    native.write_raw(tmp_path / "a.npz", replace(raw, R_world_sensor=R))
    words = ["calibrate", str(tmp_path / "a.npz"), "-o", str(tmp_path / "b.npz"), "--no-strict"]
    found = answer(*words)["diagnostics"]
    text = "sensor head: orientation turns the mean acceleration to"
    (doubt,) = [f for f in found if f["code"] == "not-upright"]
    assert doubt["severity"] == "warning" and doubt["sentence"].startswith("sensor head: ")
    assert text in doubt["sentence"] and doubt["sensor"] == "head"
    assert main(words) == 0
    assert "nothing doubtful" not in capsys.readouterr().out
    assert answer(*words, "--sensors", "pelvis,left_shank,right_shank")["diagnostics"] == []


def test_reversed_axes_are_refused_in_the_words_of_the_diagnostics(
    raw: RawRecording, tmp_path: Path, answer: Any, refusal: Any
) -> None:
    """The reader leaves it to the diagnostics, which know the cause, and --no-strict goes on."""
    acc = np.array(raw.acc)
    acc[:, raw.sensors.index("left_shank"), 1] *= -1
    native.write_raw(tmp_path / "a.npz", replace(raw, acc=acc))
    words = ("calibrate", tmp_path / "a.npz", "-o", tmp_path / "b.npz")
    status, said = refusal(*words)
    assert status == 1 and "sensor left_shank: " in said and "axis y of acc is reversed" in said
    found = answer(*words, "--no-strict")["diagnostics"]
    assert ("left_shank", "acc-axes", "error") in {
        (f["sensor"], f["code"], f["severity"]) for f in found
    }
    assert any("axis y of acc" in w for w in answer("info", tmp_path / "a.npz")["warnings"])


def test_a_transposed_orientation_is_named(
    raw: RawRecording, tmp_path: Path, refusal: Any, answer: Any
) -> None:
    assert raw.R_world_sensor is not None
    turned = replace(raw, R_world_sensor=np.swapaxes(raw.R_world_sensor, -1, -2))
    native.write_raw(tmp_path / "a.npz", turned)
    words = ("calibrate", tmp_path / "a.npz", "-o", tmp_path / "b.npz")
    status, said = refusal(*words)
    assert status == 1 and "sensor-from-world (transposed)" in said
    assert answer(*words, "--orientation", "vqf", "--no-strict")["orientation"] == "vqf"
