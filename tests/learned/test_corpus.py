"""Clips as compact arrays, and their cache."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from learned import corpus
from learned.corpus import FLIP_RAD, Corpus, key_of, pack, prepared, read
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.formats.amass import write_motion
from mocap.motion import Motion
from mocap.synthesis import second_difference
from tests.learned.swing import wavy


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setenv("POSER_CACHE", str(tmp_path / "cache"))
    out = [tmp_path / f"clip{k}.npz" for k in range(3)]
    for k, path in enumerate(out):
        write_motion(path, wavy(60 + 10 * k, seed=k))
    return out


def cached(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache").glob("*"))


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


def test_flipped_frames_are_marked() -> None:
    R = np.array(wavy(30).R_parent_joint)
    R[12, 15] = ori.rot_y(1.1 * FLIP_RAD)
    motion = wavy(30)
    c = pack([("a", Motion(60.0, R, motion.p_world_root, motion.skeleton))])
    assert np.flatnonzero(~c.sound).tolist() == [12]


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


def test_read_makes_one_cache_and_uses_it(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[tuple[int, int]] = []
    first = read(files, lambda i, n: steps.append((i, n)))
    assert steps == [(1, 3), (2, 3), (3, 3)]
    assert len(cached(tmp_path)) == 1
    monkeypatch.setattr(corpus, "_clips", lambda *_: pytest.fail("read again"))
    again = read(files)
    for name in ("q", "p", "sound", "start", "length", "weight"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    assert again.names == first.names == ("clip0", "clip1", "clip2")


def test_another_selection_or_a_changed_file_is_another_cache(
    files: list[Path], tmp_path: Path
) -> None:
    keys = {key_of(files), key_of(files[:2]), key_of(files[::-1])}
    os.utime(files[0], (1, 1))
    keys.add(key_of(files))
    write_motion(files[0], wavy(90))
    keys.add(key_of(files))
    assert len(keys) == 5


def test_an_interruption_leaves_no_cache(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(corpus.np, "savez", broken)
    with pytest.raises(KeyboardInterrupt):
        read(files)
    assert cached(tmp_path) == []


def test_a_damaged_cache_is_made_anew(files: list[Path], tmp_path: Path) -> None:
    first = read(files)
    (path,) = cached(tmp_path)
    for keep in (0.0, 0.5, 0.99):
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
        np.testing.assert_array_equal(read(files).q, first.q)


def test_what_cannot_train_is_refused(files: list[Path], tmp_path: Path) -> None:
    with pytest.raises(PoserError, match=r"absent\.npz: No such file"):
        read([tmp_path / "absent.npz"])
    (tmp_path / "rec.npz").write_bytes(b"nonsense")
    with pytest.raises(PoserError, match=r"rec\.npz"):
        read([tmp_path / "rec.npz"])
    with pytest.raises(PoserError, match="no motion to train on"):
        pack([])
