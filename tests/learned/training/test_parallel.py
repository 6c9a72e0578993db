"""How a process joins the others."""

from __future__ import annotations

import pytest
import torch

from learned.errors import TrainingError
from learned.training import parallel


def test_more_processes_than_gpus_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """(Without a GPU here: torch is told of two.)"""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    for name, value in (("WORLD_SIZE", "3"), ("RANK", "2"), ("LOCAL_RANK", "2")):
        monkeypatch.setenv(name, value)
    with pytest.raises(TrainingError, match="process 2 of this machine has no GPU: there are 2"):
        parallel.join("cuda")


def test_alone_without_torchrun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    assert parallel.join() == parallel.World(0, 1, "cpu")
