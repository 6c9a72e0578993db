"""What is exported: figures of what was trained, where it was made, a card that says what it is."""

from __future__ import annotations

import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import torch

from learned import checkpoint
from learned.models import build, for_network
from learned.training.export import SKELETON, card, export, made_with
from learned.training.validation import score
from tests.learned.swing import validation, wavy


def run_of(folder: Path, about: dict[str, Any] | None = None, **config: Any) -> Path:
    """Weights of an untrained DIP as a run leaves them."""
    torch.manual_seed(0)
    path = folder / "best.safetensors"
    checkpoint.save(build(for_network("dip", hidden=8, **config)), path, about or {})
    return path


@pytest.mark.parametrize("reconstruct_acc", [True, False])
def test_the_loss_counts_what_training_counted(tmp_path: Path, reconstruct_acc: bool) -> None:
    """Heads that nothing taught have no part in it."""
    run = run_of(tmp_path, {"training": {"reconstruct_acc": reconstruct_acc}})
    windows, target = validation(wavy(), "dip", 12), tmp_path / "out.safetensors"
    figures = export(run, target, windows, {})["validation"]
    model = checkpoint.load(target)
    assert figures["loss"] == pytest.approx(score(model, windows, reconstruct_acc)["loss"])
    other = score(model, windows, not reconstruct_acc)["loss"]
    assert figures["loss"] != pytest.approx(other, rel=1e-2)


def test_description_and_card_say_where_it_was_made(tmp_path: Path) -> None:
    target = tmp_path / "out.safetensors"
    record = export(run_of(tmp_path), target, validation(wavy(), "dip", 20), {})
    assert record["skeleton"] == SKELETON and record["version"] == version("poser-imu")
    text = target.with_suffix(".md").read_text()
    assert f"skeleton: {SKELETON}" in text and f"poser-imu {record['version']}" in text
    assert ("revision" in record) == (f"revision {record.get('revision')}" in text)


def _git(folder: Path, *words: str) -> str:
    author = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    line = ["git", "-C", str(folder), *author, *words]
    return subprocess.run(line, check=True, capture_output=True, text=True).stdout.strip()


def test_the_revision_is_that_of_the_packages_own_checkout(tmp_path: Path) -> None:
    """Not of one that an installation happens to lie in."""
    inner = tmp_path / "venv" / "site-packages"
    inner.mkdir(parents=True)
    assert made_with(tmp_path).keys() == {"skeleton", "version"}
    _git(tmp_path, "init")
    assert "revision" not in made_with(tmp_path)  # nothing committed yet
    (tmp_path / "a").write_text("1")
    _git(tmp_path, "add", "a")
    _git(tmp_path, "commit", "-m", "a")
    _git(tmp_path, "tag", "-m", "v9", "v9")  # the hash is wanted, not a name
    head = _git(tmp_path, "rev-parse", "--short", "HEAD")
    assert made_with(tmp_path)["revision"] == head
    (tmp_path / "a").write_text("2")
    assert made_with(tmp_path)["revision"] == f"{head}-dirty"
    assert "revision" not in made_with(inner)


def test_no_git_is_no_revision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".git").mkdir()  # none that git would know
    assert "revision" not in made_with(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "revision" not in made_with(tmp_path)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"recordings": 30, "held_out": 3}, "On 3 of the user's 30 recordings, which were not"),
        ({"recordings": 1, "held_out": 1}, "On the last fifth of the user's recording"),
        ({"validation_clips": 7}, "On 7 motions that were not trained on, virtual sensors with"),
        ({"validation": "subject 06"}, "On motions that were not trained on (subject 06), virtual"),
        ({}, "On motions that were not trained on, virtual sensors"),
    ],
)
def test_the_card_says_what_validated(data: dict[str, Any], said: str) -> None:
    """Recordings are of real sensors: nothing is virtual about them."""
    config = for_network("dip").to_json()
    text = card("w.safetensors", {"config": config, "data": data})
    assert said in text
    assert ("virtual sensors" in text) is ("recordings" not in data)


@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_cards_of_what_is_shipped(network: str) -> None:
    path = checkpoint.shipped(network)
    record = checkpoint.describe(path)
    text = card(path.name, record)
    for part in (record["licence"], record["skeleton"], record["revision"], "512 units"):
        assert part in text


@pytest.mark.parametrize(("architecture", "sized"), [("rnn", True), ("wavenet", False)])
def test_units_are_told_of_layers_that_have_them(architecture: str, sized: bool) -> None:
    config = for_network("dip", architecture=architecture, hidden=16).to_json()
    assert ("16 units" in card("w.safetensors", {"config": config})) is sized
