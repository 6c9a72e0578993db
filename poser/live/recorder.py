"""What came from the devices, kept as a raw recording: before any calibration, on the session's clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.recording import RawRecording
from poser import files
from poser.live.alignment import UP_G
from poser.live.assembler import Row
from poser.live.spool import Spool


class Recorder:
    """Writes rows down (`poser.live.spool`) and makes a "poser-raw/1" file of them on `close`.

    sensors: the names of the devices in the order of the rows: their places, where these are known.
    own_headings: each device has a heading of its own. Rows that were left out are invalid in the file.
    """

    def __init__(
        self, path: Path, sensors: tuple[str, ...], rate_hz: float, own_headings: bool = False
    ):
        self._rate_hz, self._width, self._taken = rate_hz, 12 * len(sensors), 0
        head = {"sensors": list(sensors), "rate_hz": rate_hz, "own_headings": own_headings}
        self._spool = Spool(path, self._width, head, _write)

    def take(self, rows: Sequence[Row]) -> None:
        """Keep these rows, which follow those before."""
        for row in rows:
            k = round(row.time_s * self._rate_hz)
            while self._taken < k:
                self._take(np.full(self._width, np.nan))
            self._take(np.concatenate([row.R_world_sensor.ravel(), row.acc_world.ravel()]))

    def _take(self, row: Array) -> None:
        self._spool.append(row)
        self._taken += 1

    def __len__(self) -> int:
        return self._taken

    def close(self) -> None:
        """Write the file; nothing where no row came. Raises OSError where it cannot be written."""
        self._spool.finish()


def _write(path: Path, head: Mapping[str, Any], rows: Array) -> None:
    """acc = R^T (a + g e_y), gyr_t = Log(R_{t-1}^T R_t) rate; NaN where nothing came."""
    sensors, rate_hz = tuple(head["sensors"]), float(head["rate_hz"])
    T, S = len(rows), len(sensors)
    R = rows[:, : 9 * S].astype(float).reshape(T, S, 3, 3)
    has = np.isfinite(R).all((-1, -2))
    R[has] = ori.project(R[has])
    acc = np.einsum("tsji,tsj->tsi", R, rows[:, 9 * S :].astype(float).reshape(T, S, 3) + UP_G)
    gyr = np.full_like(acc, np.nan)
    gyr[1:] = ori.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]) * rate_hz
    # The first sample behind a gap turns as the next one does: nobody saw what was before.
    first = has & ~np.isfinite(gyr).all(-1)
    first[-1] = False
    gyr[first] = np.roll(gyr, -1, axis=0)[first]
    common = not head["own_headings"]
    files.write(path, RawRecording(rate_hz, sensors, gyr, acc, None, R, has, common_heading=common))
