"""Devices with a heading of their own: a pose shows how they are tilted, but not which way they face.

`WalkWatch` finds mountings and headings anew: the wearer stands in the pose, then walks, and what `poser
calibrate` does with a recording is done with these rows. `HeadingWatch` takes the mountings from a
calibration and finds the headings again, which every start of a tracker changes: in the pose,

    h_s = heading of R_world_bone(pose) R_bone_sensor R_world_sensor^T

is the turn about the vertical that brings sensor s into the wearer's world.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import Calibration, PoseName, calibrate
from mocap.calibration.static_pose import StillWindow, average
from mocap.errors import CalibrationError
from mocap.stances import pose_bones
from poser.live.alignment import PoseWatch, raw_recording
from poser.live.assembler import Row

WALK_S = 10.0  # of walking before the first try
AGAIN_S = 3.0  # of more walking before the next
GIVE_UP_S = 60.0
UNKNOWN = np.pi / 2  # 1-sigma of a heading that is not known
MISFIT_DEG = (
    30.0  # of a bone to the pose after the reset: held differently, or the sensor has moved
)


class WalkWatch:
    """Waits for the wearer to stand still in a known pose, then to walk, and calibrates from both.

    facing_deg: heading of the wearer's forward in the world of the first sensor (the pelvis' where there is
    one), where known. begin_s: rows before this time are not looked at.
    """

    walks = True

    def __init__(
        self,
        sensors: tuple[str, ...],
        rate_hz: float,
        pose: PoseName,
        facing_deg: float | None = None,
        begin_s: float = 5.0,
    ):
        self._stand = PoseWatch(sensors, rate_hz, pose, begin_s=begin_s)
        self._facing_deg = facing_deg
        self._rows: list[Row] = []
        self._pose_s: float | None = None
        self._next_s = np.inf

    def push(self, row: Row) -> Calibration | None:
        """Take the next row, devices in the order of `sensors`; the calibration once there is one.

        Raises CalibrationError where the wearer does not stand still in time, or GIVE_UP_S of walking do not
        tell where some sensor faces.
        """
        self._rows.append(row)
        if self._pose_s is None:
            raw = self._stand.stands(row)
            if raw is not None:
                self._pose_s = raw.start_s + raw.seconds / 2
                self._next_s = row.time_s + WALK_S
            return None
        if row.time_s < self._next_s:
            return None
        self._next_s = row.time_s + AGAIN_S
        try:
            return self._calibrated()
        except CalibrationError:
            if row.time_s > self._pose_s + GIVE_UP_S:
                raise
            return None

    def _calibrated(self) -> Calibration:
        raw = raw_recording(self._rows, self._stand.sensors, self._stand.rate_hz, False)
        _, found = calibrate(
            raw, self._stand.pose, self._pose_s, facing=self._facing_deg, orientation="file"
        )
        unknown = [
            n for n, s in zip(found.sensors, found.heading_sigma, strict=True) if s > UNKNOWN
        ]
        if unknown:
            raise CalibrationError(
                f"walking does not tell where sensor {', '.join(unknown)} faces: walk straight ahead with "
                f"brisk starts and stops, and bend forward once"
            )
        return found

    def prompt(self, time_s: float) -> str:
        """What the wearer should do at a row's time."""
        if self._pose_s is None:
            return self._stand.prompt(time_s)
        left = self._next_s - time_s
        return f"now walk about, straight ahead and back, {max(1, int(np.ceil(left)))} s"


class HeadingWatch:
    """Waits for the wearer to stand still in a known pose, and takes the headings from it."""

    walks = False

    def __init__(
        self, known: Calibration, sensors: tuple[str, ...], rate_hz: float, pose: PoseName,
        begin_s: float = 5.0,
    ):  # fmt: skip
        self._known = known
        self._stand = PoseWatch(sensors, rate_hz, pose, begin_s=begin_s)

    def push(self, row: Row) -> Calibration | None:
        """Take the next row; the calibration with new headings once the wearer stood still.

        Raises CalibrationError where nobody stands still in time, and where a sensor does not fit the pose.
        """
        raw = self._stand.stands(row)
        if raw is None:
            return None
        names = self._stand.sensors
        at = [self._known.sensors.index(n) for n in names]
        static = average(raw, StillWindow(0, len(raw), 0.0, True, False))
        joints, _ = places.joints_and_seats(names)
        bones = pose_bones(joints, self._stand.pose, self._known.arm_angle_deg)
        mounted = self._known.R_bone_sensor[at]
        turn = bones @ mounted @ np.swapaxes(static.R_world_sensor, -1, -2)
        heading = ori.heading(turn)
        off = np.rad2deg(ori.angle_between(turn, ori.rot_y(heading)))
        worst = int(off.argmax())
        if off[worst] > MISFIT_DEG:
            raise CalibrationError(
                f"sensor {names[worst]} is {off[worst]:.0f} deg from where the calibration has it in the "
                f"{self._stand.pose.upper()}-pose: it has moved, or the pose was another"
            )
        return replace(
            self._known, sensors=names, R_bone_sensor=mounted, heading=heading,
            heading_sigma=np.full(len(names), np.deg2rad(5.0)), acc_scale=self._known.acc_scale[at],
            pose=self._stand.pose, time=(raw.start_s, raw.start_s + raw.seconds), method="the standing pose",
            orientation="file", diagnostics=(),
        )  # fmt: skip

    def prompt(self, time_s: float) -> str:
        """What the wearer should do at a row's time."""
        return self._stand.prompt(time_s)
