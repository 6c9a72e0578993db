"""Each command end to end, through main(argv)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import sensors
from mocap.errors import SensorError
from mocap.evaluation import metrics
from mocap.formats import amass, bvh, native
from mocap.synthesis import motions
from poser import comparison, options
from poser.__main__ import main
from poser.commands import demo
from poser.console import UsageError

Answer = Callable[..., Any]
Refusal = Callable[..., tuple[int, str]]


def test_info_of_a_motion(folder: Path, answer: Answer) -> None:
    facts = answer("info", folder / "walk.npz")
    assert (facts["kind"], facts["format"], facts["rate_hz"]) == ("motion", "amass", 60.0)
    assert (facts["frames"], facts["seconds"], facts["sensors"]) == (180, 3.0, [])


def test_info_of_a_recording_counts_its_gaps(folder: Path, answer: Answer) -> None:
    facts = answer("info", folder / "rec" / "walk.npz")
    assert facts["kind"] == "recording"
    assert facts["has_reference"] is True
    assert len(facts["sensors"]) == 6
    valid = native.read_recording(folder / "rec" / "walk.npz").valid
    assert sum(g["frames"] for g in facts["gaps"]) == (~valid).sum() > 0
    for gap in facts["gaps"]:
        assert gap["longest_seconds"] == pytest.approx(gap["longest_frames"] / 60)


def test_gaps_are_told_of_what_is_used_and_once(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = native.read_recording(folder / "rec" / "walk.npz")
    cut = whole.select(("right_forearm", "pelvis")).slice(60, 180)
    lost = (~cut.valid).sum(axis=0)
    assert 0 < lost.sum() < (~whole.valid).sum()
    by = ", ".join(f"{n} {k}" for n, k in zip(cut.sensors, lost, strict=True) if k)
    rec, out = str(folder / "rec" / "walk.npz"), ["-o", str(tmp_path / "m.npz")]
    part = ["--from", "1", "--to", "3", "--sensors", "right_forearm,pelvis"]
    fast = ["--solver", "banded"]
    for words in (
        ["solve", rec, *out, *fast, *part],
        ["compare", rec, "-o", str(tmp_path / "c"), "--methods", "sip", *fast, *part],
    ):
        capsys.readouterr()
        assert main(words) == 0
        told = [n for n in capsys.readouterr().err.splitlines() if "samples are missing" in n]
        (line,) = told
        assert f"walk.npz, 1 to 3 s: {lost.sum()} of 240 samples are missing" in line
        assert f"({by})" in line
    assert main(["info", rec]) == 0
    said = capsys.readouterr().out
    assert "gaps of pelvis" in said and "samples are missing" not in said


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("notes.txt", "is none of the .txt files that are read: Xsens MT Manager and DOT exports (col"),
        ("table.csv", "tables with columns such as pelvis.acc_x"),
        ("x.npz", "poser's recordings (field schema); AMASS motions (field poses); DIP-IMU"),
        ("x.sto", "is none of the .sto files that are read: OpenSense tables"),
        ("x.doc", "suffix '.doc' unknown; known: .amc"),
    ],
)  # fmt: skip
def test_a_file_of_another_kind_is_told_what_is_read(
    name: str, said: str, tmp_path: Path, refusal: Refusal
) -> None:
    (tmp_path / name).write_text("shopping: milk, bread\n")
    status, sentence = refusal("info", tmp_path / name)
    assert status == 1 and said in sentence and str(tmp_path / name) in sentence


def test_every_format_has_its_signs() -> None:
    from mocap import formats

    for fmt in formats.registry():
        assert fmt.sign and fmt.about and fmt.kinds, fmt.name
        assert len(fmt.about) < 80
        assert fmt.readable or fmt.write, fmt.name


def test_info_for_people(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(folder / "raw" / "long.npz")]) == 0
    out = capsys.readouterr().out
    assert "raw (native)" in out and "660 frames at 60 Hz" in out


def test_convert_there_and_back(folder: Path, tmp_path: Path) -> None:
    there, back = tmp_path / "w.bvh", tmp_path / "w.npz"
    assert main(["convert", str(folder / "walk.npz"), str(there)]) == 0
    assert main(["convert", str(there), str(back)]) == 0
    a, b = amass.read_motion(folder / "walk.npz"), amass.read_motion(back)
    assert np.abs(a.p_world_joint - b.p_world_joint).max() < 1e-5


def test_convert_resamples_motions(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "slow.bvh"
    assert main(["convert", str(folder / "walk.npz"), str(out), "--resample", "30"]) == 0
    assert bvh.read(out, native.Options()).content.rate_hz == pytest.approx(30)


def test_convert_rate_is_for_files_that_state_none(
    folder: Path, tmp_path: Path, refusal: Refusal, capsys: pytest.CaptureFixture[str]
) -> None:
    """--rate declares; it must not slow a motion down that states its rate."""
    out, own = tmp_path / "out.npz", tmp_path / "own.bvh"
    assert main(["convert", str(folder / "walk.npz"), str(own)]) == 0
    for stated in (folder / "walk.npz", own):
        status, said = refusal("convert", stated, out, "--rate", "30")
        assert status == 2 and "states 60 Hz itself; --resample 30 writes" in said
        assert not out.exists()
        assert main(["convert", str(stated), str(out), "--rate", "60"]) == 0
        out.unlink()
    with np.load(folder / "walk.npz") as f:
        np.savez(tmp_path / "bare.npz", **{k: f[k] for k in f if k != "mocap_framerate"})
    assert main(["convert", str(tmp_path / "bare.npz"), str(out), "--rate", "30"]) == 0
    assert amass.read_motion(out).rate_hz == 30
    table = tmp_path / "t.csv"
    names = ("acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z")
    rows = "0,9.81,0,0,0.1,0\n0,9.8,0,0,0.2,0\n" * 150
    table.write_text("# rate_hz: 100\n" + ",".join(f"head.{n}" for n in names) + f"\n{rows}")
    capsys.readouterr()
    assert main(["convert", str(table), str(out), "--rate", "50"]) == 0
    assert "states 100 Hz, read as 50 Hz" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("source", "words", "said"),
    [
        ("raw/long.npz", ["--rate", "30"], "rate was given, but has no effect on this file"),
        ("walk.npz", ["--rate", "30"], "states 60 Hz, read as 30 Hz as was said"),
        ("walk.npz", ["--units", "g"], "units was given, but has no effect on this file"),
        ("walk.npz", ["--map", "a=head"], "mapping was given, but has no effect on this file"),
    ],
)
def test_options_of_reading_that_do_nothing_are_named(
    source: str, words: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(folder / source), *words]) == 0
    assert said in capsys.readouterr().out
    assert main(["info", str(folder / source)]) == 0
    assert said not in capsys.readouterr().out


def test_a_mapping_must_fit_the_file(
    folder: Path, refusal: Refusal, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = folder / "raw" / "long.npz"
    for words, said in (
        ("zzz=head", "has no sensor 'zzz' to map; it has left_forearm"),
        ("nofile.json", "nofile.json: no such file"),
        (folder / "walk.npz", "is no mapping for this kind of file"),
    ):
        status, sentence = refusal("info", raw, "--map", words)
        assert status == 1 and said in sentence
    capsys.readouterr()
    assert main(["info", str(raw), "--map", "head=sternum"]) == 0
    assert "sternum" in capsys.readouterr().out


def test_an_empty_list_of_sensors(folder: Path, tmp_path: Path, refusal: Refusal) -> None:
    """As an unset variable of a shell gives it: not all of them, not six."""
    words = ("-o", tmp_path / "m.npz", "--sensors", "")
    for command in (("solve", folder / "rec" / "walk.npz"), ("synthesize", folder / "walk.npz")):
        status, sentence = refusal(*command, *words)
        assert status == 2 and "argument --sensors: is empty" in sentence
    assert refusal("demo", "-o", tmp_path, "--seconds", "0.001")[0] == 2


@pytest.mark.parametrize(
    ("source", "target", "words", "said"),
    [
        ("rec/walk.npz", "x.bvh", [], "a .bvh file holds a motion"),
        ("rec/walk.npz", "x.npz", ["--resample", "30"], "--resample"),
        ("walk.npz", "x.txt", [], "must end in .npz or .bvh"),
        ("walk.npz", "none/x.bvh", [], "there is no folder"),
        ("absent.npz", "x.bvh", [], "no such file"),
        ("walk.npz", "x.bvh", ["--units", "g,m/s^2"], "exclude each other"),
        ("walk.npz", "x.bvh", ["--height", "180"], "between 0.5 and 2.6 m"),
    ],
)
def test_convert_refuses_nonsense(
    folder: Path, tmp_path: Path, refusal: Refusal, source: str, target: str, words: list[str],
    said: str,
) -> None:  # fmt: skip
    _, sentence = refusal("convert", folder / source, tmp_path / target, *words)
    assert said in sentence
    assert list(tmp_path.iterdir()) == []


def test_the_input_is_never_overwritten(folder: Path, refusal: Refusal) -> None:
    for words in (
        ("convert", folder / "walk.npz", folder / "walk.npz"),
        ("solve", folder / "rec" / "walk.npz", "-o", folder / "rec" / "walk.npz"),
        ("calibrate", folder / "raw" / "long.npz", "-o", folder / "raw" / "long.npz"),
        ("synthesize", folder / "walk.npz", "-o", folder),
    ):
        before = Path(words[1]).read_bytes()
        status, sentence = refusal(*words)
        assert status == 2
        assert "is the input" in sentence
        assert Path(words[1]).read_bytes() == before


def test_noise_depends_on_seed_and_name_only(folder: Path, tmp_path: Path) -> None:
    def acc(where: str, *words: str) -> np.ndarray:
        args = ["synthesize", *words, "-o", str(tmp_path / where), "--noise", "realistic"]
        assert main(args) == 0
        return native.read_recording(tmp_path / where / "walk.npz").acc_world

    walk, long = str(folder / "walk.npz"), str(folder / "long.npz")
    alone = acc("a", walk)
    np.testing.assert_array_equal(alone, acc("b", long, walk))
    other = acc("c", walk, "--seed", "1")
    assert np.nanmax(np.abs(alone - other)) > 0.5


def test_synthesize_sensors_rate_and_stem(folder: Path, tmp_path: Path, refusal: Refusal) -> None:
    args = ["synthesize", str(folder / "walk.npz"), "-o", str(tmp_path / "new" / "deep")]
    assert main([*args, "--sensors", "all", "--rate", "30", "--lowpass", "none"]) == 0
    made = native.read_recording(tmp_path / "new" / "deep" / "walk.npz")
    assert (len(made.sensors), made.rate_hz) == (17, 30.0)
    twin = tmp_path / "walk.npz"
    twin.write_bytes((folder / "walk.npz").read_bytes())
    status, sentence = refusal("synthesize", twin, *args[1:])
    assert status == 2
    assert "would both be written to walk.npz" in sentence
    assert main([*args[:2], "-o", str(tmp_path / "six")]) == 0
    assert native.read_recording(tmp_path / "six" / "walk.npz").sensors == sensors.SIX
    status, sentence = refusal(*args, "--sensors", "nose")
    assert status == 2
    assert "sensor nose unknown" in sentence


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("synthesize", "or names separated by commas (default: six)"),
        ("solve", "banded takes about 0.4 of the default's time with the sensors of a suit"),
    ],
)
def test_help_tells_what_happens_unasked(
    command: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, "--help"]) == 0
    assert said in " ".join(capsys.readouterr().out.split())


def test_one_bad_motion_does_not_stop_the_others(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY\nnonsense\n")
    words = ["synthesize", str(bad), str(folder / "walk.npz"), "-o", str(tmp_path / "out")]
    assert main(words) == 1
    assert str(bad) in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["walk.npz"]


def test_an_unknown_option_is_told_by_its_command(refusal: Refusal) -> None:
    status, said = refusal("solve", "a.npz", "-o", "b.npz", "--sensros", "six")
    assert status == 2
    assert said.strip() == (
        "poser solve: unrecognized arguments: --sensros six; did you mean --sensors? "
        "(see poser solve --help)"
    )
    assert "poser info: unrecognized arguments: b (see" in refusal("info", "a", "b")[1]


def test_a_folder_of_which_nothing_comes_does_not_stay(
    folder: Path, tmp_path: Path, refusal: Refusal
) -> None:
    out = tmp_path / "a" / "b"
    walk = folder / "walk.npz"
    assert refusal("compare", walk, "-o", out)[0] == 1
    (tmp_path / "bad.bvh").write_text("HIERARCHY\n")
    assert main(["synthesize", str(tmp_path / "bad.bvh"), "-o", str(out)]) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["bad.bvh"]
    out.mkdir(parents=True)
    assert refusal("compare", walk, "-o", out)[0] == 1
    assert out.is_dir()  # was there before


def test_synthesize_searches_folders(
    folder: Path, tmp_path: Path, refusal: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep, empty = tmp_path / "mots" / "deep", tmp_path / "empty"
    deep.mkdir(parents=True)
    empty.mkdir()
    (deep / "walk.npz").write_bytes((folder / "walk.npz").read_bytes())
    assert main(["convert", str(folder / "walk.npz"), str(tmp_path / "mots" / "other.bvh")]) == 0
    (deep / "rec.npz").write_bytes((folder / "rec" / "walk.npz").read_bytes())
    native.write_motion(deep / "solved.npz", motions.squat(2.0))  # as solve and track write them
    monkeypatch.chdir(tmp_path / "mots")
    for given, out in (((".",), "v2"), ((tmp_path / "mots",), "v3"), ((".", "other.bvh"), "v5")):
        assert main(["synthesize", *map(str, given), "-o", str(tmp_path / out)]) == 0
        made = {p.name for p in (tmp_path / out).iterdir()}
        assert made == {"walk.npz", "other.npz", "solved.npz"}
    status, said = refusal("synthesize", empty, "-o", tmp_path / "v4")
    assert status == 1 and f"no motion file in {empty}" in said
    assert not (tmp_path / "v4").exists()


@pytest.mark.parametrize(
    ("command", "option", "words"),
    [
        ("solve", "--start", "--start takes prior, horizon, dip, imuposer or a motion file"),
        ("compare", "--reference", "--reference takes sip-all or a motion file"),
    ],
)
def test_the_words_that_are_taken_beside_files_are_told(
    command: str, option: str, words: str, folder: Path, tmp_path: Path, refusal: Refusal
) -> None:
    line = (folder / "rec" / "walk.npz", "-o", tmp_path / "o.npz", option, "bogus")
    status, said = refusal(command, *line)
    assert status == 1 and f"poser {command}: bogus: no such file; {words}" in said


def test_synthesize_static_seconds_of_no_pose(
    folder: Path, tmp_path: Path, refusal: Refusal
) -> None:
    words = ("synthesize", folder / "walk.npz", "-o", tmp_path / "r", "--static-seconds", "5")
    status, said = refusal(*words)
    assert status == 2 and "without --static-pose" in said
    assert list(tmp_path.iterdir()) == []


def test_a_static_pose_is_prepended_and_calibrates(folder: Path, tmp_path: Path) -> None:
    args = ["synthesize", str(folder / "walk.npz"), "-o", str(tmp_path), "--raw"]
    assert main([*args, "--static-pose", "t", "--static-seconds", "2"]) == 0
    raw = native.read_raw(tmp_path / "walk.npz")
    assert raw.seconds == pytest.approx(6.0, abs=0.05)
    assert raw.reference is not None
    hands = raw.reference.p_world_joint[10, [20, 21]]
    assert np.abs(hands[:, 0]).min() > 0.6
    words = ["calibrate", str(tmp_path / "walk.npz"), "-o", str(tmp_path / "rec.npz")]
    assert main([*words, "--pose", "t"]) == 0


def test_calibrate_finds_the_bones(folder: Path, tmp_path: Path, answer: Answer) -> None:
    out = tmp_path / "rec.npz"
    said = answer("calibrate", folder / "raw" / "long.npz", "-o", out, "--facing", "0")
    assert said["method"] == "facing as given"
    assert said["has_reference"] is True
    recording = native.read_recording(out)
    assert recording.reference is not None
    true = recording.reference.R_world_joint[:, recording.joint]
    use = recording.ori_valid
    cosine = np.einsum("tsij,tsij->ts", true, recording.R_world_bone)[use] / 2 - 0.5
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).mean() < 15


def test_calibrate_for_people(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["calibrate", str(folder / "raw" / "long.npz"), "-o", str(tmp_path / "r.npz")]
    assert main([*words, "--axis", "pelvis=x forward", "--no-strict"]) == 0
    assert "facing: axis x forward of pelvis (to " in capsys.readouterr().out
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "N-pose at" in out and "facing: hinge of the shank (to " in out


def test_calibrate_at_a_time_of_walking(
    folder: Path, tmp_path: Path, answer: Answer, refusal: Refusal
) -> None:
    words = ("calibrate", folder / "raw" / "long.npz", "-o", tmp_path / "r.npz", "--at", "5")
    status, said = refusal(*words)
    assert status == 1 and "long.npz: the wearer moves at the time of the pose, 4.7" in said
    assert list(tmp_path.iterdir()) == []
    codes = {f["code"]: f["severity"] for f in answer(*words, "--no-strict")["diagnostics"]}
    assert codes["pose-not-still"] == "error"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--axis", "pelvis"], "is not SENSOR=AXIS DIRECTION"),
        (["--axis", "pelvis=x up"], "directions: forward, left, back, right"),
        (["--axis", "head=x left", "--axis", "head=y forward"], "one axis a sensor"),
        (["--arm-angle", "170"], "between 0 and 100 deg"),
        (["--second", "t"], "POSE@SECONDS"),
        (["--at", "soon"], "is not a number"),
        (["--pose", "t", "--arm-angle", "80"], "--arm-angle"),
    ],
)
def test_calibrate_wrong_usage(
    folder: Path, tmp_path: Path, refusal: Refusal, words: list[str], said: str
) -> None:
    status, sentence = refusal(
        "calibrate", folder / "raw" / "long.npz", "-o", tmp_path / "r.npz", *words
    )
    assert status == 2
    assert said in sentence


def test_solve_says_how_it_went(folder: Path, tmp_path: Path, answer: Answer) -> None:
    out = tmp_path / "sop.npz"
    said = answer(
        "solve", folder / "rec" / "walk.npz", "-o", out, "--terms", "sop", "--uncertainty"
    )
    for key in ("status", "seconds", "iterations", "frames", "cost", "converged", "sigmas"):
        assert key in said
    assert said["frames"] == 180
    assert "acceleration" not in said["cost"]
    with np.load(out) as f:
        assert f["poses"].shape == (180, 156)
        assert f["std_rad"].shape == (180, 24, 3)
    shares = answer("evaluate", out, folder / "rec" / "walk.npz")
    assert 0 < shares["inside_1_sigma"] < shares["inside_2_sigma"] <= 1
    motion = amass.read_motion(out)
    assert motion.p_world_joint[0, [10, 11], 1].min() == pytest.approx(0.02, abs=1e-6)


def test_solve_a_window_with_some_sensors_from_a_motion(
    folder: Path, tmp_path: Path, answer: Answer
) -> None:
    said = answer(
        "solve", folder / "rec" / "walk.npz", "-o", tmp_path / "w.bvh", "--solver", "banded",
        "--sensors", "pelvis,head,left_shank", "--from", "1", "--to", "2", "--self-calibrate",
        "--start", folder / "sip.npz", "--height", "1.75", "--plot", tmp_path / "residuals.png",
    )  # fmt: skip
    assert (tmp_path / "residuals.png").read_bytes()[:4] == b"\x89PNG"
    assert said["frames"] == 60
    assert said["used_sensors"] == ["pelvis", "head", "left_shank"]
    assert list(said["sensors"]) == said["used_sensors"]


def test_solve_keeps_the_cheapest_of_several_starts(
    folder: Path, tmp_path: Path, answer: Answer, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = tmp_path / "a, b.npz"  # one start, though its name holds a comma
    odd.write_bytes((folder / "sip.npz").read_bytes())
    words = ["solve", folder / "rec" / "walk.npz", "--solver", "banded", "--to", "1.5"]
    said = answer(*words, "-o", tmp_path / "m.npz", "--start", f"prior,dip,{folder / 'sip.npz'}")
    tried = said["report"]["starts"]
    assert list(tried) == ["prior", "dip", str(folder / "sip.npz")]
    assert said["total_cost"] == min(x["cost"] for x in tried.values())
    assert said["total_cost"] == tried[said["report"]["start"]]["cost"]
    capsys.readouterr()
    line = [*words, "-o", tmp_path / "n.npz", "--start", odd]
    assert main([str(w) for w in line]) == 0
    assert "kept" not in capsys.readouterr().out
    assert main([str(w) for w in [*line[:-1], "prior,dip", "--self-calibrate"]]) == 2
    assert "self-calibrate" in capsys.readouterr().err


def test_solve_follows_a_recording_both_ways_for_its_start(
    folder: Path, tmp_path: Path, answer: Answer, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["solve", folder / "rec" / "walk.npz", "--solver", "banded", "--to", "1"]
    said = answer(*words, "-o", tmp_path / "m.npz", "--start", "horizon")
    tried = said["report"]["starts"]
    assert list(tried) == ["prior", "forward", "backward"]
    assert said["total_cost"] == min(x["cost"] for x in tried.values())
    line = [*words, "-o", tmp_path / "n.npz", "--start", "horizon", "--self-calibrate"]
    assert main([str(w) for w in line]) == 2
    assert "self-calibrate" in capsys.readouterr().err


def test_solve_hears_a_network(folder: Path, tmp_path: Path, answer: Answer) -> None:
    words = ["solve", folder / "rec" / "walk.npz", "--solver", "banded", "--to", "1"]
    alone = answer(*words, "-o", tmp_path / "a.npz")
    heard = answer(*words, "-o", tmp_path / "b.npz", "--prior", "network")
    assert "network" not in alone["cost"] and heard["cost"]["network"] > 0
    assert list(heard["report"]["starts"]) == ["prior", "dip"]
    watches = answer(
        *words, "-o", tmp_path / "c.npz", "--prior", "network", "--start", "prior",
        "--sensors", "left_forearm,head",
    )  # fmt: skip
    assert watches["cost"]["network"] > 0


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["--betas", "1,2"], 2, "--smpl"),
        (["--from", "7"], 1, "it runs from 0 s to 3 s"),
        (["--sensors", "left_foot"], 1, "not in the recording"),
        (["--start", "absent.npz"], 1, "absent.npz: no such file"),
        (["--start", "prior,,dip"], 2, "empty name"),
        (["--solver", "newton"], 2, "invalid choice"),
    ],
)
def test_solve_refuses(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], status: int,
    said: str,
) -> None:  # fmt: skip
    rec, out = str(folder / "rec" / "walk.npz"), str(tmp_path / "m.npz")
    assert main(["solve", rec, "-o", out, *words]) == status
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_solve_wants_a_calibrated_recording(folder: Path, tmp_path: Path, refusal: Refusal) -> None:
    status, sentence = refusal("solve", folder / "raw" / "long.npz", "-o", tmp_path / "m.npz")
    assert status == 1
    assert "poser calibrate" in sentence


@pytest.mark.parametrize(
    "words",
    [
        ("info", "FOLDER"),
        ("track", "FOLDER", "--method", "dip", "-o", "OUT"),
        ("evaluate", "walk.npz", "FOLDER"),
        ("evaluate", "walk.npz", "walk.npz", "--smpl", "FOLDER"),
        ("info", "walk.npz", "--smpl", "FOLDER"),
        ("track", "rec/walk.npz", "-o", "OUT", "--method", "dip", "--weights", "FOLDER"),
    ],
)
def test_a_folder_where_a_file_is_wanted(
    words: tuple[str, ...], folder: Path, tmp_path: Path, refusal: Refusal
) -> None:
    given = tmp_path / "given"
    given.mkdir()
    paths = {"FOLDER": given, "OUT": tmp_path / "out.npz"}
    files = {w: folder / w for w in words if w.endswith(".npz")}
    _, sentence = refusal(*(({**paths, **files}).get(w, w) for w in words))
    assert "given" in sentence and "is a folder, expected a file" in sentence


def test_a_recording_where_a_motion_is_wanted(
    folder: Path, tmp_path: Path, refusal: Refusal
) -> None:
    recording = native.read_recording(folder / "rec" / "walk.npz")
    native.write_recording(tmp_path / "bare.npz", replace(recording, reference=None))
    for source, hint in (
        (folder / "rec" / "walk.npz", "; poser compare writes the reference motion in it"),
        (folder / "raw" / "long.npz", "; once calibrated, poser compare writes the reference"),
        (tmp_path / "bare.npz", "expected a motion\n"),
    ):
        status, sentence = refusal("synthesize", source, "-o", tmp_path / "out")
        assert status == 1 and hint in sentence


def test_sets_and_names_of_sensors_may_be_mixed() -> None:
    assert options.sensors("six, left_foot") == (*sensors.SIX, "left_foot")
    assert options.sensors("head,five") == ("head", *(n for n in sensors.FIVE if n != "head"))
    assert options.sensors("head,all", ("nose", "head")) == ("head", "nose")
    assert options.sensors("all,lower_back") == (*sensors.SUIT, "lower_back")
    assert options.sensors(None, ("nose", "head")) == ("nose", "head")
    with pytest.raises(UsageError, match=r"sensor foo unknown; there is: pelvis, .*right_foot"):
        options.sensors("six,foo")
    with pytest.raises(SensorError, match=r"sensor foo not in the recording; there is: left_fore"):
        options.sensors("six,foo", sensors.SIX)
    with pytest.raises(SensorError, match="head twice"):
        options.sensors("head,head", sensors.SIX)


def test_evaluate_names_and_nulls(folder: Path, answer: Answer) -> None:
    found = answer("evaluate", folder / "sip.npz", folder / "rec" / "walk.npz")
    last = ("no_skill", "compared_s", "instrumented_sensors")
    assert tuple(found) == ("frames", "rate_hz", *metrics.JSON_NAMES[2:], *last)
    assert tuple(found["no_skill"]) == ("mean-pose", "nearest-pose")
    for other in found["no_skill"].values():
        assert other["sip_deg"] > found["sip_deg"] and other["frames"] == found["frames"]
    assert found["mesh_cm"] is None
    assert found["left_out_deg"] is None
    assert 0 < found["instrumented_deg"] < 30
    same = answer("evaluate", folder / "walk.npz", folder / "walk.npz")
    assert same["sip_deg"] == pytest.approx(0, abs=1e-5)
    assert same["world_position_cm"] == pytest.approx(0, abs=1e-6)


def test_evaluate_with_sensors_left_out(folder: Path, answer: Answer) -> None:
    found = answer(
        "evaluate", folder / "sip.npz", folder / "rec" / "walk.npz", "--sensors", "pelvis,head"
    )
    assert 0 < found["left_out_deg"] < 60


def test_evaluate_says_which_sensors_count(
    folder: Path, answer: Answer, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(folder / "sip.npz"), str(folder / "rec" / "walk.npz")]
    same = [paths[0], str(folder / "walk.npz"), "--recording", paths[1]]
    for words, names in (
        (paths, sensors.SIX),
        (same, sensors.SIX),
        ([*same, "--sensors", "head,pelvis"], ("head", "pelvis")),
        ([*same[:2], "--sensors", "head,pelvis"], ("head", "pelvis")),
        (same[:2], ()),
    ):
        assert answer("evaluate", *words)["instrumented_sensors"] == list(names)
        assert main(["evaluate", *words]) == 0
        told = "counts the bones of all 6 sensors of" in capsys.readouterr().err
        assert told == (names == sensors.SIX)


def test_evaluate_for_people(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["evaluate", str(folder / "sip.npz"), str(folder / "walk.npz")]) == 0
    out = capsys.readouterr().out
    assert "sip_deg" in out and "deg" in out and "cm" in out
    assert "mean pose" in out and "nearest pose" in out


def test_evaluate_refuses(folder: Path, refusal: Refusal) -> None:
    _, sentence = refusal("evaluate", folder / "sip.npz", folder / "long.npz")
    assert "sip.npz" in sentence and "one frame at most" in sentence
    _, sentence = refusal(
        "evaluate",
        folder / "long.npz",
        folder / "long.npz",
        "--recording",
        folder / "rec" / "walk.npz",
    )
    assert "walk.npz: lasts" in sentence and "a recording of that part" in sentence
    _, sentence = refusal("evaluate", folder / "rec" / "walk.npz", folder / "walk.npz")
    assert "expected a motion" in sentence


def test_demo(tmp_path: Path, answer: Answer) -> None:
    found = answer("demo", "-o", tmp_path / "d", "--seconds", "3")
    assert found["schema"] == "poser-compare/1"
    methods = {*comparison.METHODS, "mean-pose", "nearest-pose"}
    assert set(found["mean"]) == set(found["recordings"][0]["methods"]) == methods
    assert found == json.loads((tmp_path / "d" / "results.json").read_text())
    for name in (*methods, "reference"):
        assert len(amass.read_motion(tmp_path / "d" / f"{name}.npz")) == 180
    page = (tmp_path / "d" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert "http://" not in page and "https://" not in page
    assert (tmp_path / "d" / "poses.png").read_bytes().startswith(b"\x89PNG")


def test_demo_goes_on_without_a_method_that_cannot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "SHORTEST_S", 0.0)
    assert main(["demo", "-o", str(tmp_path), "--seconds", "0.02"]) == 0  # one frame
    said = json.loads((tmp_path / "results.json").read_text())["recordings"][0]
    assert "sop" not in said["methods"] and {"dip", "imuposer"} <= set(said["methods"])
    assert f"note: builtin, sop, sip: {said['failed']['sop']}\n" in capsys.readouterr().err
