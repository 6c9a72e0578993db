"""DIP-IMU: the pickles of the recording sessions, and the npz release that networks are trained on.

Pickle: `imu_ori` (N,17,3,3) bone orientations in the y-up SMPL world, `imu_acc` (N,17,3) m/s^2 in that
world without gravity, `gt` (N,72) SMPL axis-angle; 60 Hz, no translation, no shape; NaN where a sensor
dropped out.

npz: sequences of `orientation` (T,45), `acceleration` (T,15), `smpl_pose` (T,135): five sensors (the six
without the pelvis) relative to the pelvis sensor, R_p^T R_s and R_p^T (a_s - a_p), and the local
rotations of 15 joints, all as flattened matrices. The pelvis' own orientation is not in the file.
"""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Document, Format, Options, _checks, _holes, _npz, _physics, _pickled
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.sensors import SIX
from mocap.words import sentence

SENSORS: tuple[str, ...] = (
    "head", "sternum", "pelvis", "left_shoulder_blade", "right_shoulder_blade", "left_upper_arm",
    "right_upper_arm", "left_forearm", "right_forearm", "left_thigh", "right_thigh", "left_shank",
    "right_shank", "left_hand", "right_hand", "left_foot", "right_foot",
)  # fmt: skip
"""The 17 in the order of the file: head, spine2, belly, chest, shoulder, elbow, hip, knee, wrist, ankle."""

JOINTS_15 = (1, 2, 3, 4, 5, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19)
"""Joints of `smpl_pose`; the others (pelvis, ankles, feet, wrists, hands) are the identity there."""

RATE = 60.0
_RELEASE = ("orientation", "acceleration", "smpl_pose")
MAX_SEQUENCES = 100_000


def _read_pickle(path: Path, options: Options) -> Document:
    data = _pickled.fields(path)
    R, acc, pose = (_pickled.array(path, data, n) for n in ("imu_ori", "imu_acc", "gt"))
    T = len(R)
    for name, value, shape in (
        ("imu_ori", R, (T, 17, 3, 3)), ("imu_acc", acc, (T, 17, 3)), ("gt", pose, (T, 72)),
    ):  # fmt: skip
        if value.shape != shape or not T:
            raise FormatError(path, f"is {value.shape}, expected {shape}", f"field {name}")
    rate = options.rate_hz or RATE
    R = _checks.rotations(path, R, SENSORS, "imu_ori")
    whole = _holes.poses(pose, rate)
    start_s = whole.kept.start / rate
    motion, doubts = _pickled.reference(path, rate, whole.values, _pickled.body(options), start_s)
    R, acc = R[whole.kept], acc[whole.kept] * _physics.factors(options)[0]
    rec = Recording(rate, SENSORS, R, acc, reference=motion, start_s=start_s)
    assumed = (
        assumption("rate-of-data-set", rate_hz=rate),
        assumption("pelvis-stays"),
    )
    doubts = [*whole.notes, *doubts, *_physics.calibrated(path, rec)]
    return Document("dip", rec, assumed, tuple(doubts))


def read_release(path: str | Path, options: Options | None = None) -> list[Recording]:
    """All sequences of an npz release, as recordings in the frame of the pelvis.

    Six sensors; the pelvis reads the identity and no acceleration, so the world's vertical and heading
    are lost. Raises FormatError naming the sequence and field that does not fit.
    """
    return [recording for recording, _ in _release(Path(path), options or Options())]


def _release(path: Path, options: Options) -> list[tuple[Recording, tuple[Finding, ...]]]:
    """The sequences, and what is doubtful about each."""
    columns = {name: _sequences(path, name) for name in _RELEASE}
    counts = {name: len(c) for name, c in columns.items()}
    if len(set(counts.values())) != 1:
        found = ", ".join(f"{v} of {k}" for k, v in counts.items())
        raise FormatError(path, f"holds {found}, expected as many of each")
    together = zip(*columns.values(), strict=True)
    return [_sequence(path, i, parts, options) for i, parts in enumerate(together)]


def _sequences(path: Path, name: str) -> list[Any]:
    """The sequences of one array: rows of an object array, or of an ordinary (clips, T, k) one."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as stream:
            pickled = b"|O" in stream.read(256).split(b"\n", 1)[0]
    except KeyError as e:
        raise FormatError(path, f"array {name!r} is missing") from e
    except _npz.BROKEN as e:
        raise FormatError(path, "not a whole .npz archive: damaged or cut short") from e
    if pickled:
        found: Any = _npz.load_objects(path, name)
    else:
        found = _npz.load(path, (name,))[name]
    if getattr(found, "ndim", 1) == 2 and not pickled:
        found = [found]
    if not isinstance(found, np.ndarray | list) or not 1 <= len(found) <= MAX_SEQUENCES:
        raise FormatError(path, f"array {name!r} holds no list of sequences")
    return list(found)


def _sequence(
    path: Path, index: int, parts: tuple[Any, ...], options: Options
) -> tuple[Recording, tuple[Finding, ...]]:
    """One sequence from its orientation (T,45), acceleration (T,15) and smpl_pose (T,135)."""
    where = f"sequence {index}"
    R5, acc5, R15 = (
        _pickled.numbers(path, value, f"{where}: {name}")
        for name, value in zip(_RELEASE, parts, strict=True)
    )
    T = len(R5)
    for name, value, width in zip(_RELEASE, (R5, acc5, R15), (45, 15, 135), strict=True):
        if value.shape != (T, width) or not T:
            raise FormatError(
                path, f"is {value.shape}, expected ({T}, {width})", f"{where}: {name}"
            )
    names = SIX[:5]
    R = np.tile(np.eye(3), (T, 6, 1, 1))
    R[:, :5] = _checks.rotations(path, R5.reshape(T, 5, 3, 3), names, f"{where}: orientation")
    acc = np.full((T, 6, 3), np.nan)
    acc[:, :5] = acc5.reshape(T, 5, 3) * _physics.factors(options)[0]
    joints = tuple(f"joint {j}" for j in JOINTS_15)
    local = _checks.rotations(path, R15.reshape(T, 15, 3, 3), joints, f"{where}: smpl_pose")
    rate, body = options.rate_hz or RATE, _pickled.body(options)
    whole = _holes.rotations(local, rate)
    local, kept, start_s = whole.values, whole.kept, whole.kept.start / rate
    reference, notes = None, whole.notes
    if np.isfinite(local).all():
        R24 = np.tile(np.eye(3), (len(local), 24, 1, 1))
        R24[:, JOINTS_15] = local
        reference = Motion(rate, R24, np.tile(body.offsets[0], (len(local), 1)), body, start_s)
    else:
        bad = int((~np.isfinite(local).all((1, 2, 3))).sum())
        notes = (doubt("no-reference", poses=bad, of=T),)
    return Recording(
        rate,
        SIX,
        R[kept],
        acc[kept],
        reference=reference,
        start_s=start_s,
        notes=("in the pelvis frame", *map(sentence, notes)),
    ), notes


def _read_release(path: Path, options: Options) -> Document:
    recordings = _release(path, options)
    rec, own = recordings[0]
    doubts = []
    if len(recordings) > 1:
        doubts.append(doubt("one-of-sequences", sequences=len(recordings)))
    assumed = (
        assumption("rate-of-data-set", rate_hz=options.rate_hz or RATE),
        assumption("pelvis-frame"),
    )
    # No test of mean acceleration: in the pelvis' turning frame it is not zero. The pelvis itself has
    # none in it.
    acc = np.array(rec.acc_world)
    acc[:, SIX.index("pelvis")] = 0
    doubts += [*own, *_checks.gap_report(rec.valid, rec.sensors)]
    doubts += _physics.against_reference(path, replace(rec, acc_world=acc))
    return Document("dip", rec, assumed, tuple(doubts))


def _read(path: Path, options: Options) -> Document:
    return (_read_release if path.suffix.lower() == ".npz" else _read_pickle)(path, options)


def _sniff(path: Path, head: bytes) -> bool:
    if path.suffix.lower() == ".npz":
        return set(_RELEASE) <= _npz.names(path)
    return _pickled.mentions(path, b"imu_ori")


FORMAT = Format(
    "dip",
    (".pkl", ".npz"),
    _sniff,
    _checks.quiet(_read),
    kinds=("recording",),
    about="DIP-IMU: pickles of its sessions, or its .npz release",
    sign="DIP-IMU",
)
