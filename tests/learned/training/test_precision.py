"""Where bfloat16 is used: measured, and kept by a run that goes on."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest
import torch

from learned.training import precision
from learned.training.precision import bfloat16_pays, relative_time


@pytest.mark.parametrize(
    ("relative", "fresh", "after_bfloat16"),
    [(0.6, True, True), (1.3, False, True), (2.5, False, False), (50.0, False, False)],
)
def test_what_the_ratio_decides(
    monkeypatch: pytest.MonkeyPatch, relative: float, fresh: bool, after_bfloat16: bool
) -> None:
    """A run that goes on keeps what it had, bfloat16 unless it is far slower here."""
    monkeypatch.setattr(precision, "relative_time", lambda threads: relative)
    assert bfloat16_pays("cpu") is fresh
    assert bfloat16_pays("cpu", before=True) is after_bfloat16
    assert bfloat16_pays("cpu", before=False) is False


@pytest.mark.parametrize("has", [True, False])
def test_a_gpu_is_asked_for_units_of_its_own(monkeypatch: pytest.MonkeyPatch, has: bool) -> None:
    def supported(including_emulation: bool = True) -> bool:
        return has or including_emulation

    monkeypatch.setattr(torch.cuda, "is_bf16_supported", supported)
    for before in (None, True, False):  # a CPU may have had none
        assert bfloat16_pays("cuda:0", before) is has


def test_the_measurement_draws_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the generator that a run's weights and dropout come from."""
    monkeypatch.setattr(precision, "ROUNDS", 1)
    before = torch.get_rng_state()
    relative_time.cache_clear()
    assert 0.0 < relative_time(torch.get_num_threads()) < float("inf")
    assert torch.equal(before, torch.get_rng_state())
    relative_time.cache_clear()  # one round is too few for whoever asks next


@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"), reason="instructions of x86"
)
def test_emulated_bfloat16_is_found_out() -> None:
    """On a CPU that has AVX2 alone (or is told so) a step takes 10 times as long and more."""
    code = (
        "import torch; torch.set_num_threads(1); from learned.training.precision import *\n"
        "print(relative_time(1), bfloat16_pays('cpu'), bfloat16_pays('cpu', True))"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], text=True, capture_output=True, timeout=200, check=True,
        env=os.environ | {"ONEDNN_MAX_CPU_ISA": "AVX2", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    relative, *pays = told.stdout.split()
    assert float(relative) > 3.0 and pays == ["False", "False"]
