"""Full disk and kill at every writer: what was there is there, or the new file is whole."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.writers import FILES

ROOT = Path(__file__).resolve().parents[1]
KEEPS_ROWS = (
    "sink",
    "bvh sink",
    "record",
)  # what came is beside it, and the next session makes it whole


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    """Of all writers in a process of its own: the limits of a test's would be those of its log, too."""
    line = [sys.executable, "-m", "tests.writers", str(tmp_path_factory.mktemp("writers"))]
    done = subprocess.run(
        line, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(json.loads(line) for line in done.stdout.splitlines() if line.startswith("["))


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_what_was_there_is_there(name: str, outcomes: dict[str, list[dict[str, Any]]]) -> None:
    if not outcomes[name]:
        pytest.skip("its extra is not installed")
    for found in outcomes[name]:
        part = name in KEEPS_ROWS and found["whole"]  # the poses until then, in a whole file
        assert found["kept"] or part, found
        assert found["said"] != "written" or part, found
        beside = [f"{FILES[name]}.part"] if name in KEEPS_ROWS else []
        assert set(found["others"]) <= set(beside), found
        if found["killed"] and name != "mp4":  # there it is ffmpeg that is killed
            assert found["said"] == "killed", found
        elif found["said"] != "written":
            assert FILES[name] in found["said"] and found["left"] == [], found
