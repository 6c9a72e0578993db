"""`poser convert --reference`: a motion becomes what is true of a recording, for networks to learn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learned import checkpoint
from learned.models import build, for_network
from learned.training import validation
from mocap import sensors, synthesis
from mocap.formats import amass, native
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.synthesis import motions
from poser import files
from poser.__main__ import main

Answer = Callable[..., Any]
Refusal = Callable[..., tuple[int, str]]
START_S = 40.0
QUICK = ("--batch", "2", "--frames", "12", "--every", "2", "--steps", "2")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bare.npz: 2 s at 50 Hz from 40 s on, six sensors, no reference. true.npz: its motion, with its time;
    plain.npz and plain.bvh: without; raw.npz: raw; dip.safetensors: tiny, untrained."""
    where = tmp_path_factory.mktemp("references")
    walk = replace(motions.walk(4.0, 50.0).slice(50, 150), start_s=START_S)
    made = replace(synthesis.recording(walk, sensors.SIX), start_s=START_S, reference=None)
    native.write_recording(where / "bare.npz", made)
    native.write_motion(where / "true.npz", walk)
    amass.write_motion(where / "plain.npz", walk)
    assert main(["convert", str(where / "plain.npz"), str(where / "plain.bvh")]) == 0
    raw = synthesis.raw_recording(walk, sensors.SIX, synthesis.NOISES["none"])
    native.write_raw(where / "raw.npz", raw)
    torch.manual_seed(0)
    checkpoint.save(build(for_network("dip", hidden=8)), where / "dip.safetensors", {})
    return where


def put(place: Path, motion: Path, out: Path, *words: str) -> Recording:
    """bare.npz with this motion as its reference."""
    line = ["convert", str(place / "bare.npz"), "-o", str(out), "--reference", str(motion), *words]
    assert main(line) == 0
    made = files.read(out).content
    assert isinstance(made, Recording)
    return made


@pytest.mark.parametrize("name", ["true.npz", "plain.npz", "plain.bvh"])
def test_a_motion_of_any_format_becomes_the_reference(
    name: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made, walk = put(place, place / name, tmp_path / "with.npz"), files.motion(place / "true.npz")
    assert made.reference is not None
    assert (len(made), made.start_s) == (100, START_S)
    np.testing.assert_allclose(made.reference.R_parent_joint, walk.R_parent_joint, atol=1e-4)
    said = capsys.readouterr()
    assert f"with {place / name} as its reference" in said.out
    assert "kept" not in said.err and "is it the motion" not in said.err


def test_the_motion_is_taken_at_its_time_and_the_recordings_rate(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same walk at another rate, from between two frames of the recording to before its end."""
    walk = files.motion(place / "true.npz")
    fast = replace(motions.walk(4.0, 80.0).slice(101, 201), start_s=START_S + 21 / 80)
    native.write_motion(tmp_path / "fast.npz", fast)
    made = put(place, tmp_path / "fast.npz", tmp_path / "with.npz")
    # From 40.2625 to 41.5 s: frames 14 to 75.
    assert made.start_s == pytest.approx(40.28) and len(made) == 62
    assert "of its 40 to 42 s, 40.28 to 41.52 s are in" in capsys.readouterr().err
    assert made.reference is not None
    same: Motion = walk.slice(14, 76)
    np.testing.assert_allclose(made.reference.R_parent_joint, same.R_parent_joint, atol=0.02)
    np.testing.assert_allclose(made.reference.p_world_root, same.p_world_root, atol=0.01)


def test_what_does_not_go_together_is_refused(
    place: Path, tmp_path: Path, refusal: Refusal
) -> None:
    walk = files.motion(place / "true.npz")
    native.write_motion(tmp_path / "later.npz", replace(walk, start_s=50.0))
    amass.write_motion(tmp_path / "short.npz", walk.slice(0, 60))
    native.write_motion(tmp_path / "touching.npz", replace(walk, start_s=41.98))
    out = tmp_path / "with.npz"
    for source, motion, words in (
        ("bare.npz", tmp_path / "later.npz", "later.npz covers 50 to 52 s"),
        (
            "bare.npz",
            tmp_path / "short.npz",
            "short.npz does not state its time, so both must last",
        ),
        ("bare.npz", tmp_path / "touching.npz", "fewer than two frames"),
        ("bare.npz", place / "bare.npz", "holds a calibrated recording, expected a motion"),
        ("bare.npz", tmp_path / "no.npz", "no.npz: no such file"),
        ("true.npz", place / "true.npz", "holds a motion, expected a calibrated recording"),
        ("raw.npz", place / "true.npz", "holds a raw recording, expected a calibrated recording"),
    ):
        status, said = refusal("convert", place / source, "-o", out, "--reference", motion)
        assert status == 1 and words in said, said
    status, said = refusal("convert", place / "bare.npz", "-o", tmp_path / "x.bvh", "--reference",
                           place / "true.npz")  # fmt: skip
    assert status == 2 and "must end in .npz" in said
    assert not out.exists()


def test_a_motion_that_faces_elsewhere_is_told(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    native.write_motion(tmp_path / "turned.npz", files.motion(place / "true.npz").turned(1.6))
    put(place, tmp_path / "turned.npz", tmp_path / "with.npz")
    said = capsys.readouterr().err
    assert "does it face the same way?" in said and "is replaced" not in said
    again = ["convert", str(tmp_path / "with.npz"), str(tmp_path / "again.npz"), "--reference"]
    assert main([*again, str(place / "true.npz")]) == 0
    said = capsys.readouterr().err
    assert "with.npz: the reference motion that it holds is replaced" in said
    assert "does it face the same way?" not in said


def test_the_output_is_said_once(place: Path, tmp_path: Path, refusal: Refusal) -> None:
    status, said = refusal("convert", place / "true.npz")
    assert status == 2 and "OUT (or -o OUT)" in said
    both = (tmp_path / "a.npz", "-o", tmp_path / "b.npz")
    assert refusal("convert", place / "true.npz", *both)[0] == 2
    slow = ["convert", str(place / "true.npz"), "--resample", "25", str(tmp_path / "slow.npz")]
    assert main(slow) == 0 and files.motion(tmp_path / "slow.npz").rate_hz == 25
    status, said = refusal(*slow, tmp_path / "other.npz")
    assert status == 2 and "unrecognized arguments" in said


@pytest.mark.parametrize("solved", [False, True])
def test_from_a_recording_without_a_reference_to_a_network(
    solved: bool, place: Path, tmp_path: Path, answer: Answer, refusal: Refusal,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    torch.set_num_threads(1)
    monkeypatch.setattr(validation, "MOST_WINDOWS", {"dip": 12, "imuposer": 12})
    line = ("-o", tmp_path / "run", "--start", place / "dip.safetensors", *QUICK)
    status, said = refusal("finetune", "dip", place / "bare.npz", *line)
    bare = place / "bare.npz"
    assert (
        status == 1 and f"poser convert {bare} -o WITH.npz --reference MOTION puts one in" in said
    )
    motion = place / "true.npz"
    if solved:
        motion = tmp_path / "solved.npz"
        words = ["-o", str(motion), "--solver", "banded", "--terms", "sop"]
        assert main(["solve", str(bare), *words]) == 0
    put(place, motion, tmp_path / "with.npz")
    assert answer("finetune", "dip", tmp_path / "with.npz", *line)["step"] == 2


def test_the_same_frames_go_together_whatever_a_file_rounds(place: Path, tmp_path: Path) -> None:
    """A frame time of five decimals is a frame off after 100 s; as many frames are the same ones."""
    text = (place / "plain.bvh").read_text()
    (line,) = (row for row in text.splitlines() if row.startswith("Frame Time"))
    rounded = tmp_path / "rounded.bvh"
    rounded.write_text(text.replace(line, "Frame Time: 0.020012"))
    made, walk = put(place, rounded, tmp_path / "with.npz"), files.motion(place / "true.npz")
    assert made.reference is not None and len(made) == 100
    np.testing.assert_allclose(made.reference.R_parent_joint, walk.R_parent_joint, atol=1e-4)


def test_a_motion_keeps_that_it_begins_at_zero(place: Path, tmp_path: Path) -> None:
    native.write_motion(tmp_path / "part.npz", motions.walk(4.0, 50.0))
    assert (
        main(
            ["convert", str(tmp_path / "part.npz"), str(tmp_path / "slow.npz"), "--resample", "25"]
        )
        == 0
    )
    assert native.states_start(tmp_path / "slow.npz")
    assert (
        main(["convert", str(place / "plain.npz"), str(tmp_path / "free.npz"), "--resample", "25"])
        == 0
    )
    assert not native.states_start(tmp_path / "free.npz")
