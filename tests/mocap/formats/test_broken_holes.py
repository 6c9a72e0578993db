"""Holes in the reference of a pickled data set: bridged where short, cut off at the ends, told always."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap import orientation as ori
from mocap.formats import Document, Options, _holes, dip, totalcapture
from mocap.recording import Recording
from mocap.words import sentence
from tests.mocap.formats import recording_files as files

RATE, FRAMES = 60.0, 60


def _turning(T: int = FRAMES) -> np.ndarray:
    """(T,2,3,3): two joints at constant rates, which a geodesic continues exactly."""
    t = np.arange(T)[:, None, None]
    return ori.exp(t * np.array([[0.02, 0.01, -0.03], [0.0, -0.05, 0.02]]))


def _read(document: Document) -> tuple[Recording, str]:
    assert isinstance(document.content, Recording)
    return document.content, "; ".join(document.warnings)


def test_a_short_hole_is_bridged_on_the_manifold() -> None:
    """At a constant rate the geodesic is the truth; joints that are known keep their values."""
    want = _turning()
    R = want.copy()
    R[20:30, 0] = np.nan
    R[44, 1, 2, 2] = np.inf
    found = _holes.rotations(R, RATE)
    assert found.kept == slice(0, FRAMES)
    np.testing.assert_allclose(found.values, want, atol=1e-12)
    assert tuple(map(sentence, found.notes)) == (
        "11 poses of the reference are not finite: bridged, the longest hole 10 frames",
    )


def test_ends_and_what_lies_beyond_a_long_hole_are_cut_off() -> None:
    R = _turning()
    R[:3, 1] = np.nan
    R[40:57] = np.nan  # 17 frames are more than 0.25 s
    found = _holes.rotations(R, RATE)
    assert found.kept == slice(3, 40)
    np.testing.assert_array_equal(found.values, _turning()[3:40])
    assert tuple(map(sentence, found.notes)) == (
        "frames 0 to 2 and 40 to 59 of 60 are cut off: the reference has a hole there",
    )


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(st.lists(st.tuples(st.integers(0, 59), st.integers(1, 30)), max_size=4))
def test_what_is_left_is_whole_or_untouched(holes: list[tuple[int, int]]) -> None:
    """Any holes: either all is given back, or more than half, without a hole and known at both ends."""
    R = _turning()
    for start, n in holes:
        R[start : start + n] = np.nan
    found = _holes.rotations(R, RATE)
    left = found.kept.stop - found.kept.start
    assert len(found.values) == left
    known = np.isfinite(R).all((1, 2, 3))
    if known.all() or not found.notes:
        np.testing.assert_array_equal(found.values, R)
    else:
        assert 2 * left > FRAMES
        assert known[found.kept][[0, -1]].all()
        np.testing.assert_allclose(found.values, _turning()[found.kept], atol=1e-12)


def test_dip_keeps_the_reference_over_a_short_hole(tmp_path: Path) -> None:
    """gt without the left knee for 5 frames: the angle of a slow swing is bridged to a degree."""
    data = files.dip_data()
    want = files.recording(files.DIP_17).reference
    data["gt"][150:155, 12:15] = np.nan
    rec, said = _read(dip.FORMAT.read(files.dip(tmp_path, data), Options()))
    assert rec.reference is not None and want is not None
    off = np.rad2deg(ori.angle_between(rec.reference.R_parent_joint, want.R_parent_joint))
    assert 0 < off[150:155, 4].max() < 1.0
    off[150:155, 4] = 0
    assert off.max() < 1e-9
    assert "5 poses of the reference are not finite: bridged, the longest hole 5 frames" in said


def test_dip_cuts_sensors_and_reference_together(tmp_path: Path) -> None:
    data = files.dip_data()
    data["gt"][:6], data["gt"][230:] = np.nan, np.nan
    rec, said = _read(dip.FORMAT.read(files.dip(tmp_path, data), Options()))
    want = files.recording(files.DIP_17)
    assert len(rec) == 224 and rec.reference is not None
    assert rec.start_s == rec.reference.start_s == pytest.approx(0.1)
    assert want.reference is not None
    np.testing.assert_allclose(rec.R_world_bone, want.R_world_bone[6:230], atol=1e-9)
    np.testing.assert_allclose(
        rec.reference.R_world_joint, want.reference.R_world_joint[6:230], atol=1e-9
    )
    assert "frames 0 to 5 and 230 to 239 of 240 are cut off" in said


@pytest.mark.parametrize("missing", [slice(0, 120), slice(None), slice(60, 180)])
def test_dip_without_half_of_the_reference_keeps_the_sensors(
    tmp_path: Path, missing: slice
) -> None:
    data = files.dip_data()
    data["gt"][missing] = np.nan
    rec, said = _read(dip.FORMAT.read(files.dip(tmp_path, data), Options()))
    assert len(rec) == 240 and rec.reference is None and rec.start_s == 0
    assert f"{len(data['gt'][missing])} of 240 poses are not finite: no reference" in said


def test_the_release_and_totalcapture_do_as_well(tmp_path: Path) -> None:
    arrays = {k: [s.copy() for s in v] for k, v in files.dip_npz_data().items()}
    arrays["smpl_pose"][0][100:104, 9:18] = np.nan
    arrays["smpl_pose"][1][:] = np.nan
    np.savez(
        tmp_path / "own.npz",
        **{k: files.objects(v) for k, v in arrays.items()},  # type: ignore[arg-type]
    )
    rec, said = _read(dip.FORMAT.read(tmp_path / "own.npz", Options()))
    assert rec.reference is not None and "4 poses of the reference are not finite" in said
    second = dip.read_release(tmp_path / "own.npz")[1]
    assert second.reference is None
    assert second.notes[1] == "238 of 238 poses are not finite: no reference"

    data = files.tc_pkl_data()
    data["gt"][:2] = np.nan
    rec, said = _read(totalcapture.FORMAT.read(files.tc_pkl(tmp_path, data), Options()))
    assert rec.reference is not None and len(rec) == len(rec.reference) == 237
    assert "frames 0 to 1 of 239 are cut off" in said
