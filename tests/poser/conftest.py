"""A short built-in motion as a file, and what the commands make of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mocap.formats.amass import write_motion
from mocap.synthesis import motions
from poser.__main__ import main


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds walk.npz (3 s motion), rec/walk.npz (six noisy sensors), raw/walk.npz, sip.npz."""
    where = tmp_path_factory.mktemp("cli")
    write_motion(where / "walk.npz", motions.walk(3.0))
    write_motion(where / "long.npz", motions.builtin(seconds=11.0))
    rec, raw = str(where / "rec"), str(where / "raw")
    noisy = ["--noise", "realistic"]
    assert main(["synthesize", str(where / "walk.npz"), "-o", rec, *noisy]) == 0
    assert main(["synthesize", str(where / "long.npz"), "-o", raw, "--raw", *noisy]) == 0
    fast = ["--solver", "banded"]
    assert main(["solve", f"{rec}/walk.npz", "-o", str(where / "sip.npz"), *fast]) == 0
    return where


@pytest.fixture
def small_runs(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Training of seconds: few windows for scalers and validation, one thread, a cache of the tests' own."""
    import torch

    from learned.training import trainer as train
    from learned.training import validation

    monkeypatch.setattr(train, "_SCALER_BATCHES", 1)
    torch.set_num_threads(1)  # small networks only wait for each other on several
    monkeypatch.setattr(validation, "MOST_WINDOWS", {"dip": 12, "imuposer": 6})
    monkeypatch.setenv("POSER_CACHE", str(tmp_path_factory.getbasetemp() / "poser-cache"))


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Runs a command that must succeed and returns the JSON that is all of its stdout."""

    def run(*words: object) -> Any:
        capsys.readouterr()
        assert main([str(w) for w in words] + ["--json"]) == 0
        return json.loads(capsys.readouterr().out, parse_constant=_refuse)

    return run


def _refuse(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Runs a command that must fail; returns its status and the one sentence on stderr."""

    def run(*words: object) -> tuple[int, str]:
        capsys.readouterr()
        status = main([str(w) for w in words])
        said = capsys.readouterr()
        assert status != 0
        assert said.out == ""
        assert said.err.count("\n") == 1
        assert "Traceback" not in said.err
        return status, said.err

    return run
