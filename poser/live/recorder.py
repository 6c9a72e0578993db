"""What came from the devices, kept as a raw recording: before any calibration, on the session's clock."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.recording import RawRecording
from poser import files
from poser.live.alignment import UP_G
from poser.live.assembler import Row


class Recorder:
    """Keeps rows and writes them on `close`, aside and then renamed, as a "poser-raw/1" file.

    sensors: the names of the devices in the order of the rows: their places, where these are known.
    own_headings: each device has a heading of its own. Rows that were left out are invalid in the file.
    """

    def __init__(
        self, path: Path, sensors: tuple[str, ...], rate_hz: float, own_headings: bool = False
    ):
        self._path, self._sensors, self._rate_hz = path, sensors, rate_hz
        self._own_headings = own_headings
        self._R: list[Array] = []
        self._acc: list[Array] = []
        self._lost = (np.full((len(sensors), 3, 3), np.nan, np.float32),
                      np.full((len(sensors), 3), np.nan, np.float32))  # fmt: skip

    def take(self, rows: Sequence[Row]) -> None:
        """Keep these rows, which follow those before."""
        for row in rows:
            k = round(row.time_s * self._rate_hz)
            while len(self._R) < k:
                self._R.append(self._lost[0])  # type: ignore[arg-type]
                self._acc.append(self._lost[1])  # type: ignore[arg-type]
            # float32 halves the memory of an hour, and is what the file holds.
            self._R.append(row.R_world_sensor.astype(np.float32))
            self._acc.append(row.acc_world.astype(np.float32))

    def __len__(self) -> int:
        return len(self._R)

    def close(self) -> None:
        """Write the file; nothing where no row came. Raises OSError where it cannot be written."""
        if self._R:
            files.write(self._path, self.recording())

    def recording(self) -> RawRecording:
        """The rows so far: acc = R^T (a + g e_y), gyr_t = Log(R_{t-1}^T R_t) rate; NaN where nothing came."""
        R = np.array(self._R, float)
        has = np.isfinite(R).all((-1, -2))
        R[has] = ori.project(R[has])
        acc = np.einsum("tsji,tsj->tsi", R, np.array(self._acc, float) + UP_G)
        gyr = np.full_like(acc, np.nan)
        gyr[1:] = ori.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]) * self._rate_hz
        # The first sample behind a gap turns as the next one does: nobody saw what was before.
        first = has & ~np.isfinite(gyr).all(-1)
        first[-1] = False
        gyr[first] = np.roll(gyr, -1, axis=0)[first]
        return RawRecording(
            self._rate_hz, self._sensors, gyr, acc, None, R, has,
            common_heading=not self._own_headings,
        )  # fmt: skip
