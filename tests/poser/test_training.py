"""What the runs of `poser train` and `poser finetune` share: precision, outputs, several processes."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from learned import checkpoint
from learned.training import trainer as train
from poser import training
from poser.__main__ import main
from poser.console import UsageError
from tests.poser.runs import SMALL, three_clips, together

Answer = Callable[..., Any]
Refusal = Callable[..., tuple[int, str]]
pytestmark = pytest.mark.usefixtures("small_runs")


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of three motions, of which one validates."""
    top = tmp_path_factory.mktemp("clips")
    three_clips([top] * 3)
    return top


def test_precision_is_chosen_said_and_may_change(
    clips: Path, tmp_path: Path, answer: Answer, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """A run that was moved to another machine, or is told another precision, goes on."""
    fast = [False]
    monkeypatch.setattr(train, "bfloat16_pays", lambda device, before: fast[0])
    words = [str(w) for w in ["train", "dip", clips, "-o", tmp_path / "r", *SMALL]]

    def said(*more: str) -> str:
        capsys.readouterr()
        assert main([*words, *more]) == 0
        return capsys.readouterr().out.splitlines()[0]

    assert said("--steps", "2").endswith("r: begins, in float32: bfloat16 is not faster here")
    fast[0] = True
    assert "goes on at step 2, in bfloat16, which is faster here" in said("--steps", "4")
    assert said("--steps", "6", "--precision", "float32").endswith("step 4, in float32")
    found = answer(*words, "--steps", "8")
    assert (found["begun_at_step"], found["precision"]) == (6, "bfloat16")
    assert found["settings"]["bfloat16"] is True
    found = answer(*words, "--steps", "8", "--precision", "float32")
    assert (found["begun_at_step"], found["precision"]) == (8, "float32")
    assert found["settings"]["bfloat16"] is False


@pytest.mark.parametrize("name", ["best.safetensors", "link/best.safetensors", "best.SAFETENSORS"])
def test_an_export_over_the_runs_own_files_is_refused(
    clips: Path, tmp_path: Path, answer: Answer, refusal: Refusal, name: str
) -> None:
    """The weights would be halved, and their description no longer that of the log."""
    run = tmp_path / "r"
    run.mkdir()
    (run / "link").symlink_to(run)
    words = ["train", "dip", clips, "-o", run, *SMALL, "--steps", "2"]
    for _ in range(2):  # before there is anything to write over, and after
        status, said = refusal(*words, "--export", run / name)
        assert status == 2 and "the run keeps its own best." in said
        answer(*words)
    answer(*words, "--export", run / "exported.safetensors")
    assert checkpoint.load(run / "exported.safetensors").config.hidden == 8


@pytest.mark.parametrize("architecture", ["feedforward", "wavenet"])
def test_units_of_layers_that_have_none(architecture: str) -> None:
    with pytest.raises(UsageError, match=f"--hidden: not with --architecture {architecture}"):
        training.check_hidden(Namespace(network="dip", hidden=16, architecture=architecture))
    training.check_hidden(Namespace(network="dip", hidden=None, architecture=architecture))
    for recurrent in ("rnn", "birnn", None):
        training.check_hidden(Namespace(network="dip", hidden=16, architecture=recurrent))


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["--architecture", "wavenet", "--hidden", "16"], 2, "--hidden: not with --architecture"),
        (["--hidden", "8193"], 1, "hidden must be 1 to 8192"),
        (["--precision", "float16"], 2, "invalid choice"),
    ],
)
def test_nonsense_is_refused(
    clips: Path, tmp_path: Path, refusal: Refusal, words: list[str], status: int, said: str
) -> None:
    found, sentence = refusal("train", "dip", clips, "-o", tmp_path / "r", *words)
    assert (found, said in sentence) == (status, True), sentence


CODE = """
import sys, torch
from learned.training import trainer as train
from learned.dip import model
model.SCALER_BATCHES = 1
torch.set_num_threads(1)
train.bfloat16_pays = lambda device, before: {rank} == 0  # the first one measures for both

def total(tensors):
    return repr(sum(float(x.double().abs().sum()) for x in tensors))

def told(t, what):
    moments = [x for s in t.optimizer.state_dict()["state"].values() for x in s.values()]
    print(what, t.step, t.precision, t.best, total(t.model.state_dict().values()),
          total(t.average.state_dict().values()), total(moments), file=sys.stderr)

run = train.Trainer.run
def both(self, progress=None):
    told(self, "BEGUN")
    out = run(self, progress)
    told(self, "ENDED")
    print("DRAWS", self.rng.integers(10**9), file=sys.stderr)
    return out
train.Trainer.run = both
from poser.__main__ import main
sys.exit(main({words!r}))
"""


def two_machines(top: Path, clips: Path, *more: str) -> list[tuple[int, str, str]]:
    """The status, stdout and stderr of two processes (gloo), each with a folder `run` of its own."""
    programs = []
    for rank in range(2):
        words = ["train", "dip", str(clips), "-o", str(top / str(rank) / "run"), *SMALL, *more]
        programs.append(CODE.format(rank=rank, words=words))
    return together(programs)


def lines(text: str, word: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith(word)]


def test_machines_without_a_common_folder_go_on_alike(clips: Path, tmp_path: Path) -> None:
    """The first one's state is everyone's: step, weights, running mean, moments, best; not the draws."""
    for steps, begun in (("4", "0"), ("7", "4")):
        more = ["--resume"] if begun != "0" else []
        found = two_machines(tmp_path, clips, "--steps", steps, "--json", *more)
        assert [status for status, _, _ in found] == [0, 0], found
        (_, out, first), (_, nothing, other) = found
        assert nothing == "" and json.loads(out)["begun_at_step"] == int(begun)
        assert lines(first, "BEGUN") == lines(other, "BEGUN")
        assert lines(first, "BEGUN")[0].split()[1:3] == [begun, "bfloat16"]
        # The first one validates alone: what is best differs in the end, as it may.
        ends = [lines(text, "ENDED")[0].split() for text in (first, other)]
        assert [e[1] for e in ends] == [steps, steps]
        assert ends[0][4:] == ends[1][4:]
        assert lines(first, "DRAWS") != lines(other, "DRAWS")
        # Said once, by whoever writes.
        assert len(lines(first, "note: validation:")) == 1 and lines(other, "note") == []
        assert not (tmp_path / "1" / "run").exists()
    # The other one's folder is not looked at, whatever lies in it; what is wrong with the first's ends both.
    (tmp_path / "1" / "run").mkdir(parents=True)
    (tmp_path / "1" / "run" / "state.pt").write_bytes(b"nothing")
    found = two_machines(tmp_path, clips, "--steps", "7")
    assert [status for status, _, _ in found] == [0, 0], found
    (tmp_path / "0" / "run" / "state.pt").write_bytes(b"nothing")
    found = two_machines(tmp_path, clips, "--steps", "7")
    assert [status for status, _, _ in found] == [1, 1], found
    assert all("cannot be resumed from" in err for _, _, err in found)
