"""From the sensors' own axes to bones: a calibration applied to one row at a time, or found standing still.

    R_world_bone = R_y(heading_s) R_world_sensor R_bone_sensor^T
    acc_world    = k_s R_y(heading_s) (acc_sent + g e_y) - g e_y

which is `mocap.calibration`, with gravity put back first because packets come without it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from mocap import orientation as ori
from mocap.calibration import Calibration, PoseName, calibrate
from mocap.calibration.static_pose import StillWindow, average
from mocap.errors import CalibrationError, FormatError
from mocap.estimator import Sample
from mocap.formats._files import check_regular, read_text
from mocap.orientation import Array
from mocap.recording import RawRecording
from poser import files
from poser.live.assembler import Row

UP_G = np.array([0.0, ori.GRAVITY, 0.0])
POSE_S = 1.5  # all sensors still for so long are a pose
ENOUGH = 0.8  # of a sensor's samples in it
STILL_DEG = (
    6.0  # a sensor's drift over 1 s of it, and its wobble; a limb moved slowly does 10 deg/s
)


@dataclass(frozen=True, eq=False)
class Constants:
    """One sensor's: R_world_sensors (3,3) turns its world to ours, R_bone_sensor (3,3), acc_scale."""

    R_turn: Array
    R_bone_sensor: Array
    acc_scale: float

    def apply(self, R_world_sensor: Array, acc_world: Array) -> tuple[Array, Array]:
        """R_world_bone (3,3) and acc_world (3,) m/s^2 in the world in which the wearer faced +z."""
        acc = self.acc_scale * (self.R_turn @ (acc_world + UP_G)) - UP_G
        return self.R_turn @ R_world_sensor @ self.R_bone_sensor.T, acc


def read(path: Path) -> Calibration:
    """The calibration of a recording that `poser calibrate` wrote, or of its JSON text alone.

    Raises FormatError where the file holds none.
    """
    check_regular(path)
    try:
        if path.suffix.lower() == ".json":
            return Calibration.from_json(read_text(path))
        recording = files.recording(path)
        if recording.calibration is None:
            raise FormatError(path, "holds no calibration; poser calibrate writes one")
        return Calibration.from_json(json.dumps(recording.calibration))
    except OSError as e:
        raise FormatError(path, e.strerror or str(e)) from e
    except (CalibrationError, UnicodeDecodeError) as e:
        raise FormatError(path, str(e)) from e


BONES = Constants(np.eye(3), np.eye(3), 1.0)
"""What a device needs that sends orientations of its bone already."""


def constants(calibration: Calibration) -> dict[str, Constants]:
    """Each sensor's constants, by the sensor's name."""
    turn = ori.rot_y(calibration.heading)
    return {
        name: Constants(turn[s], calibration.R_bone_sensor[s], float(calibration.acc_scale[s]))
        for s, name in enumerate(calibration.sensors)
    }


def to_sample(
    row: Row,
    devices: Sequence[str],
    where: Mapping[str, str],
    sensors: Sequence[str],
    table: Mapping[str, Constants] | None,
) -> Sample:
    """A row of devices as a sample of `sensors`.

    where: the place of each device that is worn. table: constants by "device@place" or by place; None:
    every device sends its bone's orientation. A sensor is valid where a device in its place is, and
    has constants; of several devices in one place the first counts.
    """
    S = len(sensors)
    R, acc, valid = np.full((S, 3, 3), np.nan), np.full((S, 3), np.nan), np.zeros(S, bool)
    for d, device in enumerate(devices):
        place = where.get(device)
        if place is None or place not in sensors or not row.valid[d]:
            continue
        s = sensors.index(place)
        known = BONES if table is None else table.get(f"{device}@{place}", table.get(place))
        if known is None or valid[s]:
            continue
        R[s], acc[s] = known.apply(row.R_world_sensor[d], row.acc_world[d])
        valid[s] = True
    return Sample(row.time_s, R, acc, valid)


class Watch(Protocol):
    """What stands between rows and samples until the calibration is found. walks: after the pose the wearer
    has to walk."""

    walks: bool

    def push(self, row: Row) -> Calibration | None:
        """Take the next row; the calibration once there is one."""
        ...

    def prompt(self, time_s: float) -> str:
        """What the wearer should do at a row's time."""
        ...


class PoseWatch:
    """Waits for the wearer to stand still in a known pose, and calibrates from it.

    begin_s: rows before this time are not looked at. facing_deg: heading of the wearer's forward in the
    sensors' world (0: +z, 90: +x). give_up_s: how long to wait after `begin_s`.
    """

    walks = False

    def __init__(
        self,
        sensors: tuple[str, ...],
        rate_hz: float,
        pose: PoseName,
        facing_deg: float = 0.0,
        begin_s: float = 5.0,
        give_up_s: float = 60.0,
    ):
        self.sensors, self.rate_hz = sensors, rate_hz
        self.pose, self.facing_deg = pose, facing_deg
        self.begin_s, self.give_up_s = begin_s, give_up_s
        self._length = max(3, round(POSE_S * rate_hz))
        self._rows: list[Row] = []

    def push(self, row: Row) -> Calibration | None:
        """Take the next row, devices in the order of `sensors`; the calibration once there is one.

        Raises CalibrationError at `give_up_s`, and where the pose shows a fault of the sensors.
        """
        raw = self.stands(row)
        if raw is None:
            return None
        at = raw.start_s + raw.seconds / 2
        _, found = calibrate(raw, self.pose, at, facing=self.facing_deg, orientation="file")
        return found

    def prompt(self, time_s: float) -> str:
        """What the wearer should do at a row's time."""
        left = self.begin_s - time_s
        name = self.pose.upper()
        if left > 0:
            return f"get into the {name}-pose, {int(np.ceil(left))} s left"
        return f"stand still in the {name}-pose"

    def stands(self, row: Row) -> RawRecording | None:
        """Take the next row; the last POSE_S once the wearer stood still for so long.

        Raises CalibrationError at `give_up_s`.
        """
        if row.time_s < self.begin_s:
            return None
        self._rows = [*self._rows[-self._length + 1 :], row]
        if len(self._rows) < self._length:
            return None
        valid = np.mean([r.valid for r in self._rows], axis=0)
        if (valid >= ENOUGH).all():
            raw = raw_recording(self._rows, self.sensors, self.rate_hz)
            if _still(raw):
                return raw
        if row.time_s > self.begin_s + self.give_up_s:
            silent = [n for n, v in zip(self.sensors, valid, strict=True) if v < ENOUGH]
            why = f"sensor {', '.join(silent)} is silent" if silent else "nobody stood still"
            raise CalibrationError(
                f"no {self.pose.upper()}-pose within {self.give_up_s:g} s: {why}"
            )
        return None


def _still(raw: RawRecording) -> bool:
    mean = average(raw, StillWindow(0, len(raw), 0.0, True, False))
    return bool(max(mean.moved_deg.max(), mean.wobble_deg.max()) < STILL_DEG)


def raw_recording(
    rows: Sequence[Row], sensors: tuple[str, ...], rate_hz: float, common_heading: bool = True
) -> RawRecording:
    """Rows as a raw recording: acc = R^T (a + g e_y), gyr_t = Log(R_{t-1}^T R_t) rate.

    Where a sensor sent no acceleration, a = 0: rows are looked at for a wearer who stands still.
    """
    R = np.array([r.R_world_sensor for r in rows])
    a = np.nan_to_num(np.array([r.acc_world for r in rows]))
    acc = np.einsum("tsji,tsj->tsi", R, a + UP_G)
    gyr = np.empty_like(acc)
    gyr[1:] = ori.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]) * rate_hz
    gyr[0] = gyr[1]
    valid = np.array([r.valid for r in rows])
    return RawRecording(
        rate_hz,
        sensors,
        gyr,
        acc,
        None,
        R,
        valid,
        start_s=rows[0].time_s,
        common_heading=common_heading,
    )
