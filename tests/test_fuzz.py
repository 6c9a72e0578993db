"""A fixed slice of `make fuzz`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_damaged_files_are_refused_or_read() -> None:
    """Each in a child with limits of time and memory."""
    line = [sys.executable, "-m", "tests.fuzz", "--seed", "16", "--cases", "150"]
    done = subprocess.run(
        line, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "seed 16: 150 cases" in done.stdout
