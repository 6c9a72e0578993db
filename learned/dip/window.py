"""DIP's sliding window (Huang et al. 2018, 3.4): `past` frames before the answered one, `future` after.

Each window starts from zero state, as in training. A window that is not full yet repeats its first frame;
after a jump of the source's clock, frames before and after it do not mix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learned.dip.model import Dip
from learned.dip.specification import SPECIFICATION
from learned.online.estimator import NetworkEstimate
from learned.runtime import Runtime, prepare
from mocap.errors import PoserError, SensorError
from mocap.orientation import Array


@dataclass(frozen=True, eq=False)
class DipState:
    """The window, oldest first: samples (T,72) float32, orientations and accelerations as measured, and rows
    (T,W) float32 of `learned.runtime` (W = 0 for a normalisation that depends on the window); of the frames
    still to be answered for and the future ones, R_world_root (future+1,3,3) and lost (future+1,S). had:
    frames since the start, since: frames since the start or the last jump of the clock; neither counts
    beyond the window's length. seen (S,): the sensors that have been there."""

    samples: NDArray[np.float32]
    rows: NDArray[np.float32]
    R_world_root: Array
    lost: NDArray[np.bool_]
    had: int
    since: int
    seen: NDArray[np.bool_]


class DipWindow:
    """`learned.online.estimator.RollingWindow` of a DIP model.

    sensors: the six names as the recording has them, in DIP's order. Raises PoserError for a window that
    is not a number of frames.
    """

    def __init__(
        self,
        model: Dip,
        window: tuple[int, int] = (20, 5),
        sensors: tuple[str, ...] | None = None,
        runtime: Runtime | None = None,
    ) -> None:
        past, future = (int(n) for n in window)
        if past < 0 or future < 0 or past + future > 1000:
            raise PoserError(
                f"window {past},{future}: frames before and after must lie between 0 and 1000"
            )
        self.model, self.past, self.future = model.eval(), past, future
        self.rate_hz = model.config.rate_hz
        self.sensors = tuple(sensors or model.config.sensors)
        if len(self.sensors) != len(model.config.sensors):
            raise SensorError(f"DIP reads {', '.join(model.config.sensors)}")
        self.runtime = runtime or prepare(model)
        self._covariance = model.error_covariance.double().numpy()
        # The frame of "first" is the window's own first one: nothing can be kept from window to window.
        self._relative = model.config.normalisation == "first"

    @torch.inference_mode()
    def tick(
        self, state: DipState | None, R: Array, acc: Array, present: NDArray[np.bool_], jumped: bool
    ) -> tuple[DipState, NetworkEstimate | None]:
        state = self._fed(state, R, acc, present, jumped)
        if state.had <= self.future:
            return state, None
        out = self.runtime.answer(self._window(state), self.past)
        pose = self.model.pose_under(
            out, torch.as_tensor(state.R_world_root[0], dtype=torch.float32)
        )
        std = self.model.pose_deviation(out, pose)
        local = pose.double().numpy()
        local[0] = state.R_world_root[0]
        lost = [name for name, gone in zip(self.sensors, state.lost[0], strict=True) if gone]
        note = f"nothing from {', '.join(lost)}" if lost else ""
        return state, NetworkEstimate(local, std.double().numpy(), note, self._covariance)

    def _fed(
        self, state: DipState | None, R: Array, acc: Array, present: NDArray[np.bool_], jumped: bool
    ) -> DipState:
        """The window one frame on."""
        sample = np.concatenate([R.reshape(-1), acc.reshape(-1)]).astype(np.float32)[None]
        root, lost = R[None, 5], ~present[None]
        T = self.past + 1 + self.future
        late = self.future + 1
        if state is None:
            samples, rows = sample.repeat(T, 0), self._rows(sample).repeat(T, 0)
            return DipState(
                samples, rows, root.repeat(late, 0), lost.repeat(late, 0), 1, 1, present.copy()
            )
        samples = np.concatenate([state.samples[1:], sample])
        roots = np.concatenate([state.R_world_root[1:], root])
        new = present & ~state.seen
        if new.any():
            # Frames before a sensor's first value hold that value, as frames before the start do: the
            # network never saw a sensor that stands for nothing.
            own = np.concatenate([new.repeat(9), new.repeat(3)])
            samples[:, own] = sample[:, own]
            rows = self._rows(samples)
            roots = root.repeat(late, 0) if new[5] else roots
        else:
            rows = np.concatenate([state.rows[1:], self._rows(sample)])
        return DipState(
            samples,
            rows,
            roots,
            np.concatenate([state.lost[1:], lost]),
            min(state.had + 1, T),
            1 if jumped else min(state.since + 1, T),
            state.seen | present,
        )

    def _rows(self, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """What is kept of samples (n,72) as measured: their rows (n,W), of "first" nothing."""
        if self._relative:
            return np.empty((len(samples), 0), np.float32)
        rows: NDArray[np.float32] = self._computed(samples).numpy()
        return rows

    def _computed(self, samples: NDArray[np.float32]) -> Tensor:
        x = torch.as_tensor(samples)
        R, acc = x[:, :54].unflatten(-1, (6, 3, 3)), x[:, 54:].unflatten(-1, (6, 3))
        return self.runtime.rows(self.model.inputs(R, acc)[0])

    def _window(self, state: DipState) -> Tensor:
        """The rows (T,W) to answer from: all on one side of a jump of the clock."""
        T = len(state.samples)
        jump = T - state.since  # the first frame after the jump
        index = np.arange(T)
        index = index.clip(None, jump - 1) if self.past < jump else index.clip(jump, None)
        if self._relative:
            return self._computed(state.samples[index])
        return torch.as_tensor(state.rows[index] if jump else state.rows)


def window(
    model: Dip,
    sensors: tuple[str, ...],
    places: tuple[str, ...],
    frames: tuple[int, int] | None,
    runtime: Runtime,
) -> DipWindow:
    """`Specification.online`. Raises SensorError for other places than DIP's, PoserError for a window."""
    if places != SPECIFICATION.places:
        raise SensorError(f"DIP reads {', '.join(SPECIFICATION.places)}, in this order")
    return DipWindow(model, frames or SPECIFICATION.window, sensors, runtime)
