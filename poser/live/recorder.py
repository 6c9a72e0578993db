"""What came from the devices, kept on the session's clock: a raw recording, before any calibration, or, of
devices that send orientations of bones, a recording that needs none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.formats import _holes, mvnx
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording, Recording
from mocap.skeleton import JOINTS, PARENTS, Skeleton
from poser import files
from poser.console import complain
from poser.live.alignment import UP_G
from poser.live.assembler import Row
from poser.live.spool import Spool

WHOLE = 9 * len(JOINTS) + 3  # numbers of a reference pose
Whole = Callable[[float], tuple[Array, Array] | None]
"""R_world_joint (24,3,3) and the middle between the hips (3,) m at a row's time, where it is known."""


class Recorder:
    """Writes rows down (`poser.live.spool`) and makes a file of them on `close`: whole or not there.

    sensors: the names of the devices in the order of the rows: their places, where these are known. Rows
    that were left out are invalid in the file. own_headings: each device has a heading of its own. bones: the
    rows are of bones, and the file is a "poser-recording/1", else a "poser-raw/1". reference: what another
    has solved (`Whole`) is kept with the bones as a motion of this skeleton.
    """

    def __init__(
        self,
        path: Path,
        sensors: tuple[str, ...],
        rate_hz: float,
        own_headings: bool = False,
        bones: bool = False,
        reference: Skeleton | None = None,
    ):
        head = {"sensors": list(sensors), "rate_hz": rate_hz, "own_headings": own_headings}
        if reference is not None:
            head["offsets"] = reference.offsets.tolist()
        self._rate_hz, self._taken, self._has_reference = rate_hz, 0, reference is not None
        self._width = 12 * len(sensors) + (WHOLE if self._has_reference else 0)
        self._spool = Spool(path, self._width, head, _write_bones if bones else _write_raw)

    def take(self, rows: Sequence[Row], whole: Whole = lambda _: None) -> None:
        """Keep these rows, which follow those before."""
        for row in rows:
            k = round(row.time_s * self._rate_hz)
            while self._taken < k:
                self._take(np.full(self._width, np.nan))
            parts = [row.R_world_sensor.ravel(), row.acc_world.ravel()]
            if self._has_reference:
                found = whole(row.time_s)
                none = np.full(WHOLE, np.nan)
                parts.append(none if found is None else np.r_[found[0].ravel(), found[1]])
            self._take(np.concatenate(parts))

    def _take(self, row: Array) -> None:
        self._spool.append(row)
        self._taken += 1

    def __len__(self) -> int:
        return self._taken

    def close(self) -> None:
        """Write the file; nothing where no row came. Raises OSError where it cannot be written."""
        self._spool.finish()


def _measured(rows: Array, S: int) -> tuple[Array, Array, Bool]:
    """R (T,S,3,3), acc (T,S,3), and where there is an R (T,S)."""
    R = rows[:, : 9 * S].astype(float).reshape(len(rows), S, 3, 3)
    has: Bool = np.asarray(np.isfinite(R).all((-1, -2)))
    R[has] = ori.project(R[has])
    return R, rows[:, 9 * S : 12 * S].astype(float).reshape(len(rows), S, 3), has


def _write_raw(path: Path, head: Mapping[str, Any], rows: Array) -> None:
    """acc = R^T (a + g e_y), gyr_t = Log(R_{t-1}^T R_t) rate; NaN where nothing came."""
    sensors, rate_hz = tuple(head["sensors"]), float(head["rate_hz"])
    R, acc_world, has = _measured(rows, len(sensors))
    acc = np.einsum("tsji,tsj->tsi", R, acc_world + UP_G)
    gyr = np.full_like(acc, np.nan)
    gyr[1:] = ori.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]) * rate_hz
    # The first sample behind a gap turns as the next one does: nobody saw what was before.
    first = has & ~np.isfinite(gyr).all(-1)
    first[-1] = False
    gyr[first] = np.roll(gyr, -1, axis=0)[first]
    common = not head["own_headings"]
    files.write(path, RawRecording(rate_hz, sensors, gyr, acc, None, R, has, common_heading=common))


def _write_bones(path: Path, head: Mapping[str, Any], rows: Array) -> None:
    sensors, rate_hz = tuple(head["sensors"]), float(head["rate_hz"])
    R, acc, has = _measured(rows, len(sensors))
    motion, kept = None, slice(0, len(rows))
    if "offsets" in head:
        motion, kept = _reference(head, rows[:, 12 * len(sensors) :].astype(float))
        if motion is None:
            complain(f"{path}: too much of the reference is missing; it is left out", "live")
    recording = Recording(
        rate_hz,
        sensors,
        R[kept],
        acc[kept],
        has[kept],
        reference=motion,
        start_s=kept.start / rate_hz,
    )
    files.write(path, recording)


def _reference(head: Mapping[str, Any], whole: Array) -> tuple[Motion | None, slice]:
    """The reference (T,WHOLE) as a motion of the frames that are kept: holes are mended as in files."""
    body, rate_hz, T = (
        Skeleton(JOINTS, PARENTS, np.array(head["offsets"])),
        head["rate_hz"],
        len(whole),
    )
    mended = _holes.rotations(whole[:, :-3].reshape(T, len(JOINTS), 3, 3), rate_hz)
    if not np.isfinite(mended.values).all():
        return None, slice(0, T)
    R, seen = ori.project(mended.values), np.isfinite(whole[:, -3:]).all(axis=1)
    every, known = np.arange(T)[mended.kept], np.flatnonzero(seen)
    hips = np.stack([np.interp(every, known, whole[known, k]) for k in (-3, -2, -1)], axis=1)
    start_s = mended.kept.start / rate_hz
    root = mvnx.root(hips, R[:, 0], body)
    return Motion(rate_hz, body.local_rotations(R), root, body, start_s), mended.kept
