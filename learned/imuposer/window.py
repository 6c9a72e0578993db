"""IMUPoser's rolling window (Mollyn et al. 2023, 5.3): 125 frames at 25 Hz, the newest one answered for.

Networks were trained on windows in which a device was worn throughout or not at all. So every window is
shown as the devices worn now would have measured it: one that has gone is absent from the whole window,
one that came lately holds its first value before. Before the first device there is no answer, while none is
worn afterwards the last one holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from learned.errors import CheckpointError
from learned.imuposer.features import ACC_WINDOW, imuposer_input, imuposer_pose
from learned.imuposer.model import Imuposer
from learned.imuposer.specification import COMBINATIONS, FRAMES, SPECIFICATION
from learned.online.estimator import NetworkEstimate
from learned.runtime import Runtime, prepare
from mocap import sensors as places
from mocap.errors import PoserError, SensorError
from mocap.orientation import Array

_EDGE = (
    ACC_WINDOW // 2
)  # frames at both ends whose smoothed acceleration changes as the window moves


@dataclass(frozen=True, eq=False)
class ImuposerState:
    """The window, oldest first: R (T,5,3,3), acc (T,5,3) float32 of the five places, NaN before a device's
    first value; rows (T,W) float32 of `learned.runtime` for the combination `worn`, of the last frame.
    last: the last answer, where there was one."""

    R: NDArray[np.float32]
    acc: NDArray[np.float32]
    rows: NDArray[np.float32] | None = None
    worn: tuple[int, ...] = ()
    last: NetworkEstimate | None = None


class ImuposerWindow:
    """`learned.online.estimator.RollingWindow` of an IMUPoser model.

    sensors: the devices as the recording has them; place: the index in `mocap.sensors.FIVE` of each
    (default: by name). frames: length of the window. Raises SensorError for a sensor that is none of the
    five places, or two of one place.
    """

    future = 0

    def __init__(
        self,
        model: Imuposer,
        sensors: tuple[str, ...] = places.FIVE,
        place: tuple[int, ...] | None = None,
        frames: int = FRAMES,
        runtime: Runtime | None = None,
    ) -> None:
        self.model, self.frames = model.eval(), frames
        self.rate_hz = model.config.rate_hz
        self.sensors = tuple(sensors)
        odd = [n for n in self.sensors if place is None and n not in places.FIVE]
        if odd or not self.sensors:
            raise SensorError(
                f"sensor {', '.join(odd) or '(none)'}: IMUPoser reads {', '.join(places.FIVE)}"
            )
        self.place = place or tuple(places.FIVE.index(n) for n in self.sensors)
        if len(set(self.place)) != len(self.sensors):
            raise SensorError(f"two of {', '.join(self.sensors)} stand for one place")
        if frames <= 2 * _EDGE:
            raise CheckpointError(f"a window of {frames} frames is too short")
        self.runtime = runtime or prepare(model)
        self._covariance = tuple(c.double().numpy() for c in model.error_covariance)

    @torch.inference_mode()
    def tick(
        self,
        state: ImuposerState | None,
        R: Array,
        acc: Array,
        present: NDArray[np.bool_],
        jumped: bool,
    ) -> tuple[ImuposerState, NetworkEstimate | None]:
        have = tuple(sorted(p for p, here in zip(self.place, present, strict=True) if here))
        worn = self.nearest(have)
        state, kept = self._fed(state, R, acc, present, jumped)
        if not worn:
            last = state.last
            # Frames pass without rows of theirs: those kept would be in the wrong place afterwards.
            state = replace(state, rows=None, worn=())
            return state, last and NetworkEstimate(
                last.R_parent_joint, last.std_rad, "no device is worn"
            )
        rows = self._rows(state, worn, kept)
        pose = imuposer_pose(self.runtime.answer(rows, self.frames - 1))
        which = COMBINATIONS.index(worn)
        std = self.model.deviation_rad[which]
        note = "" if worn == have else f"worn {_names(have)}: only {_names(worn)} is used"
        answer = NetworkEstimate(
            pose.double().numpy(), std.double().numpy(), note, self._covariance[which]
        )
        return ImuposerState(state.R, state.acc, rows.numpy(), worn, answer), answer

    def nearest(self, worn: tuple[int, ...]) -> tuple[int, ...]:
        """The combination to use for devices worn: they, or the part of them with the smallest deviation."""
        parts = [c for c in COMBINATIONS if set(c) <= set(worn)]
        if worn in parts or not parts:
            return worn if worn in parts else ()
        deviation = self.model.deviation_rad.mean((1, 2))
        return min(parts, key=lambda c: (float(deviation[COMBINATIONS.index(c)]), -len(c)))

    def _fed(
        self,
        state: ImuposerState | None,
        R: Array,
        acc: Array,
        present: NDArray[np.bool_],
        jumped: bool,
    ) -> tuple[ImuposerState, bool]:
        """The window one frame on, and whether the rows of the one before still hold, one place on."""
        R_now = np.full((1, 5, 3, 3), np.nan, np.float32)
        acc_now = np.full((1, 5, 3), np.nan, np.float32)
        at = [p for p, here in zip(self.place, present, strict=True) if here]
        R_now[0, at], acc_now[0, at] = R[present], acc[present]
        if state is None or jumped:
            last = state.last if state else None
            T = self.frames
            return ImuposerState(R_now.repeat(T, 0), acc_now.repeat(T, 0), None, (), last), False
        # A device that is gone holds its last value, so that it is there should it come back.
        gone = np.isnan(R_now[0, :, 0, 0])
        R_now[0, gone], acc_now[0, gone] = state.R[-1, gone], state.acc[-1, gone]
        R_all, acc_all = (
            np.concatenate([state.R[1:], R_now]),
            np.concatenate([state.acc[1:], acc_now]),
        )
        new = np.isnan(R_all[-2, :, 0, 0]) & ~np.isnan(R_now[0, :, 0, 0])
        R_all[:, new], acc_all[:, new] = R_now[:, new], acc_now[:, new]
        return ImuposerState(R_all, acc_all, state.rows, state.worn, state.last), not new.any()

    def _rows(self, state: ImuposerState, worn: tuple[int, ...], kept: bool) -> torch.Tensor:
        """The window's rows; those in its middle are the last window's."""
        mask = torch.zeros(5, dtype=torch.bool)
        mask[list(worn)] = True
        x = imuposer_input(torch.as_tensor(state.R), torch.as_tensor(state.acc), mask)
        if state.rows is None or state.worn != worn or not kept:
            return self.runtime.rows(x)
        ends = [*range(_EDGE), *range(self.frames - _EDGE - 1, self.frames)]
        rows = torch.empty(state.rows.shape)
        rows[:-1] = torch.as_tensor(state.rows[1:])
        rows[ends] = self.runtime.rows(x[ends])
        return rows


def _names(worn: tuple[int, ...]) -> str:
    return ", ".join(places.FIVE[p] for p in worn)


def window(
    model: Imuposer,
    sensors: tuple[str, ...],
    stands_for: tuple[str, ...],
    frames: tuple[int, int] | None,
    runtime: Runtime,
) -> ImuposerWindow:
    """`Specification.online`. Raises SensorError for places not IMUPoser's, PoserError for a window."""
    if frames not in (None, SPECIFICATION.window):
        raise PoserError(f"IMUPoser's window is {FRAMES} frames")
    odd = [p for p in stands_for if p not in places.FIVE]
    if odd or not stands_for:
        five = ", ".join(places.FIVE)
        raise SensorError(f"sensor {', '.join(odd) or '(none)'}: IMUPoser reads {five}")
    place = tuple(places.FIVE.index(p) for p in stands_for)
    return ImuposerWindow(model, sensors, place, runtime=runtime)
