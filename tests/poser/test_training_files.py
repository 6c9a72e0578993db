"""Which files a run reads: each once, whatever the way it was found; none on both sides."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap import formats
from mocap.errors import PoserError
from mocap.formats import amass
from poser import training_files
from poser.console import UsageError


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """a.npz, b.npz of one size; in it/ a copy of a.npz and a link to b.npz."""
    for name in "ab":
        (tmp_path / f"{name}.npz").write_bytes(name.encode() * 300_000)
    inner = tmp_path / "it"
    inner.mkdir()
    (inner / "copy.npz").write_bytes(b"a" * 300_000)
    (inner / "link.npz").symlink_to(tmp_path / "b.npz")
    return tmp_path


def test_a_file_counts_once(many: Path) -> None:
    a, b, copy, link = (many / n for n in ("a.npz", "b.npz", "it/copy.npz", "it/link.npz"))
    assert training_files.recordings([many]) == [a, b]
    assert training_files.recordings([many / "it", many]) == [copy, link]
    assert training_files.recordings([b, b, many / "it" / ".." / "b.npz", link]) == [b]


def test_a_difference_anywhere_makes_two(many: Path) -> None:
    """Neither the size nor the ends alone decide."""
    middle = bytearray(b"a" * 300_000)
    middle[150_000] = 0
    (many / "middle.npz").write_bytes(middle)
    once, again = training_files.distinct([many / "a.npz", many / "middle.npz", many / "b.npz"])
    assert len(once) == 3 and again == []


@given(st.lists(st.sampled_from(range(6)), min_size=1, max_size=12))
def test_what_is_left_is_the_set_of_contents(
    tmp_path_factory: pytest.TempPathFactory, contents: list[int]
) -> None:
    """Any list of files: one of each content, the first, in its order."""
    top = tmp_path_factory.mktemp("any")
    paths = [top / f"{k}.npz" for k in range(len(contents))]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(bytes([content]) * (1 + content % 2))
    once, again = training_files.distinct(paths)
    first = [k for k, c in enumerate(contents) if c not in contents[:k]]
    assert once == [paths[k] for k in first]
    assert sorted(once + again) == sorted(paths)


def test_the_same_motion_on_both_sides_is_refused(many: Path) -> None:
    train = [many / "a.npz", many / "b.npz"]
    training_files.check_apart(train[:1], train[1:])
    with pytest.raises(UsageError, match=r"copy\.npz: would both train and validate"):
        training_files.check_apart(train, [many / "it" / "copy.npz"])


def test_an_absent_file_and_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(PoserError, match=r"absent\.npz: no such file"):
        training_files.recordings([tmp_path / "absent.npz"])
    with pytest.raises(PoserError, match=f"no motion file in {tmp_path}"):
        training_files.motions([tmp_path])
    (tmp_path / "broken.npz").symlink_to(tmp_path / "nowhere")
    with pytest.raises(PoserError, match=r"broken\.npz: no such file"):
        training_files.recordings([tmp_path])


def test_a_file_that_may_not_be_opened_does_not_end_the_search(
    many: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(path: Path) -> formats.Format:
        if path.name == "a.npz":
            raise PermissionError(13, "Permission denied")
        return amass.FORMAT

    monkeypatch.setattr(formats, "detect", closed)
    found = training_files.motions([many])
    assert many / "b.npz" in found and many / "a.npz" not in found
