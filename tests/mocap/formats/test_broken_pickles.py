"""Broken pickled data sets: DIP-IMU, its npz release, TotalCapture's pickles (see `broken`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap.formats import Format, dip, totalcapture
from tests.mocap.formats import recording_files as files
from tests.mocap.formats.broken import (
    LEFT_HANDED,
    Break,
    Cases,
    cut,
    must_fail,
    must_read,
    one,
    parameters,
)


def _pkl(
    write: Callable[..., Path], data: Callable[[], dict[str, np.ndarray]]
) -> Callable[..., Break]:
    """Cases of a pickle: fields changed by a function, replaced, or dropped (None)."""

    def case(**changes: object) -> Break:
        def make(folder: Path) -> Path:
            fields: dict[str, object] = dict(data())
            for name, change in changes.items():
                fields[name] = change(fields[name]) if callable(change) else change
                if change is None:
                    del fields[name]
            return write(folder, fields)

        return make

    return case


_dip, _tc = _pkl(files.dip, files.dip_data), _pkl(files.tc_pkl, files.tc_pkl_data)


def _evil(write: Callable[..., Path]) -> Break:
    """A pickle that would write a file when loaded, in the place of the poses."""

    def make(folder: Path) -> Path:
        fields = {"imu_ori": 0, "ori": 0, "acc": 0, "gt": files.Evil(folder / "executed")}
        return write(folder, fields)

    return make


DIP: Cases = {
    "cut": (lambda d: cut(files.dip(d), 0.5), "not a whole pickle: damaged or cut short"),
    "empty": (lambda d: cut(files.dip(d), 0.0), "not a whole pickle"),
    "malicious": (_evil(files.dip), "asks for '.*'; only arrays and plain containers"),
    "huge count": (_dip(imu_ori=files.LyingArray((10**12,))), "arrays|damaged|declares"),
    "a list": (lambda d: files.dip(d, ["imu_ori"]), "holds a list, expected a dictionary"),
    "no acc": (_dip(imu_acc=None), "field 'imu_acc' is missing"),
    "16 sensors": (_dip(imu_ori=lambda R: R[:, 1:]), r"imu_ori: is \(240, 16, 3, 3\), expected"),
    "other length": (_dip(gt=lambda p: p[:-1]), r"gt: is \(239, 72\), expected \(240, 72\)"),
    "no frames": (_dip(imu_ori=lambda R: R[:0]), "imu_ori: is"),
    "text": (_dip(gt="abc"), "field gt: is a str, expected an array"),
    "ragged": (_dip(gt=[[1.0], [1.0, 2.0]]), "field gt: is a list, expected an array"),
    "left-handed": (
        _dip(imu_ori=lambda R: R @ LEFT_HANDED), "frame 0, sensor head: imu_ori: left-handed"
    ),
    "not orthonormal": (
        _dip(imu_ori=lambda R: one(R, (9, 2), 1.3 * R[9, 2])), "frame 9, sensor pelvis: imu_ori: not"
    ),
    "in g": (_dip(imu_acc=lambda a: a / 9.81), "0.1 times what the reference motion gives: in g"),
    "gravity in": (_dip(imu_acc=lambda a: a + np.array([0, 9.81, 0])), "gravity must be removed"),
    "in degrees": (_dip(gt=lambda p: 200 * p), "expected radians"),
}  # fmt: skip


def _release(**changes: object) -> Break:
    def make(folder: Path) -> Path:
        arrays = {k: files.objects(v) for k, v in files.dip_npz_data().items()}  # type: ignore[arg-type]
        for name, change in changes.items():
            arrays[name] = change(arrays[name]) if callable(change) else change
            if change is None:
                del arrays[name]
        np.savez(folder / "own.npz", **arrays)
        return folder / "own.npz"

    return make


def _thinner(sequences: np.ndarray) -> np.ndarray:
    return files.objects([s[:, 1:] for s in sequences])


def _reflected(sequences: np.ndarray) -> np.ndarray:
    left = [s.reshape(-1, 5, 3, 3) @ LEFT_HANDED for s in sequences]
    return files.objects([R.reshape(-1, 45) for R in left])


RELEASE: Cases = {
    "cut": (lambda d: cut(files.dip_npz(d), 0.5), "damaged or cut short"),
    "empty": (lambda d: cut(files.dip_npz(d), 0.0), "damaged or cut short"),
    "left-handed": (
        _release(orientation=_reflected),
        "frame 0, sensor left_forearm: sequence 0: orientation: left-handed",
    ),
    "in g": (
        _release(acceleration=lambda a: files.objects([s / 9.81 for s in a])),
        "0.1. times what the reference motion gives: in g",
    ),
    "huge count": (
        lambda d: files.with_member(
            files.dip_npz(d), d / "lie.npz", "orientation.npy", files.lying_npy((10**12,))
        ),
        "declares 8000000000",
    ),
    "no poses": (_release(smpl_pose=None), "array 'smpl_pose' is missing"),
    "fewer": (_release(smpl_pose=lambda a: a[:1]), "holds 2 of orientation, 2 of .* 1 of smpl_pose"),
    "thin": (_release(orientation=_thinner), r"sequence 0: orientation: is \(238, 44\)"),
    "normalised": (
        _release(orientation=lambda a: files.objects([3 * s for s in a])),
        "frame 0, sensor left_forearm: sequence 0: orientation: not orthonormal",
    ),
    "evil": (
        lambda d: _release(orientation=files.objects([files.Evil(d / "executed")] * 2))(d), "."
    ),
}  # fmt: skip

PICKLED: Cases = {
    "cut": (lambda d: cut(files.tc_pkl(d), 0.5), "not a whole pickle: damaged or cut short"),
    "empty": (lambda d: cut(files.tc_pkl(d), 0.0), "not a whole pickle"),
    "malicious": (_evil(files.tc_pkl), "asks for '.*'; only arrays and plain containers"),
    "huge count": (_tc(ori=files.LyingArray((10**12,))), "arrays|damaged|declares"),
    "not orthonormal": (_tc(ori=lambda R: 1.3 * R), "frame 0, sensor left_shank: ori: not orthonormal"),
    "in g": (_tc(acc=lambda a: a / 9.81), "0.1 times what the reference motion gives: in g"),
    "in degrees": (_tc(gt=lambda p: 200 * p), "expected radians"),
    "no gt": (_tc(gt=None), "field 'gt' is missing"),
    "seven": (_tc(ori=lambda R: np.repeat(R, 2, axis=1)), r"field ori: is \(240, 12, 3, 3\)"),
    "far shorter": (_tc(gt=lambda p: p[:100]), "have 240, 239 and 100 frames"),
    "left-handed": (_tc(ori=lambda R: R @ LEFT_HANDED), "sensor left_shank: ori: left-handed"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("reader", "make", "message"),
    parameters((dip.FORMAT, DIP), (dip.FORMAT, RELEASE), (totalcapture.FORMAT, PICKLED)),
)
def test_broken(reader: Format, make: Break, message: str, tmp_path: Path) -> None:
    must_fail(make(tmp_path), reader, message)
    assert not (tmp_path / "executed").exists()


def test_good_files_pass(tmp_path: Path) -> None:
    """The files that the cases break are themselves read without an error."""
    for module, write in ((dip, files.dip), (dip, files.dip_npz), (totalcapture, files.tc_pkl)):
        must_read(write(tmp_path), module.FORMAT)
