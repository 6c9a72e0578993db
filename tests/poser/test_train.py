"""`poser train` and `poser finetune` end to end, on tiny networks."""

from __future__ import annotations

import json
import os
import signal
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learned import checkpoint
from learned.training import corpus
from learned.training import trainer as train
from learned.training.export import PRECISION_ONLINE
from mocap import sensors, synthesis
from mocap.formats.bvh import write_motion as write_bvh
from mocap.formats.native import write_recording
from mocap.synthesis import generated, motions
from poser import training, training_collections
from poser.__main__ import main
from poser.commands import train as train_command
from tests.poser.runs import SMALL, three_clips, together

Answer = Callable[..., Any]
Refusal = Callable[..., tuple[int, str]]
pytestmark = pytest.mark.usefixtures("small_runs")


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as AMASS has it: motions two folders deep, and a shape file that is none."""
    top = tmp_path_factory.mktemp("amass")
    three_clips([top / f"subject{k}" / "deep" for k in range(3)])
    np.savez(top / "subject0" / "shape.npz", betas=np.zeros(10))
    return top


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of a full suit at 100 Hz, with their reference."""
    top = tmp_path_factory.mktemp("recordings")
    for k, make in enumerate((motions.squat, motions.arm_raises, motions.leg_raise)):
        motion = make(2.0, rate_hz=100.0)
        made = synthesis.recording(motion, (*sensors.SUIT, "left_wrist", "right_wrist",
                                            "left_pocket", "right_pocket"))  # fmt: skip
        write_recording(top / f"take{k}.npz", made)
    return top


@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_train_resume_export(
    clips: Path, tmp_path: Path, answer: Answer, capsys: pytest.CaptureFixture[str], network: str
) -> None:
    out, weights = tmp_path / "run", tmp_path / "w.safetensors"
    words = ["train", network, clips, "-o", out, *SMALL]
    first = answer(*words, "--steps", "4")
    assert (first["step"], first["begun_at_step"], first["network"]) == (4, 0, network)
    assert first["validation"]["validation_sip_deg"] > 0
    assert first["data"]["clips"] == 2 and first["data"]["validation_clips"] == 1
    # The same command goes on; more steps are no other settings.
    again = answer(*words, "--steps", "6", "--export", weights, "--plot", tmp_path / "log.png")
    assert (again["step"], again["begun_at_step"]) == (6, 4)
    model = checkpoint.load(weights, network)
    assert model.config.hidden == 8
    card = weights.with_suffix(".md").read_text()
    assert "motions of the user" in card and "| sip_deg |" in card
    # The figures are not those of the default runtime: the card says so, and where the difference is told.
    assert PRECISION_ONLINE in card and "single precision from these half-precision" in card
    record = checkpoint.describe(weights)
    assert record["validation"]["sip_deg"] == again["exported_validation"]["sip_deg"]
    assert (tmp_path / "log.png").read_bytes()[:4] == b"\x89PNG"
    # For people: the held-out clip is named, the shape file counted.
    capsys.readouterr()
    assert main([str(w) for w in [*words, "--steps", "8"]]) == 0
    said = capsys.readouterr()
    assert "goes on at step 6" in said.out and "validation sip" in said.out
    assert "every tenth motion by name, 1 of them (clip0)" in said.err
    assert "1 files in the folders are no motions" in said.err


def broken(clips: Path, top: Path) -> Path:
    """The clips' motions in a folder, and by name before them one cut short and one that is not finite."""
    top.mkdir()
    for path in clips.rglob("clip*.npz"):
        (top / path.name).write_bytes(path.read_bytes())
    whole = (top / "clip0.npz").read_bytes()
    (top / "a-cut.npz").write_bytes(whole[: len(whole) // 2])
    with np.load(top / "clip1.npz") as fields:
        np.savez(top / "b-nan.npz", **(dict(fields) | {"trans": fields["trans"] * np.nan}))
    return top


def test_broken_files_in_folders_are_left_out(
    clips: Path, tmp_path: Path, answer: Answer, capsys: pytest.CaptureFixture[str]
) -> None:
    """By name the first validates: of those that can be read."""
    top = broken(clips, tmp_path / "m")
    words = ["train", "dip", top, *SMALL, "--steps", "2", "-o", tmp_path / "r"]
    data = answer(*words)["data"]
    assert (data["clips"], data["validation_clips"], data["left_out"]) == (2, 1, 2)
    capsys.readouterr()
    assert main([str(w) for w in words]) == 0
    said = capsys.readouterr().err
    assert "2 files in the folders cannot be read and were left out" in said
    assert "a-cut.npz" in said and "b-nan.npz" in said and "1 of them (clip0)" in said
    # As if they were not there: the same run goes on, on the same motions.
    for name in ("a-cut.npz", "b-nan.npz"):
        (top / name).unlink()
    assert answer(*words)["begun_at_step"] == 2


def test_a_broken_file_that_the_user_names_is_an_error(
    clips: Path, tmp_path: Path, refusal: Refusal
) -> None:
    top = broken(clips, tmp_path / "m")
    for words in ([top, top / "a-cut.npz"], [clips, "--validation", top / "a-cut.npz"]):
        _, said = refusal("train", "dip", *words, *SMALL, "--steps", "2", "-o", tmp_path / "r")
        assert "a-cut.npz" in said
    only = tmp_path / "only"
    only.mkdir()
    (top / "b-nan.npz").rename(only / "b-nan.npz")
    _, said = refusal("train", "dip", only, *SMALL, "--steps", "2", "-o", tmp_path / "r")
    assert "none of the motions can be read" in said and "b-nan.npz" in said


def test_no_more_validation_files_are_read_than_are_looked_at(
    clips: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train_command, "VALIDATED", 1)
    first, *others = sorted(clips.rglob("clip*.npz"))
    words = ["train", "dip", first, "--validation", *others, *SMALL, "--steps", "2"]
    assert answer(*words, "-o", tmp_path / "r")["data"]["validation_clips"] == 1


def test_the_corpus_is_gone_while_training(
    clips: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would double the memory: windows are drawn from splines."""
    made, left = corpus.cached, []
    run = train.Trainer.run

    def watched(found: Any) -> corpus.Corpus:
        c = made(found)
        left.append(weakref.ref(c.q))
        return c

    def looked(self: train.Trainer, progress: Any = None) -> Path:
        assert [ref() for ref in left] == [None]
        return run(self, progress)

    monkeypatch.setattr(corpus, "cached", watched)
    monkeypatch.setattr(train.Trainer, "run", looked)
    words = ["train", "dip", clips, *SMALL, "--steps", "2", "--share", "0.5"]
    assert answer(*words, "-o", tmp_path / "r")["step"] == 2 and left


def test_the_covariance_is_of_the_share_that_was_learnt(
    clips: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of one stem, as AMASS has them, are not taken for each other."""
    for k, path in enumerate(sorted(clips.rglob("clip*.npz"))):
        (tmp_path / "m" / str(k)).mkdir(parents=True)
        (tmp_path / "m" / str(k) / "clip.npz").write_bytes(path.read_bytes())
    cut, shown = training_collections.windows, []

    def watched(network: str, paths: Any) -> Any:
        shown.append(sorted(p.parent.name for p in paths))
        return cut(network, paths)

    monkeypatch.setattr(training_collections, "windows", watched)
    words = ["train", "dip", tmp_path / "m", *SMALL, "--steps", "2"]
    for share in ("1", "0.5"):
        out = tmp_path / f"r{share}"
        answer(*words, "-o", out, "--share", share, "--export", out.with_suffix(".safetensors"))
    assert shown[:3] == [["0"], ["1", "2"], ["0"]]
    assert shown[3] in (["1"], ["2"])


def test_a_motion_found_twice_does_not_validate_what_it_trains(
    clips: Path, tmp_path: Path, answer: Answer, refusal: Refusal
) -> None:
    """The same clip by another folder, as a copy of another name: of three motions one validates."""
    copy = tmp_path / "clip0-again.npz"
    copy.write_bytes((clips / "subject0" / "deep" / "clip0.npz").read_bytes())
    words = ["train", "dip", clips, clips / "subject0", copy, *SMALL, "--steps", "2"]
    found = answer(*words, "-o", tmp_path / "r")
    assert (found["data"]["clips"], found["data"]["validation_clips"]) == (2, 1)
    _, said = refusal(
        "train", "dip", clips, "--validation", copy, "-o", tmp_path / "s", *SMALL, "--steps", "2"
    )
    assert "clip0-again.npz: would both train and validate" in said


def test_a_run_begun_anew_says_what_it_kept(
    clips: Path, tmp_path: Path, answer: Answer, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", "dip", clips, "-o", tmp_path / "r", *SMALL]
    answer(*words, "--steps", "4")
    (tmp_path / "r" / "state.pt").unlink()
    assert main([str(w) for w in [*words, "--steps", "2"]]) == 0
    assert "kept as log.jsonl.1, best.safetensors.1, best.json.1" in capsys.readouterr().err
    assert [r["step"] for r in training.read_log(tmp_path / "r")] == [2]


def test_options_reach_the_settings(clips: Path, tmp_path: Path, answer: Answer) -> None:
    found = answer(
        "train", "dip", clips, "-o", tmp_path / "r", *SMALL, "--steps", "2", "--architecture", "rnn",
        "--normalisation", "heading", "--no-acc", "--no-acc-loss", "--rate", "0.01", "--seed", "3",
        "--share", "0.5", "--cooldown", "0.25", "--no-splice",
    )["settings"]  # fmt: skip
    assert found["augmentation"]["splice"] == 0 and found["augmentation"]["mirror"] > 0
    config = found["config"]
    assert (config["architecture"], config["normalisation"]) == ("rnn", "heading")
    assert found["cooldown"] == 0.25
    assert (config["use_acc"], config["dropout"], config["hidden"]) == (False, 0.0, 8)
    assert (found["learning_rate"], found["seed"], found["reconstruct_acc"]) == (0.01, 3, False)
    log = training.read_log(tmp_path / "r")
    assert [r["step"] for r in log] == [2]


def test_the_projects_own_clips(
    tmp_path: Path, answer: Answer, refusal: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without MOTION: CMU alone unless --collections says more, validated on those collections' clips."""
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("POSER_SHARED", str(tmp_path / "shared"))
    words = ["train", "dip", *SMALL, "--steps", "2"]
    assert "unpack CMU's mocap there" in refusal(*words, "-o", tmp_path / "none")[1]
    for folder, names in (
        ("cmu-daz-bvh", ("02_01", "06_01", "07_01", "08_01")),
        ("bandai2-bvh", ("a", "b", "c")),
    ):
        (tmp_path / "cache" / folder).mkdir(parents=True)
        for name in names:
            write_bvh(tmp_path / "cache" / folder / f"{name}.bvh", motions.squat(2.0))
    found = answer(*words, "-o", tmp_path / "cmu", "--export", tmp_path / "cmu.safetensors")
    about = found["data"]
    card = (tmp_path / "cmu.md").read_text()
    assert "licence of these weights: MIT" in card and "mocap.cs.cmu.edu" in card
    assert (about["clips"], about["validation_clips"]) == (2, 1)  # 02 tests, 06 validates
    assert "Bandai" not in about["what"]
    found = answer(*words, "-o", tmp_path / "both", "--collections", "cmu", "bandai")
    about = found["data"]
    assert found["licence"] == "CC BY-NC 4.0"
    # Of Bandai's every tenth is for validation, of which every twelfth is looked at: here the first, "a".
    assert (about["clips"], about["validation_clips"]) == (4, 2)
    assert "CC BY-NC 4.0" in about["what"]
    monkeypatch.setattr(generated, "COUNT", 3)
    found = answer(
        *words, "-o", tmp_path / "more", "--collections", "cmu", "generated",
        "--export", tmp_path / "more.safetensors",
    )  # fmt: skip
    about = found["data"]
    assert found["licence"] == "MIT" and about["credit"].endswith("EIA-0196217.")
    assert (about["clips"], about["validation_clips"]) == (5, 1)
    assert "generated 1" in about["key"] and "mocap.synthesis.generated" in about["what"]
    said = refusal(*words, "-o", tmp_path / "none", "--collections", "generated")
    assert said[0] == 2 and "beside another" in said[1]


def test_weights_to_start_from(
    clips: Path, tmp_path: Path, answer: Answer, refusal: Refusal
) -> None:
    words = ["train", "dip", clips, *SMALL, "--steps", "2"]
    answer(*words, "-o", tmp_path / "a")
    start = tmp_path / "a" / "best.safetensors"
    found = answer(*words, "-o", tmp_path / "b", "--start", start)
    assert found["step"] == 2
    _, said = refusal("train", "dip", clips, "-o", tmp_path / "c", "--start", start, "--hidden", 9)
    assert "holds another network" in said
    _, said = refusal("train", "imuposer", clips, "-o", tmp_path / "c", "--start", start)
    assert "weights of dip, expected imuposer" in said


def test_licence_and_credit_of_the_start_are_kept(
    clips: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a chain of three runs; what weights begin with may ask for more than what they see."""
    words: list[Any] = ["train", "dip", *SMALL, "--steps", "2"]
    first = tmp_path / "first.safetensors"
    found = answer(*words[:2], clips, *words[2:], "-o", tmp_path / "a", "--export", first)
    assert found["licence"] == "that of the motions"
    strict = {"licence": "CC BY-NC 4.0", "data": {"credit": "Bandai."}}
    checkpoint.save(checkpoint.load(first), tmp_path / "strict.safetensors", strict)
    second = tmp_path / "second.safetensors"
    words += ["--export", second]
    answer(
        *words[:2],
        clips,
        *words[2:],
        "-o",
        tmp_path / "b",
        "--start",
        tmp_path / "strict.safetensors",
    )
    card = second.with_suffix(".md").read_text()
    assert "licence of these weights: that of the motions, and CC BY-NC 4.0\n" in card
    assert "credit: Bandai.\n" in card
    assert checkpoint.describe(second)["started_from"] == "strict.safetensors"
    # The project's own clips after that: nothing is lost, nothing said twice, the stricter one wins.
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("POSER_SHARED", str(tmp_path / "shared"))
    (tmp_path / "cache" / "cmu-daz-bvh").mkdir(parents=True)
    for name in ("06_01", "07_01"):
        write_bvh(tmp_path / "cache" / "cmu-daz-bvh" / f"{name}.bvh", motions.squat(2.0))
    third = answer(*words[:-2], "-o", tmp_path / "c", "--start", second)
    assert third["licence"] == "that of the motions, and CC BY-NC 4.0"
    assert "mocap.cs.cmu.edu" in third["data"]["credit"] and third["data"]["credit"].endswith(
        "Bandai."
    )
    checkpoint.save(checkpoint.load(first), tmp_path / "bare.safetensors", {})
    found = answer(*words[:-2], "-o", tmp_path / "d", "--start", tmp_path / "bare.safetensors")
    assert found["licence"] == "MIT, and the unstated one of bare.safetensors"


def test_without_accelerations_none_are_reconstructed(
    clips: Path, tmp_path: Path, answer: Answer
) -> None:
    words = ["train", "dip", clips, *SMALL, "--steps", "2", "-o", tmp_path / "r", "--no-acc"]
    found = answer(*words)["settings"]
    assert (found["config"]["use_acc"], found["reconstruct_acc"]) == (False, False)


def test_a_run_with_other_settings_or_motions_is_left_alone(
    clips: Path, tmp_path: Path, answer: Answer, refusal: Refusal
) -> None:
    words = ["train", "dip", clips, "-o", tmp_path / "r", *SMALL, "--steps", "2"]
    answer(*words)
    state = (tmp_path / "r" / "state.pt").read_bytes()
    said = refusal(*words, "--seed", "1")[1]
    assert (
        "r: holds a run with other settings (--seed 0 there, 1 here); give another folder" in said
    )
    other = ("--batch", "3", "--frames", "13", "--rate", "0.5", "--every", "3", "--seed", "1")
    said = refusal(*words, *other)[1]
    assert (
        "(--batch 2 there, 3 here; --frames 12 there, 13 here; --rate 0.001 there, 0.5 here; and 2 more)"
        in said
    )
    said = refusal("train", "imuposer", clips, "-o", tmp_path / "r", *SMALL, "--steps", "2")[1]
    assert "(network dip there, imuposer here)" in said
    more = refusal(*(w for w in words if w != "--no-dropout"), "--no-acc")[1]
    assert (
        "use_acc (--no-acc) True there, False here; dropout (--no-dropout) 0 there, 0.2 here"
        in more
    )
    assert "other motions" in refusal(*words, "--share", "0.5")[1]
    # The same motion trains, another one validates.
    clip = [clips / f"subject{k}" / "deep" / f"clip{k}.npz" for k in range(3)]
    mine = ["train", "dip", clip[0], "-o", tmp_path / "v", *SMALL, "--steps", "2", "--validation"]
    answer(*mine, clip[1])
    said = refusal(*mine, clip[2])[1]
    assert (
        "v: holds a run that was validated on other motions; give another folder, or the same"
        in said
    )
    assert answer(*mine, clip[1])["begun_at_step"] == 2
    answer("train", "dip", clips, "-o", tmp_path / "other", *SMALL, "--steps", "2", "--seed", "5")
    start = tmp_path / "other" / "best.safetensors"
    assert "began with other weights" in refusal(*words, "--start", start)[1]
    assert (tmp_path / "r" / "state.pt").read_bytes() == state


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["imuposer", "CLIPS", "--architecture", "rnn"], 2, "--architecture: for dip only"),
        (["imuposer", "CLIPS", "--no-acc"], 2, "--no-acc: for dip only"),
        (["dip", "CLIPS", "--architecture", "wavenet", "--hidden", "9"], 2, "--hidden: not with"),
        (["dip", "CLIPS", "--hidden", "9000"], 1, "hidden must be 1 to 8192"),
        (["dip", "CLIPS", "--frames", "4"], 1, "frames must be 8 or more"),
        (["dip", "CLIPS", "--steps", "0"], 2, "not an integer of one or more"),
        (["dip", "CLIPS", "--share", "1.5"], 2, "not a share"),
        (["dip", "CLIPS", "--cooldown", "1"], 2, "not 0 or more and under 1"),
        (["dip", "CLIPS", "--collections", "cmu"], 2, "not with MOTION"),
        (["dip", "--collections", "kit"], 2, "invalid choice"),
        (["dip", "CLIPS", "--resume"], 1, "holds no run to resume"),
        (["dip", "CLIPS", "--export", "x.pt"], 2, "must end in .safetensors"),
        (["dip", "CLIPS/subject0/deep/clip0.npz"], 1, "one motion cannot both train and validate"),
        (["dip", "CLIPS", "--validation", "CLIPS"], 2, "would both train and validate"),
        (["dip", "CLIPS/subject0/deep/clip0.npz", "CLIPS/subject0/shape.npz"], 1, "is none of"),
        (["dip", "CLIPS", "CLIPS/none.npz"], 1, "none.npz: no such file\n"),
        (["dip", "CLIPS", "CLIPS-none"], 1, "-none: no such file\n"),
        (["dip", "--validation", "CLIPS"], 2, "needs MOTION"),
        (["lstm", "CLIPS"], 2, "invalid choice"),
    ],
)
def test_nonsense_is_refused(
    clips: Path, tmp_path: Path, refusal: Refusal, words: list[str], status: int, said: str
) -> None:
    given = [w.replace("CLIPS", str(clips)) for w in words]
    found, sentence = refusal("train", *given, "-o", tmp_path / "r")
    assert (found, said in sentence) == (status, True), sentence


def test_motions_may_stand_behind_options(
    clips: Path, tmp_path: Path, answer: Answer, refusal: Refusal
) -> None:
    clip = [clips / f"subject{k}" / "deep" / f"clip{k}.npz" for k in range(3)]
    out = ("-o", tmp_path / "r", *SMALL, "--steps", "2")
    assert answer("train", "dip", *out, clips, "--device", "cpu")["data"]["clips"] == 2
    assert answer("train", "dip", clip[0], *out[2:], clip[1], "-o", tmp_path / "s")["step"] == 2
    assert "required: network (see" in refusal("train", *out)[1]
    assert "required: network, -o/--output (see" in refusal("train")[1]
    said = refusal("train", "dip", *out, clips, "--bach", "3")[1]
    assert "unrecognized arguments: " in said and "--bach 3" in said


def test_no_cuda_is_said(
    clips: Path, tmp_path: Path, refusal: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    _, said = refusal("train", "dip", clips, "-o", tmp_path / "r", *SMALL, "--device", "cuda")
    assert "has no CUDA device" in said


def test_ctrl_c_leaves_130_and_a_sentence(
    clips: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    one = train.Trainer._one

    def interrupted(self: train.Trainer) -> float:
        if self.step == 2:
            os.kill(os.getpid(), signal.SIGINT)
        return one(self)

    words = [str(w) for w in ["train", "dip", clips, "-o", tmp_path / "r", *SMALL, "--steps", "5"]]
    with monkeypatch.context() as patch:
        patch.setattr(train.Trainer, "_one", interrupted)
        assert main(words) == 130
    said = capsys.readouterr()
    assert "interrupted after step 3; the same command goes on from there" in said.err
    assert answer(*words)["begun_at_step"] == 3


@pytest.mark.parametrize(
    "network", [[*SMALL, "--no-acc-loss"], [*SMALL[2:], "--architecture", "wavenet"]]
)
def test_two_processes_train_one_network(clips: Path, tmp_path: Path, network: list[str]) -> None:
    """As torchrun starts them (gloo): the same weights in both, one of them writes. Also where the loss does
    not reach all of the network."""
    folder = str(tmp_path / "r")
    words = ["train", "dip", str(clips), "-o", folder, *network, "--steps", "4", "--json"]
    code = (
        "import sys\n"
        "from learned.training import trainer as train\n"
        "from learned.dip import model\n"
        "model.SCALER_BATCHES = 1\n"
        "run = train.Trainer.run\n"
        "def told(self, progress=None):\n"
        "    out = run(self, progress)\n"
        "    total = sum(float(p.double().abs().sum()) for p in self.model.parameters())\n"
        "    print('TOTAL', total, self.rng.integers(10**9), file=sys.stderr)\n"
        "    return out\n"
        "train.Trainer.run = told\n"
        "from poser.__main__ import main\n"
        f"sys.exit(main({words!r}))\n"
    )
    found = together([code, code])
    assert [status for status, _, _ in found] == [0, 0], found
    (_, out, first), (_, nothing, other) = found
    assert json.loads(out)["step"] == 4 and nothing == ""
    totals = [
        next(x for x in err.splitlines() if x.startswith("TOTAL")).split() for err in (first, other)
    ]
    assert totals[0][1] == totals[1][1]  # gradients were shared
    assert totals[0][2] != totals[1][2]  # windows were not
    assert [r["step"] for r in training.read_log(tmp_path / "r")] == [2, 4]


@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_finetune(
    clips: Path, recordings: Path, tmp_path: Path, answer: Answer, network: str
) -> None:
    answer("train", network, clips, "-o", tmp_path / "a", *SMALL, "--steps", "2")
    start = tmp_path / "a" / "best.safetensors"
    words = ["finetune", network, recordings, "-o", tmp_path / "b", "--start", start]
    quick = ["--batch", "2", "--frames", "12", "--every", "2"]
    found = answer(*words, *quick, "--steps", "4")
    assert found["step"] == 4 and found["data"]["held_out"] == 1
    assert found["settings"]["learning_rate"] == 1e-4
    assert answer(*words, *quick, "--steps", "6")["begun_at_step"] == 4
    record = checkpoint.describe(tmp_path / "b" / "best.safetensors")
    assert record["started_from"] == "best.safetensors"


def test_a_recording_given_twice_is_one(
    clips: Path, recordings: Path, tmp_path: Path, answer: Answer
) -> None:
    """Its last fifth validates then, which nothing has trained on."""
    answer("train", "dip", clips, "-o", tmp_path / "a", *SMALL, "--steps", "2")
    take = recordings / "take0.npz"
    link = tmp_path / "link.npz"
    link.symlink_to(take)
    found = answer(
        "finetune", "dip", take, link, "-o", tmp_path / "b", "--batch", "2", "--frames", "12",
        "--steps", "2", "--start", tmp_path / "a" / "best.safetensors",
    )  # fmt: skip
    assert found["data"]["recordings"] == 1


@pytest.mark.parametrize(
    ("words", "steps"),
    [([], 2000), (["--minutes", "30"], None), (["--minutes", "30", "--steps", "7"], 7)],
)
def test_with_minutes_alone_the_clock_decides(
    clips: Path, recordings: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch,
    words: list[str], steps: int | None,
) -> None:  # fmt: skip
    """Of the default of 2,000 steps nothing is left then: not even its share of the progress."""
    seen = []

    def first_step(self: train.Trainer, progress: Any = None) -> Path:
        self.step, self.seconds = 5, 60.0
        seen.append((self.settings.steps, self.done()))
        raise KeyboardInterrupt

    answer("train", "dip", clips, "-o", tmp_path / "a", *SMALL, "--steps", "2")
    monkeypatch.setattr(train.Trainer, "run", first_step)
    line = ["finetune", "dip", recordings, "-o", tmp_path / "b", "--frames", "12", *words]
    assert main([str(w) for w in [*line, "--start", tmp_path / "a" / "best.safetensors"]]) == 130
    share = {None: 1 / 30, 7: 5 / 7, 2000: 5 / 2000}[steps]
    assert seen == [(steps, pytest.approx(share))]


def test_what_cannot_be_fine_tuned_on(
    clips: Path, recordings: Path, tmp_path: Path, answer: Answer, refusal: Refusal,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    answer("train", "dip", clips, "-o", tmp_path / "a", *SMALL, "--steps", "2")
    start = ["--start", tmp_path / "a" / "best.safetensors"]
    bare = synthesis.recording(motions.squat(2.0))
    write_recording(
        tmp_path / "bare.npz",
        type(bare)(bare.rate_hz, bare.sensors, bare.R_world_bone, bare.acc_world, bare.valid),
    )
    few = synthesis.recording(motions.squat(2.0), sensors.FIVE)
    write_recording(tmp_path / "few.npz", few)
    words = ["finetune", "dip", "-o", tmp_path / "b", *start]
    for name, sentence in (
        ("bare.npz", "holds no reference motion to learn from"),
        ("few.npz", "there is no left_shank, right_shank, pelvis"),
    ):
        status, said = refusal(*words, tmp_path / name)
        assert status == 1 and sentence in said and name in said
    _, said = refusal(*words, clips / "subject0" / "deep" / "clip0.npz")
    assert "holds a motion, expected a calibrated recording" in said
    monkeypatch.setattr(checkpoint, "WEIGHTS", tmp_path)
    _, said = refusal("finetune", "dip", recordings, "-o", tmp_path / "b")
    assert "no weights of dip come with this installation" in said
