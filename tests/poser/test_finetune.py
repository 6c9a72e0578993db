"""`poser finetune` on recordings as `poser track` takes them; tiny networks."""

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
from learned.training import trainer as train
from learned.training import validation
from mocap import sensors, synthesis
from mocap.formats.native import read_recording, write_recording
from mocap.synthesis import motions
from poser.__main__ import main

Answer = Callable[..., Any]
Refusal = Callable[..., tuple[int, str]]
QUICK = ["--batch", "3", "--frames", "12", "--every", "2", "--steps", "4"]
SUITED = (*sensors.SUIT, *(n for n in sensors.FIVE if n not in sensors.SUIT))
ABOUT = {"licence": "CC BY-NC 4.0", "data": {"what": "clips of a studio", "credit": "The studio."}}


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    monkeypatch.setattr(validation, "MOST_WINDOWS", {"dip": 12, "imuposer": 12})


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """dip.safetensors, imuposer.safetensors with their licence; take0 to take2.npz of a suit; three.npz: a
    watch, a phone and earphones; six.npz. 2 s at 50 Hz."""
    where = tmp_path_factory.mktemp("finetune")
    for network in ("dip", "imuposer"):
        torch.manual_seed(0)
        model = build(for_network(network, hidden=8, dropout=0.0))
        checkpoint.save(model, where / f"{network}.safetensors", ABOUT)
    made = {"three": ("left_wrist", "right_pocket", "head"), "six": sensors.SIX}
    made |= {f"take{k}": SUITED for k in range(3)}
    for k, (name, names) in enumerate(made.items()):
        motion = motions.walk(4.0, 50.0).slice(20 * k, 20 * k + 101)
        write_recording(where / f"{name}.npz", synthesis.recording(motion, names))
    return where


@pytest.mark.parametrize(
    ("name", "network", "serve", "note"),
    [
        ("three", "imuposer", {0, 3, 4}, "no recording has right_wrist, left_pocket"),
        ("six", "imuposer", {0, 1, 4}, "left_forearm stands in for left_wrist"),
        ("take0", "imuposer", {0, 1, 2, 3, 4}, ""),
        ("take0", "dip", None, ""),
    ],
)
def test_recordings_that_are_tracked_can_be_learnt_from(
    name: str, network: str, serve: set[int] | None, note: str, place: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """What is not in the recording is worn neither in training nor in validation."""
    shown: list[tuple[str, torch.Tensor]] = []
    for where in (train, validation):
        real = where.imuposer_input  # type: ignore[attr-defined]

        def noting(R: Any, acc: Any, worn: Any, real: Any = real, at: str = where.__name__) -> Any:
            shown.append((at, worn))
            return real(R, acc, worn)

        monkeypatch.setattr(where, "imuposer_input", noting)
    line = [str(place / f"{name}.npz"), "-o", str(tmp_path / "r"), *QUICK, "--batch", "16"]
    start = ["--start", str(place / f"{network}.safetensors")]
    export = ["--export", str(tmp_path / "w.safetensors")]
    assert main(["finetune", network, *line, *start, *export]) == 0
    said = capsys.readouterr().err
    assert note in said and ("stands in" in said) == (name == "six")
    if serve is None:
        assert shown == []
        return
    for where in ("learned.training.trainer", "learned.training.validation"):
        worn = torch.cat([w for at, w in shown if at == where])
        assert set(worn.any(0).nonzero().flatten().tolist()) == serve and worn.any(1).all()
    # A combination that is not in the recording keeps what is said of its errors.
    model = checkpoint.load(tmp_path / "w.safetensors")
    before = checkpoint.load(place / "imuposer.safetensors")
    kept = [
        torch.equal(a, b) for a, b in zip(model.deviation_rad, before.deviation_rad, strict=True)
    ]
    assert any(kept) == (name != "take0") and not all(kept)


def test_sensors_that_do_not_serve_are_named(
    place: Path, tmp_path: Path, refusal: Callable[..., tuple[int, str]]
) -> None:
    start = ("--start", place / "dip.safetensors")
    words = ("finetune", "dip", place / "three.npz", "-o", tmp_path / "r", *start)
    status, said = refusal(*words)
    assert status == 1 and "three.npz: dip needs left_forearm" in said and "there is no" in said


def without(place: Path, out: Path, name: str, *dead: str) -> Path:
    """The recording with sensors that are there and never measured anything."""
    made = read_recording(place / f"{name}.npz")
    valid = np.array(made.valid)
    valid[:, [made.sensors.index(n) for n in dead]] = False
    write_recording(out, replace(made, valid=valid))
    return out


def test_sensors_that_never_measured_anything(
    place: Path, tmp_path: Path, refusal: Refusal, capsys: pytest.CaptureFixture[str]
) -> None:
    """dip would learn from a bone that never turns; imuposer has one device less."""

    def words(network: str, path: Path, at: str = "r") -> list[Any]:
        start = ["--start", place / f"{network}.safetensors"]
        return ["finetune", network, path, "-o", tmp_path / at, *QUICK, *start]

    one = without(place, tmp_path / "one.npz", "six", "left_shank")
    status, said = refusal(*words("dip", one))
    assert status == 1
    assert "one.npz: sensor left_shank: no orientation in any frame; dip learns from" in said
    made = read_recording(place / "six.npz")
    valid = np.array(made.valid)
    valid[10:40, 3] = False  # lost for a while
    write_recording(tmp_path / "lost.npz", replace(made, valid=valid))
    assert main([str(w) for w in words("dip", tmp_path / "lost.npz", "lost")]) == 0
    watch = without(place, tmp_path / "watch.npz", "three", "head")
    capsys.readouterr()
    assert main([str(w) for w in words("imuposer", watch, "watch")]) == 0
    assert "no recording has right_wrist, left_pocket, head:" in capsys.readouterr().err
    never = without(place, tmp_path / "never.npz", "three", "left_wrist", "right_pocket", "head")
    _, said = refusal(*words("imuposer", never))
    assert "never.npz: no orientation in any frame of left_wrist, right_pocket, head" in said


@pytest.mark.parametrize(
    ("network", "frames", "said"),
    [
        ("dip", 1, "s.npz: holds one frame, and at least two are needed"),
        ("imuposer", 2, "s.npz: at 25 Hz it is one frame, which cannot both train and validate"),
    ],
)
def test_recordings_of_a_frame_or_two_are_refused(
    place: Path, tmp_path: Path, refusal: Refusal, network: str, frames: int, said: str
) -> None:
    made = read_recording(place / "take0.npz").slice(10, 10 + frames)
    write_recording(tmp_path / "s.npz", replace(made, start_s=0.0))
    start = ["--start", place / f"{network}.safetensors"]
    paths = [tmp_path / "s.npz", *([place / "take1.npz"] if frames == 1 else [])]
    status, found = refusal("finetune", network, *paths, "-o", tmp_path / "r", *QUICK, *start)
    assert status == 1 and said in found


def test_licence_and_credit_of_the_start_are_kept(
    place: Path, tmp_path: Path, answer: Answer
) -> None:
    start, out = place / "dip.safetensors", tmp_path / "w.safetensors"
    takes = [place / f"take{k}.npz" for k in range(3)]
    found = answer(
        "finetune", "dip", *takes, "-o", tmp_path / "r", *QUICK, "--start", start, "--export", out
    )
    licence = "that of the recordings, and CC BY-NC 4.0"
    assert found["licence"] == licence and found["started_from"] == "dip.safetensors"
    for path in (out, tmp_path / "r" / "best.safetensors"):
        record = checkpoint.describe(path)
        assert record["licence"] == licence and record["data"]["credit"] == "The studio."
        assert record["data"]["what"] == (
            "recordings of the user; begun with dip.safetensors, trained on clips of a studio"
        )
    card = out.with_suffix(".md").read_text()
    assert f"licence of these weights: {licence}\n" in card and "credit: The studio.\n" in card
    # Weights that state nothing pass on that nothing is known; and a second time adds nothing.
    bare = tmp_path / "bare.safetensors"
    checkpoint.save(checkpoint.load(start), bare, {"data": "mine"})
    again = [*takes, *QUICK, "--start"]
    found = answer("finetune", "dip", "-o", tmp_path / "b", *again, bare)
    assert found["licence"] == "that of the recordings, and the unstated one of bare.safetensors"
    assert "credit" not in found["data"]
    found = answer("finetune", "dip", "-o", tmp_path / "c", *again, out)
    assert found["licence"] == licence and found["data"]["credit"] == "The studio."


def test_recordings_that_are_too_short_are_named(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    long = read_recording(place / "take0.npz")
    for name, part in (("a", (0, 100)), ("b", (20, 29)), ("c", (30, 39)), ("d", (0, 101))):
        write_recording(tmp_path / f"{name}.npz", replace(long.slice(*part), start_s=0.0))

    def said(*names: str, at: str) -> str:
        paths = [str(tmp_path / f"{n}.npz") for n in names]
        start = ["--start", str(place / "dip.safetensors")]
        assert main(["finetune", "dip", *paths, "-o", str(tmp_path / at), *QUICK, *start]) == 0
        return capsys.readouterr().err

    text = said("a", "b", "d", at="r1")
    assert "shorter than a window of 12 frames and not trained on: b.npz\n" in text
    assert "to validate on" not in text
    text = said("a", "c", at="r2")
    assert "fewer frames to validate on than a window's 12, which tells little: c.npz (1" in text
    assert "not trained on" not in text
    # The last fifth of 2 s has 24 frames at 60 Hz, that of 0.9 s has 11.
    assert "to validate on" not in said("a", at="r3")
    write_recording(tmp_path / "e.npz", replace(long.slice(0, 45), start_s=0.0))
    assert "which tells little: e.npz (11)" in said("e", at="r4")
