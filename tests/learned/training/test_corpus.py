"""Clips as compact arrays, and their cache."""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learned.training import corpus
from learned.training.corpus import Corpus, frames, key_of, pack, prepared, read
from mocap import formats
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.formats.amass import write_motion
from mocap.seats import second_difference
from tests.learned.swing import wavy


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    out = [tmp_path / f"clip{k}.npz" for k in range(3)]
    for k, path in enumerate(out):
        write_motion(path, wavy(60 + 10 * k, seed=k))
    return out


def entries(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache" / "clips").glob("*"))


def same(found: Corpus, want: Corpus) -> None:
    for name in ("q", "p", "sound", "start", "length", "weight"):
        np.testing.assert_array_equal(getattr(found, name), getattr(want, name))
    assert found.names == want.names


def test_pack_keeps_the_motion() -> None:
    a, b = wavy(50, seed=1), wavy(70, rate_hz=120.0, seed=2)
    c = pack([("a", a), ("b", b)])
    assert c.names == ("a", "b") and c.length.tolist() == [50, 35] and c.start.tolist() == [0, 50]
    np.testing.assert_allclose(ori.from_quat(c.q[:50]), a.R_parent_joint, atol=1e-6)
    np.testing.assert_allclose(c.p[50:], b.resampled(60.0).p_world_root, atol=1e-6)
    # Neighbouring quaternions of a clip lie on one hemisphere.
    assert (np.sum(c.q[1:50] * c.q[:49], axis=-1) > 0.9).all()
    np.testing.assert_allclose(c.weight, np.sqrt([50, 35]) / np.sqrt([50, 35]).sum())
    assert c.seconds == pytest.approx(85 / 60)


def test_frames_that_are_not_trusted_do_not_train() -> None:
    trusted = np.arange(30) != 12
    c = pack([("a", wavy(30)), ("b", replace(wavy(30), trusted=trusted))])
    assert np.flatnonzero(~c.sound).tolist() == [42]


def test_a_file_with_a_flip_is_mended_before_the_low_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    clean, R = wavy(240, rate_hz=120.0), np.array(wavy(240, rate_hz=120.0).R_parent_joint)
    R[100:108, 20] = R[100:108, 20] @ ori.rot_z(np.pi)
    write_motion(tmp_path / "clean.npz", clean)
    write_motion(tmp_path / "flip.npz", replace(clean, R_parent_joint=R))
    want, found = (read([tmp_path / f"{n}.npz"]) for n in ("clean", "flip"))
    assert np.abs(found.q - want.q).max() < 0.02 and found.sound.all()
    frames, untrusted, mended = corpus.counts(tmp_path / "flip.npz")
    assert frames == len(want.q) and untrusted == 0 and 4 <= mended <= 8


def test_subsets_are_nested_and_join_weighs_by_shares() -> None:
    c = pack([(f"c{k}", wavy(20, seed=k)) for k in range(8)])
    small, large = c.subset(0.25, seed=3), c.subset(0.5, seed=3)
    assert len(small.names) == 2 and len(large.names) == 4
    assert set(small.names) < set(large.names)
    assert small.weight.sum() == pytest.approx(1.0)
    both = Corpus.join([small, large], (0.9, 0.1))
    assert both.weight[:2].sum() == pytest.approx(0.9)
    # Each clip of the join still starts at its own frames.
    for part, at in ((small, 0), (large, 2)):
        for k, name in enumerate(part.names):
            first = both.q[both.start[at + k]]
            np.testing.assert_array_equal(first, c.q[c.start[c.names.index(name)]])


def test_a_slow_motion_has_no_spikes_in_its_accelerations() -> None:
    """30 Hz brought to 60: second differences follow the motion's own, not its frames' kinks."""
    fast, slow = wavy(600), wavy(300, rate_hz=30.0)
    want = second_difference(fast.p_world_joint, 60.0)[30:-30, 20]
    found = second_difference(prepared(slow).p_world_joint, 60.0)[30 : 30 + len(want), 20]
    kinked = second_difference(slow.resampled(60.0).p_world_joint, 60.0)[30 : 30 + len(want), 20]
    size = np.abs(want).mean()
    n = min(len(want), len(found))
    assert np.abs(found[:n] - want[:n]).mean() < 0.1 * size
    assert np.abs(kinked[:n] - want[:n]).mean() > 0.5 * size


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that are read, not taken from the cache."""
    reader, names = corpus.formats.read, []

    def read_file(path: Path) -> formats.Document:
        names.append(path.name)
        return reader(path)

    monkeypatch.setattr(corpus.formats, "read", read_file)
    return names


def test_read_takes_each_file_once(files: list[Path], tmp_path: Path, made: list[str]) -> None:
    steps: list[tuple[int, int]] = []
    first = read(files, lambda i, n: steps.append((i, n)))
    assert steps == [(1, 3), (2, 3), (3, 3)]
    assert len(entries(tmp_path)) == 3 and len(made) == 3
    assert first.names == tuple(str(p) for p in files)
    clips = [(str(p), prepared(wavy(60 + 10 * k, seed=k))) for k, p in enumerate(files)]
    np.testing.assert_allclose(first.q, pack(clips).q, atol=1e-6)
    same(read(files), first)
    assert len(made) == 3


def test_a_file_more_and_a_changed_one_cost_one_reading_each(
    files: list[Path], tmp_path: Path, made: list[str]
) -> None:
    """And leave nothing behind: the changed file's entry is replaced."""
    read(files[:2])
    assert read(files).length.tolist() == [60, 70, 80]
    assert made == ["clip0.npz", "clip1.npz", "clip2.npz"]
    write_motion(files[0], wavy(90))
    assert read(files).length.tolist() == [90, 70, 80]
    assert made[3:] == ["clip0.npz"] and len(entries(tmp_path)) == 3


def test_a_clip_too_short_to_train_is_read_once_too(
    files: list[Path], tmp_path: Path, made: list[str]
) -> None:
    write_motion(files[1], wavy(7))
    for _ in range(2):
        assert read(files).length.tolist() == [60, 80]
    assert len(made) == 3


def test_keys_do_not_change_from_version_to_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are kept in the states of runs: with another key those could not go on."""
    path = tmp_path / "a.npz"
    path.write_bytes(b"12345")
    os.utime(path, ns=(7, 7))
    want = hashlib.sha256(f"5{path.resolve()}|5|7\n".encode()).hexdigest()[:16]
    assert key_of([path]) == want


def test_another_selection_or_a_changed_file_is_another_cache(
    files: list[Path], tmp_path: Path
) -> None:
    keys = {key_of(files), key_of(files[:2]), key_of(files[::-1])}
    os.utime(files[0], (1, 1))
    keys.add(key_of(files))
    write_motion(files[0], wavy(90))
    keys.add(key_of(files))
    assert len(keys) == 5


def test_an_interrupted_reading_goes_on_where_it_was(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: list[str]
) -> None:
    savez = np.savez

    def broken(path: Path, **arrays: object) -> None:
        if len(entries(tmp_path)) == 2:  # a finished one and the one that is being written
            raise KeyboardInterrupt
        savez(path, **arrays)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(corpus.np, "savez", broken)
        with pytest.raises(KeyboardInterrupt):
            read(files)
    assert len(entries(tmp_path)) == 1  # nothing half written
    made.clear()
    read(files)
    assert made == ["clip1.npz", "clip2.npz"]


def test_a_damaged_cache_is_made_anew(files: list[Path], tmp_path: Path) -> None:
    first = read(files)
    path = entries(tmp_path)[1]
    for keep in (0.0, 0.5, 0.99):
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
        same(read(files), first)
    whole = path.read_bytes()
    heads = [k + at for k in places(whole, b"PK\x01\x02") for at in (8, 10, 16, 20, 28, 46)]
    heads += [k + at for k in places(whole, b"\x93NUMPY") for at in (0, 6, 8, 15, 22, 64, 68, 75)]
    flips = [(at, bit) for at in [*heads, len(whole) // 2] for bit in (1, 64)]
    damaged = [whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1 :] for at, bit in flips]
    damaged.append(re.sub(rb"\(\d\d,\)", b"(10,)", whole))  # an array that says that it is shorter
    for content in damaged:
        assert content != whole
        path.write_bytes(content)
        same(read(files), first)


def places(whole: bytes, mark: bytes) -> list[int]:
    """Where a mark is: of zip's directory of arrays, or of an array's own head."""
    return [k for k in range(len(whole)) if whole.startswith(mark, k)]


def test_a_file_that_cannot_be_read_is_left_out_where_somebody_is_told(
    files: list[Path], tmp_path: Path
) -> None:
    files[1].write_bytes(files[1].read_bytes()[:2000])
    told: list[tuple[Path, PoserError]] = []
    found = frames(files, unreadable=lambda path, error: told.append((path, error)))
    assert found == {files[0]: 60, files[2]: 80}
    same(corpus.cached(found), read([files[0], files[2]]))
    ((path, error),) = told
    assert path == files[1] and "clip1.npz" in str(error)
    with pytest.raises(PoserError, match=r"none of the motions can be read: .*clip1\.npz"):
        frames(files[1:2], unreadable=lambda *_: None)
    with pytest.raises(PoserError, match=r"clip1\.npz"):
        read(files)


def test_what_cannot_train_is_refused(files: list[Path], tmp_path: Path) -> None:
    with pytest.raises(PoserError, match=r"absent\.npz: No such file"):
        read([tmp_path / "absent.npz"])
    (tmp_path / "rec.npz").write_bytes(b"nonsense")
    with pytest.raises(PoserError, match=r"rec\.npz"):
        read([tmp_path / "rec.npz"])
    with pytest.raises(PoserError, match="no motion to train on"):
        pack([])
