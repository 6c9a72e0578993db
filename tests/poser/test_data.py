"""`poser data`: what is used, what is left out, and what is not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.formats.bvh import write_motion
from mocap.synthesis import motions
from poser.__main__ import main

Answer = Callable[..., Any]


@pytest.fixture
def unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three Daz clips, one whose hand flips at the end, and MotionBuilder's of one of them and of 131."""
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("POSER_SHARED", str(tmp_path / "shared"))
    walk = motions.walk(3.0, 120.0)
    R = np.array(walk.R_parent_joint)
    R[320:, 1] = R[320:, 1] @ ori.exp([0.2, 0.3, 1.4])
    for path, motion in (
        ("cache/cmu-daz-bvh/02_01", walk),
        ("cache/cmu-daz-bvh/07_01", replace(walk, R_parent_joint=R)),
        ("cache/cmu-daz-bvh/salsa_01", walk),
        ("shared/data/cmu-motionbuilder-bvh/02_01", walk),
        ("shared/data/cmu-motionbuilder-bvh/131_01", walk),
    ):
        file = tmp_path / f"{path}.bvh"
        file.parent.mkdir(parents=True, exist_ok=True)
        write_motion(file, motion)
    return tmp_path


def test_minutes_by_subject_and_split(unpacked: Path, answer: Answer) -> None:
    found = answer("data")
    rows = {(s["split"], s["subject"]): s for s in found["subjects"]}
    assert set(rows) == {("test", "02"), ("train", "07"), ("train", "salsa")}
    assert rows["test", "02"]["minutes"] == pytest.approx(3 / 60, abs=1e-3)
    assert rows["train", "salsa"]["minutes"] == pytest.approx(6 / 60, abs=1e-3)
    assert 60 * rows["train", "07"]["untrusted_minutes"] == pytest.approx(46 / 120, abs=0.02)
    assert found["splits"]["train"]["clips"] == 2
    assert found["splits"]["train"]["minutes"] == pytest.approx(9 / 60, abs=1e-3)
    assert {c["clip"]: c["untrusted_s"] > 0 for c in found["clips"]} == {
        "02_01": False, "07_01": True, "salsa_01": False,
    }  # fmt: skip
    assert [(x["clip"], x["from"]) for x in found["left_out"]] == [
        ("02_01", "cmu-motionbuilder-bvh"), ("131_01", "cmu-motionbuilder-bvh"),
    ]  # fmt: skip
    assert [x["archive"] for x in found["absent"]] == ["cmu-amc"]


def test_the_table_says_the_same(unpacked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data"]) == 0
    said = capsys.readouterr().out
    assert "left out, the same trial, used from cmu-daz-bvh: 02_01" in said
    assert "left out, serves the readers' tests alone: 131_01" in said
    assert f"not there: {unpacked / 'cache' / 'cmu-amc'}" in said
    (row,) = (line for line in said.splitlines() if line.split()[:2] == ["train", "07"])
    assert row.split()[2:] == ["1", "0.1", "0.4", "0.0", "cmu-daz-bvh:1"]


def test_a_collection_that_is_not_there(unpacked: Path, refusal: Answer) -> None:
    assert "unpack Bandai-Namco" in refusal("data", "--collections", "bandai")[1]
