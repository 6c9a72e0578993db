"""The fixed split: by subject, never by window."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap import dataset
from mocap.errors import PoserError


@pytest.mark.parametrize(
    ("name", "split"),
    [
        ("02_01", "test"), ("05_20", "test"), ("09_12", "test"), ("06_01", "validation"),
        ("12_03", "validation"), ("01_14", "train"), ("14_37", "train"), ("salsa_07", "train"),
        ("martial_02", "train"), ("indian_05", "train"),
    ],
)  # fmt: skip
def test_cmu_goes_by_subject(name: str, split: str) -> None:
    assert dataset.split_of(name) == split


def test_every_tenth_bandai_clip_validates() -> None:
    splits = [dataset.split_of("dataset-2_walk_normal_001", i) for i in range(30)]
    assert [i for i, s in enumerate(splits) if s == "validation"] == [0, 10, 20]
    assert "test" not in splits


def test_files_of_a_split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSER_CACHE", str(tmp_path))
    with pytest.raises(PoserError, match="unpack the Daz-friendly BVH conversion of CMU"):
        dataset.files("test", ("cmu",))
    folder = tmp_path / "cmu-daz-bvh"
    folder.mkdir()
    for name in ("02_01", "06_01", "01_01"):
        (folder / f"{name}.bvh").touch()
    found = {s: [p.stem for p in dataset.files(s, ("cmu",))] for s in ("test", "train")}
    assert found == {"test": ["02_01"], "train": ["01_01"]}
