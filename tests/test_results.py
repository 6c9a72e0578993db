"""The tables of docs and README are what the benchmarks left, nothing typed by hand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_tables_are_what_the_benchmarks_left() -> None:
    line = [sys.executable, str(ROOT / "scripts" / "make_results.py"), "--check"]
    out = subprocess.run(line, capture_output=True, text=True, check=False)
    assert out.returncode == 0, out.stderr


def test_readme_and_changelog_are_short() -> None:
    """A newcomer reads them first."""
    assert len((ROOT / "README.md").read_text().split()) <= 1300
    assert len((ROOT / "CHANGELOG.md").read_text().splitlines()) <= 40
