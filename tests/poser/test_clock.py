"""When a motion was: kept from the recording to its files; what is compared of files of different times."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import sensors, synthesis
from mocap import timeline as clock
from mocap.errors import FormatError, PoserError, ShapeError
from mocap.evaluation import metrics
from mocap.formats import amass, native
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser import files
from poser.__main__ import main

Answer = Callable[..., Any]
Refusal = Callable[..., tuple[int, str]]
BANDED = ("--solver", "banded", "--terms", "sop")
START_S = 40.0


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rec.npz: 2 s at 50 Hz from 40 s on, six sensors. early.npz, late.npz: its first and its last second
    solved; mid.npz: 0.6 s of the middle. zero.npz: as rec.npz, but from 0 s on; zero_early.npz: its first
    second."""
    where = tmp_path_factory.mktemp("clock")
    walk = motions.walk(4.0, 50.0).slice(50, 150)
    recording = synthesis.recording(walk, sensors.SIX, synthesis.Noise(), 0)
    native.write_recording(where / "rec.npz", replace(recording, start_s=START_S))
    native.write_recording(where / "zero.npz", recording)
    for name, source, words in (
        ("early", "rec", ("--to", "41")),
        ("late", "rec", ("--from", "41")),
        ("mid", "rec", ("--from", "40.7", "--to", "41.3")),
        ("zero_early", "zero", ("--to", "1")),
    ):
        paths = [str(where / f"{source}.npz"), "-o", str(where / f"{name}.npz")]
        assert main(["solve", *paths, *BANDED, *words]) == 0
    return where


def test_a_motion_knows_its_time() -> None:
    whole = replace(motions.walk(3.0, 50.0), start_s=START_S)
    part = whole.slice(100, 140)
    assert part.start_s == pytest.approx(42.0)
    assert part.slice(-10, 40).start_s == pytest.approx(42.6)
    assert part.slice(20, 30).start_s == pytest.approx(42.4)
    body = Skeleton.default(1.9)
    for same in (
        part.resampled(60.0), part.lowpassed(8.0), part.turned(1.0), part.mirrored(), part.on(body)
    ):  # fmt: skip
        assert same.start_s == part.start_s
    assert motions.walk(3.0).start_s == 0
    with pytest.raises(ShapeError, match="start_s must be a finite number"):
        replace(whole, start_s=float("nan"))


def test_files_keep_it_and_older_ones_read_as_zero(tmp_path: Path) -> None:
    motion = replace(motions.walk(3.0), start_s=46.25)
    files.write(tmp_path / "new.npz", motion)
    amass.write_motion(tmp_path / "old.npz", motion)
    assert native.states_start(tmp_path / "new.npz")
    assert not native.states_start(tmp_path / "old.npz")
    assert files.motion(tmp_path / "new.npz").start_s == 46.25
    assert files.motion(tmp_path / "old.npz").start_s == 0
    # Whoever reads AMASS files reads it as well, and the two differ in nothing else.
    again = amass.read_motion(tmp_path / "new.npz")
    np.testing.assert_array_equal(again.poses, amass.read_motion(tmp_path / "old.npz").poses)
    files.write(tmp_path / "zero.npz", replace(motion, start_s=0.0), timed=True)
    assert native.states_start(tmp_path / "zero.npz")
    with np.load(tmp_path / "new.npz") as f:
        np.savez(tmp_path / "odd.npz", **{**f, "start_s": np.array(np.inf)})
    with pytest.raises(FormatError, match="start_s"):
        files.motion(tmp_path / "odd.npz")


def test_a_recording_s_reference_is_on_its_clock(place: Path) -> None:
    recording = files.recording(place / "rec.npz")
    assert recording.reference is not None
    assert recording.start_s == recording.reference.start_s == START_S
    cut = recording.slice(25, 75)
    assert cut.reference is not None
    assert cut.reference.start_s == cut.start_s == pytest.approx(40.5)


def test_what_is_shared() -> None:
    a = replace(motions.walk(3.0, 50.0), start_s=10.0)
    b = replace(motions.walk(3.0, 60.0), start_s=11.01)
    begin, end = clock.shared({Path("a"): a, Path("b"): b})
    assert (begin, end) == (11.01, 13.0)
    first, second = clock.cut(a, begin, end), clock.cut(b, begin, end)
    assert abs(first.start_s - second.start_s) <= 0.5 / 50
    assert abs(first.seconds - second.seconds) <= 0.5 / 50 + 0.5 / 60
    c = replace(b, start_s=20.0)
    with pytest.raises(PoserError, match=r"a covers 10 to 13 s, c covers 20 to 23 s: they have no"):
        clock.shared({Path("a"): a, Path("c"): c})


@pytest.mark.parametrize(
    ("name", "frames"), [("early", (0, 50)), ("late", (50, 100)), ("mid", (35, 65))]
)
def test_a_solve_of_a_part_is_evaluated_on_that_part(
    name: str, frames: tuple[int, int], place: Path, answer: Answer,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    estimate = files.motion(place / f"{name}.npz")
    recording = files.recording(place / "rec.npz").slice(*frames)
    expected = metrics.evaluate(estimate, recording.reference, recording=recording)
    found = answer("evaluate", place / f"{name}.npz", place / "rec.npz")
    assert found["frames"] == frames[1] - frames[0]
    assert found["sip_deg"] == pytest.approx(expected.sip_deg, abs=1e-9)
    assert found["instrumented_deg"] == pytest.approx(expected.instrumented_deg, abs=1e-9)
    assert found["compared_s"] == pytest.approx([START_S + k / 50 for k in frames])
    begin, end = found["compared_s"]
    assert main(["evaluate", str(place / f"{name}.npz"), str(place / "rec.npz")]) == 0
    said = capsys.readouterr().err
    assert f"rec.npz: of its 40 to 42 s, {begin:.2f} to {end:.2f} s are compared" in said


def test_a_solve_of_the_beginning_states_its_zero(place: Path, answer: Answer) -> None:
    found = answer("evaluate", place / "zero_early.npz", place / "zero.npz")
    assert (found["frames"], found["compared_s"]) == (50, [0.0, 1.0])


def test_the_recording_beside_a_reference_is_cut_as_well(
    place: Path, tmp_path: Path, answer: Answer
) -> None:
    recording = files.recording(place / "rec.npz")
    assert recording.reference is not None
    # Optical truth, frame for frame the recording's: it states no time, and needs none.
    amass.write_motion(tmp_path / "truth.npz", recording.reference)
    words = ("--recording", place / "rec.npz", "--sensors", "pelvis,head")
    found = answer("evaluate", place / "mid.npz", tmp_path / "truth.npz", *words)
    same = answer("evaluate", place / "mid.npz", place / "rec.npz", "--sensors", "pelvis,head")
    assert found["compared_s"] == same["compared_s"] == pytest.approx([40.7, 41.3])
    for name in ("frames", "sip_deg", "root_deg", "left_out_deg"):
        assert found[name] == pytest.approx(same[name], abs=1e-9)
    assert found["left_out_deg"] > 0


def test_parts_of_different_times_are_not_compared(
    place: Path, tmp_path: Path, answer: Answer, refusal: Refusal
) -> None:
    status, said = refusal("evaluate", place / "early.npz", place / "late.npz")
    assert status == 1
    assert "early.npz covers 40 to 41 s" in said and "late.npz covers 41 to 42 s" in said
    found = answer("evaluate", place / "mid.npz", place / "late.npz")
    assert (found["frames"], found["compared_s"]) == (15, pytest.approx([41.0, 41.3]))
    # Without a time only the lengths can tell.
    amass.write_motion(tmp_path / "old.npz", files.motion(place / "mid.npz"))
    _, said = refusal("evaluate", tmp_path / "old.npz", place / "rec.npz")
    assert "one frame at most" in said
    found = answer("evaluate", tmp_path / "old.npz", place / "mid.npz")
    assert found["compared_s"] is None and found["sip_deg"] == pytest.approx(0, abs=1e-5)


def test_other_commands_keep_it(place: Path, tmp_path: Path, answer: Answer) -> None:
    out = tmp_path / "slow.npz"
    assert main(["convert", str(place / "late.npz"), str(out), "--resample", "25"]) == 0
    facts = answer("info", out)
    assert (facts["start_s"], facts["rate_hz"]) == (pytest.approx(41.0), 25)
    assert main(["synthesize", str(place / "late.npz"), "-o", str(tmp_path / "s")]) == 0
    made = files.read(tmp_path / "s" / "late.npz").content
    assert isinstance(made, Recording) and made.reference is not None
    assert made.start_s == made.reference.start_s == pytest.approx(41.0)


def test_a_start_and_a_reference_are_taken_at_their_time(
    place: Path, tmp_path: Path, refusal: Refusal
) -> None:
    out, rec = ("-o", tmp_path / "o.npz"), place / "rec.npz"
    part = ("--from", "40.8", "--to", "41.2")
    words = ["solve", rec, *out, *BANDED, *part, "--start", place / "mid.npz"]
    assert main([str(w) for w in words]) == 0
    assert files.motion(tmp_path / "o.npz").start_s == pytest.approx(40.8)
    status, said = refusal(
        "solve", rec, *out, *BANDED, "--to", "40.6", "--start", place / "mid.npz"
    )
    assert status == 1 and "mid.npz: covers 40.7 to 41.3 s, but 40 to 40.6 s is wanted" in said
    compare = ("compare", rec, "-o", tmp_path / "c", "--methods", "sop", "--solver", "banded")
    assert main([str(w) for w in (*compare, *part, "--reference", place / "mid.npz")]) == 0
    record = json.loads((tmp_path / "c" / "results.json").read_text())
    assert record["recordings"][0]["methods"]["sop"]["frames"] == 20
    truth = files.motion(tmp_path / "c" / "reference.npz")
    assert "40.80 to 41.20 s" in (tmp_path / "c" / "report.html").read_text()
    expected: Motion = files.motion(place / "mid.npz").slice(5, 25)
    assert truth.start_s == pytest.approx(expected.start_s)
    np.testing.assert_allclose(truth.R_parent_joint, expected.R_parent_joint, atol=1e-9)
    assert files.motion(tmp_path / "c" / "sop.npz").start_s == pytest.approx(40.8)
    # Of the window's length, but of another time.
    words = [*compare, "--from", "40", "--to", "40.6", "--reference", place / "mid.npz"]
    status, said = refusal(*words)
    assert status == 1 and "--from and --to choose what it covers" in said
