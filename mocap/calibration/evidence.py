"""All that a check may look at: the sensors, the pose that was taken from them, what both give.

Everything derived is computed once, when a check first asks for it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import limb_levels, posture
from mocap.calibration.fusion import bridged
from mocap.calibration.rates import Rates, measure
from mocap.calibration.spikes import Spike, without_spikes
from mocap.calibration.static_pose import StaticPose, StillWindow
from mocap.calibration.stillness import still_runs
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording


@dataclass(frozen=True, eq=False)
class HeldPose:
    """The static pose as it was taken.

    name: "n" or "t"; arm_angle_deg: of the N-pose. facing (S,) rad: the wearer's forward in the world of
    each sensor; sigma (S,) rad: 1-sigma of it, pi where it was assumed.
    """

    window: StillWindow
    static: StaticPose
    name: str
    arm_angle_deg: float
    facing: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a recording. raw: without the samples `spikes`, which no sensor can have measured.

    held: the static pose, None before there is one; with it, raw has R_world_sensor. judged: the sensors
    that a check may accuse; of the others something is known already that would mislead it.
    """

    raw: RawRecording
    spikes: tuple[Spike, ...] = ()
    held: HeldPose | None = None
    judged: tuple[str, ...] = ()

    @property
    def pose(self) -> HeldPose:
        """The static pose. ValueError where there is none: only checks that need a pose may ask."""
        if self.held is None:
            raise ValueError("no static pose was taken")
        return self.held

    @property
    def each(self) -> list[tuple[int, str]]:
        """Index and name of every judged sensor."""
        return [(s, n) for s, n in enumerate(self.raw.sensors) if n in self.judged]

    def judging(self, sensors: tuple[str, ...]) -> Evidence:
        """The same about these sensors only; what is derived of all is kept."""
        made = copy(self)
        object.__setattr__(made, "judged", sensors)
        made.__dict__.pop("rates", None)
        return made

    def channels(self, s: int) -> tuple[Array, Array, Bool]:
        """gyr and acc (T,3) of sensor `s`, straight lines where they are missing, and where not (T,)."""
        ok = self.raw.valid[:, s]
        return bridged(self.raw.gyr[:, s], ok), bridged(self.raw.acc[:, s], ok), ok

    @cached_property
    def joints(self) -> np.ndarray:
        """The joint (S,) that each sensor is on."""
        return places.joints_and_seats(self.raw.sensors)[0]

    @cached_property
    def activity(self) -> Array:
        """(T,S): see `limb_levels.activity`."""
        return limb_levels.activity(self.raw)

    @cached_property
    def still(self) -> list[tuple[int, int]]:
        """All runs [start, stop) in which the whole body is still."""
        return still_runs(self.raw)

    @cached_property
    def seat_possible(self) -> bool:
        """May the wearer have sat in the pose, with no thighs worn to say so?"""
        return posture.seat_possible(self.raw, self.pose.window, self.pose.static)

    @cached_property
    def rates(self) -> Rates:
        """Sampling rate and scales of gyr as the judged sensors have them, in their order."""
        return measure(self.raw.select(self.judged))

    @cached_property
    def R_wearer_sensor(self) -> Array | None:
        """R_world_sensor (T,S,3,3) in one world, that in which the wearer faced +z in the pose.

        Before there is a pose: in the world that the sensors share, None where they share none.
        """
        R = self.raw.R_world_sensor
        if R is None or self.held is None:
            return R if self.raw.common_heading else None
        return ori.rot_y(-self.held.facing) @ R


def gather(raw: RawRecording) -> Evidence:
    """What the sensors alone say."""
    clean, spikes = without_spikes(raw)
    return Evidence(clean, tuple(spikes), None, raw.sensors)
