"""The fixed split: by subject, never by window."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap import dataset
from mocap.errors import PoserError
from mocap.formats.bvh import write_motion
from mocap.synthesis import motions


@pytest.mark.parametrize(
    ("name", "split"),
    [
        ("02_01", "test"), ("05_20", "test"), ("09_12", "test"), ("06_01", "validation"),
        ("12_03", "validation"), ("17_10", "validation"), ("35_01", "validation"), ("01_14", "train"),
        ("14_37", "train"), ("135_02", "train"), ("127_06", "train"), ("salsa_07", "train"),
        ("martial_02", "train"), ("indian_05", "train"),
    ],
)  # fmt: skip
def test_cmu_goes_by_subject(name: str, split: str) -> None:
    assert dataset.split_of(name) == split


def test_every_tenth_bandai_clip_validates() -> None:
    splits = [dataset.split_of("dataset-2_walk_normal_001", i) for i in range(30)]
    assert [i for i, s in enumerate(splits) if s == "validation"] == [0, 10, 20]
    assert "test" not in splits


@pytest.fixture
def unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty files named as those of the archives: AMC and Daz in the cache, MotionBuilder in shared/."""
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("POSER_SHARED", str(tmp_path / "shared"))
    for archive, names in (
        ("cache/cmu-amc/cmu-amc/{subject}", ("02_01.amc", "01_01.amc", "135_02.amc", "135.asf")),
        ("cache/cmu-daz-bvh/cmu-daz-bvh",
         ("01_01.bvh", "06_01.bvh", "martial_03.bvh", "salsa_01.bvh", "indian_04.bvh")),
        ("shared/data/cmu-motionbuilder-bvh", ("02_01.bvh", "26_01.bvh", "131_01.bvh")),
    ):  # fmt: skip
        for name in names:
            path = tmp_path / archive.format(subject=name.split(".")[0].split("_")[0]) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    return tmp_path


def test_a_trial_counts_once_from_its_best_source(unpacked: Path) -> None:
    used = [c for c in dataset.every(("cmu",)) if not c.left_out]
    assert {c.name: c.source for c in used} == {
        "01_01": "cmu-amc", "02_01": "cmu-amc", "135_02": "cmu-amc", "06_01": "cmu-daz-bvh",
        "salsa_01": "cmu-daz-bvh", "indian_04": "cmu-daz-bvh", "26_01": "cmu-motionbuilder-bvh",
    }  # fmt: skip
    assert {c.name: c.rate_hz for c in used if c.rate_hz} == {"salsa_01": 60.0}
    assert len({c.name for c in used}) == len(used)
    out = {(c.name, c.source): c.left_out for c in dataset.every(("cmu",)) if c.left_out}
    assert out == {
        ("01_01", "cmu-daz-bvh"): "the same trial, used from cmu-amc",
        ("02_01", "cmu-motionbuilder-bvh"): "the same trial, used from cmu-amc",
        ("martial_03", "cmu-daz-bvh"): "subject 135, used from cmu-amc",
        ("131_01", "cmu-motionbuilder-bvh"): "serves the readers' tests alone",
    }


def test_clips_of_a_split(unpacked: Path) -> None:
    names = {s: [c.name for c in dataset.select(s, ("cmu",))] for s in dataset.SPLITS}
    assert names["test"] == ["02_01"] and names["validation"] == ["06_01"]
    assert names["train"] == ["01_01", "135_02", "26_01", "indian_04", "salsa_01"]
    assert dataset.absent(("cmu",)) == [] and dataset.absent() == ["bandai2-bvh"]


def test_what_is_there_is_used(unpacked: Path) -> None:
    """Without the AMC its trials come from elsewhere, the martial clips too."""
    for path in (unpacked / "cache" / "cmu-amc").rglob("*.amc"):
        path.unlink()
    assert dataset.absent(("cmu",)) == ["cmu-amc"]
    used = {c.name: c.source for c in dataset.every(("cmu",)) if not c.left_out}
    assert used["01_01"] == used["martial_03"] == "cmu-daz-bvh"
    assert used["02_01"] == "cmu-motionbuilder-bvh"


def test_a_collection_that_is_not_there_is_named(unpacked: Path) -> None:
    with pytest.raises(PoserError, match=r"bandai2-bvh holds no \.bvh file: unpack Bandai-Namco"):
        dataset.select("train", ("bandai",))


def test_salsa_is_read_at_its_own_rate(unpacked: Path) -> None:
    walk = motions.walk(3.0, 120.0)
    (clip,) = (c for c in dataset.select("train", ("cmu",)) if c.name == "salsa_01")
    write_motion(clip.path, walk)
    motion = clip.motion(None)
    assert motion.rate_hz == 60.0 and len(motion) == len(walk)
    assert motion.trusted is not None and motion.trusted.all()
    (other,) = (c for c in dataset.select("validation", ("cmu",)) if c.name == "06_01")
    write_motion(other.path, walk)
    assert other.motion(None).rate_hz == pytest.approx(120.0)


def test_no_real_trial_is_on_both_sides(shared: Path) -> None:
    if dataset.absent(("cmu",)):
        pytest.skip("CMU's archives are not unpacked")
    sides = {s: {c.name for c in dataset.select(s, ("cmu",))} for s in dataset.SPLITS}
    names = [n for side in sides.values() for n in side]
    assert len(names) == len(set(names)) > 350
    assert {dataset.subject_of(n) for n in sides["test"]} == {"02", "05", "09"}
    assert {dataset.subject_of(n) for n in sides["validation"]} == {"06", "12", "17", "35"}
    assert not any(n.startswith("martial") for n in names) and "131_01" not in names
