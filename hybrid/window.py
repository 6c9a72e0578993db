"""The moving horizon around a network: SIP's cost over the last fraction of a second (`sip.horizon`).

Every sample enters the window, and with it, some frames late, what the network says of its frame. One
Gauss-Newton step a frame follows, a second one where the clock allows. On a machine that is too slow for that
the window gets shorter, and longer again where there is time.
"""

from __future__ import annotations

import copy
import math
import time
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from hybrid import valley
from hybrid.settings import TrackerSettings
from mocap.errors import SolveError
from mocap.estimator import Pose, Sample
from mocap.orientation import Array
from mocap.skeleton import TOES, Skeleton
from sip import Horizon, HorizonSettings, PoseBelief, Shown, shown
from sip.horizon import HorizonState
from sip.model import Evidence

FAILED = "the window failed"
NO_WINDOW = "the window begins later"
NO_TIME = "no time for the window"
TOO_SLOW = "the window was over its time"
SHORTENED = "the window got shorter"
RESTED = "the window began anew from the network's poses"
EVENTS = (FAILED, NO_TIME, TOO_SLOW, SHORTENED, RESTED)
SLACK = 0.7  # share of the time under which a window may grow
FAST, SLOW = 0.2, 0.02  # how quickly the mean of the frames' times follows them up, and down
LATE_S = 0.05  # a window of a frame that is later than this gets shorter, whatever took the time
MOST_LATE_S = 0.15  # the shortest one is given up
BLANKS = (
    3  # frames that may be missing where time is short: each takes as long as one that is there
)
PAUSE_S = 1.0  # without a window, where the shortest one takes too long


@cache
def _libraries() -> ThreadpoolController:
    """Those for linear algebra: their matrices are small here, and several threads slow them down."""
    return ThreadpoolController()


class WindowFailed(Exception):
    """The argument is the reason for the note."""


@dataclass(frozen=True, eq=False)
class WindowState:
    """What one frame hands to the next.

    solved: the window; empty at a start. times: s of its frames, oldest first. shift (3,) m: from its places
    to the path, None until a pose of it was given. size: frames that the machine has time for. frame_s: mean
    time of a frame of late. late_s: how late the newest one was. pause: frames to go without a window. steps,
    frames: taken so far.
    waited: frames since the network's valley was last looked at. rival: the window in that valley, while
    it is being looked at. std_rad (24,3) of the poses, computed std_age frames ago. shown: the poses given
    last, in the window's places, the last of them at shown_s.
    """

    solved: HorizonState
    times: tuple[float, ...] = ()
    shift: Array | None = None
    size: int = 0
    frame_s: float = 0.0
    late_s: float = 0.0
    pause: int = 0
    steps: int = 0
    frames: int = 0
    waited: int = 0
    rival: HorizonState | None = None
    std_rad: Array | None = None
    std_age: int = 0
    shown: Shown | None = None
    shown_s: float = 0.0


class Window:
    """The constants of a body with sensors at a rate; all that changes is in `WindowState`.

    late: frames that the network's word is behind the newest sample; lag: that of the poses given.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        joint: np.ndarray,
        seat: Array,
        rate_hz: float,
        settings: TrackerSettings,
        late: int,
        lag: int,
    ) -> None:
        self.skeleton, self.rate_hz, self.settings = skeleton, rate_hz, settings
        self.lag, self.late = lag, late
        how = HorizonSettings(settings.horizon_s, settings.horizon_memory_s)
        self._longest = Horizon(skeleton, joint, seat, rate_hz, settings.cost, how, True)
        # A frame must lie in the window until its pose is given and the network has spoken of it.
        self.least = max(lag, late) + self._longest.reach + 1
        self.most = max(self._longest.size, self.least)
        self._by_size: dict[int, Horizon] = {}
        self._beliefs = Beliefs(settings)
        self._valley_frames, self._deviation_frames = (
            max(1.0, s * rate_hz) for s in (settings.valley_s, settings.deviations_s)
        )

    def start(self) -> WindowState:
        """Nothing seen yet."""
        return WindowState(self._longest.init(), size=self.most)

    def fills(self, gap_s: float) -> bool:
        """Whether it goes on over a gap in time with blank frames."""
        return self.settings.budget_s is None or round(gap_s * self.rate_hz) - 1 <= BLANKS

    def restarted(self, state: WindowState) -> WindowState:
        """Nothing seen yet, on a machine that is known."""
        return replace(
            state,
            solved=self._longest.init(),
            times=(),
            shift=None,
            shown=None,
            waited=0,
            rival=None,
        )

    def _of_size(self, size: int) -> Horizon:
        if size not in self._by_size:
            horizon = copy.copy(self._longest)
            horizon.size = size
            self._by_size[size] = horizon
        return self._by_size[size]

    def step(
        self,
        state: WindowState,
        sample: Sample,
        pose: Pose | None,
        began: float,
        counts: defaultdict[str, int],
    ) -> WindowState:
        """The state after one more sample. pose: the network's, of a frame in the window, or None.
        began: when work on this frame began, by `time.perf_counter`. Raises WindowFailed.
        """
        if state.pause:
            state = replace(state, pause=state.pause - 1)
            if state.pause:
                return state
        horizon = self._of_size(state.size)
        try:
            if len(state.solved) > state.size:
                solved = state.solved
                for _ in range(len(solved) - state.size):
                    solved = horizon.without_oldest(solved)
                state = replace(state, solved=solved, rival=None)
            with _libraries().limit(limits=1, user_api="blas"):
                state = self._entered(state, horizon, sample, pose)
                state = self._compared(state, horizon, counts)
                state = self._improved(state, horizon, began)
        except (SolveError, ArithmeticError, np.linalg.LinAlgError, ValueError) as e:
            raise WindowFailed(FAILED) from e
        if (point := state.solved.point) is not None and not np.isfinite(point.x).all():
            raise WindowFailed(FAILED)
        if self.settings.budget_s is None:
            return state
        return self._timed(state, time.perf_counter() - began, self.settings.budget_s, counts)

    def _entered(
        self, state: WindowState, horizon: Horizon, sample: Sample, pose: Pose | None
    ) -> WindowState:
        """The state with the sample in it, and blank frames where samples before it are missing."""
        times, S = state.times, len(sample.valid)
        missing = round((sample.time_s - times[-1]) * self.rate_hz) - 1 if times else 0
        times = (
            *times,
            *(times[-1] + (k + 1) / self.rate_hz for k in range(missing)),
            sample.time_s,
        )
        belief, age = None, len(times) - 1
        if pose is not None:
            off = np.abs(np.array(times) - pose.time_s)
            age = len(times) - 1 - int(off.argmin())
            if off.min() < 0.5 / self.rate_hz:
                belief = self._beliefs.of(pose)

        def fed(solved: HorizonState) -> HorizonState:
            for _ in range(missing):
                solved = horizon.step(solved, Evidence.blank(1, S))
            return horizon.step(solved, evidence_of(sample), belief, age)

        solved = fed(state.solved)
        return replace(
            state,
            solved=solved,
            rival=state.rival and fed(state.rival),
            waited=state.waited + 1,
            times=times[len(times) - len(solved) :] if len(solved) else (),
            steps=state.steps + 1,
            frames=state.frames + 1,
        )

    def _compared(
        self, state: WindowState, horizon: Horizon, counts: defaultdict[str, int]
    ) -> WindowState:
        """The state in the cheaper valley, its own or the network's, where it is time to compare them."""
        solved, rival = state.solved, state.rival
        if rival is None:
            waits = state.waited < self._valley_frames or len(solved) < horizon.size
            if waits or not valley.troubled(solved):
                return state
            return replace(state, rival=valley.rival(horizon, solved), waited=0)
        if state.waited < valley.FRAMES:
            return state
        if valley.cheaper(horizon, solved, rival):
            solved = rival
            counts[RESTED] += 1
        return replace(state, solved=solved, rival=None, waited=0)

    def _improved(self, state: WindowState, horizon: Horizon, began: float) -> WindowState:
        """The state after the further steps that there are, or that the clock allows."""
        budget, steps = self.settings.budget_s, 1
        while steps < self.settings.steps and len(state.solved):
            spent = time.perf_counter() - began
            if budget is not None and spent * (steps + 1) / steps > budget:
                break
            solved = horizon.improved(state.solved)
            state, steps = replace(state, solved=solved, steps=state.steps + 1), steps + 1
        return state

    def _timed(
        self, state: WindowState, spent: float, budget: float, counts: defaultdict[str, int]
    ) -> WindowState:
        """The state with the window as long as the machine has time for."""
        follow = FAST if spent > state.frame_s else SLOW
        frame_s = state.frame_s + follow * (spent - state.frame_s)
        counts[TOO_SLOW] += spent > budget
        size, pause, late = state.size, 0, state.late_s > LATE_S
        if (frame_s > budget or late) and len(state.solved) >= size:
            if size > self.least:
                size, frame_s = size - 1, frame_s * (size - 1) / size
                counts[SHORTENED] += 1
            elif frame_s > budget or state.late_s > MOST_LATE_S:
                pause, frame_s = max(1, round(PAUSE_S * self.rate_hz)), 0.0
        elif frame_s < SLACK * budget and len(state.solved) >= size:
            size = min(size + 1, self.most)
        state = replace(state, size=size, frame_s=frame_s, pause=pause)
        return self.restarted(state) if pause else state

    def pose(
        self, state: WindowState, time_s: float, last: Pose | None
    ) -> tuple[WindowState, Pose | None]:
        """That of the frame of this time, or None where the window has none; its path goes on at the pose
        before it, `last`, or begins over the origin with the lower foot on the ground."""
        if not state.times:
            return state, None
        off = np.abs(np.array(state.times) - time_s)
        t = int(off.argmin())
        if off[t] > 0.5 / self.rate_hz:
            return state, None
        again = state.std_rad is None or state.std_age >= self._deviation_frames
        asked = again and math.isfinite(self._deviation_frames)
        follows = abs(time_s - state.shown_s - 1 / self.rate_hz) < 0.5 / self.rate_hz
        before, lag = state.shown if follows else None, len(state.times) - 1 - t
        try:
            with _libraries().limit(limits=1, user_api="blas"):
                now = shown(self._longest, state.solved, lag, before, self.settings.shown_memory_s)
                std = self._longest.pose(state.solved, lag, True).std_rad if asked else None
        except (SolveError, ArithmeticError, np.linalg.LinAlgError, ValueError):
            return state, None
        R, place = now.R_parent_joint[-1], now.p_world_root[-1]
        if not (np.isfinite(R).all() and np.isfinite(place).all()):
            return state, None
        state = replace(state, shown=now, shown_s=time_s)
        if asked:
            state = replace(state, std_rad=std, std_age=0)
        shift = self._begun(R, last) - place if state.shift is None else state.shift
        state = replace(state, shift=shift, std_age=state.std_age + 1)
        return state, Pose(time_s, R, place + shift, state.std_rad)

    def _begun(self, R: Array, last: Pose | None) -> Array:
        """(3,) m: where a path goes on, or begins."""
        if last is not None:
            return last.p_world_root
        _, p = self.skeleton.forward(R, np.zeros(3))
        return np.array([0.0, self.skeleton.sole - float(p[list(TOES), 1].min()), 0.0])

    def facts(self, state: WindowState, counts: Mapping[str, int]) -> dict[str, Any]:
        """Figures for people and programs."""
        return {
            "lag_frames": self.lag,
            "window_frames": state.size,
            "window_frames_most": self.most,
            "steps_per_frame": state.steps / max(1, state.frames),
            "window_events": {name: counts[name] for name in EVENTS if counts.get(name)},
        }

    def constants(self, state: WindowState) -> Array | None:
        """(S,7) of the sensors: mounting (3) and heading (1) in rad, bias (3) in m/s^2, as they are taken out
        now; None where they are not estimated."""
        if state.solved.point is None or not self.settings.cost.self_calibration:
            return None
        return state.solved.point.u


class Beliefs:
    """What the window is told of a network's poses; remembers the covariance that it saw last."""

    def __init__(self, settings: TrackerSettings) -> None:
        self._floor = math.radians(settings.network_floor_deg)
        plain, self._scale = (
            np.broadcast_to(np.asarray(x, float), 24)
            for x in (settings.network_sigma_deg, settings.network_scale)
        )
        self._plain, self._ceiling = np.deg2rad(plain), math.radians(settings.network_ceiling_deg)
        # A cache, nothing that a frame hands on: the window makes much of a covariance it has seen.
        self._known: tuple[Array | None, Array | None, Array] | None = None

    def of(self, pose: Pose) -> PoseBelief:
        """The pose as a Gaussian."""
        return PoseBelief(pose.R_parent_joint[None], self._covariance(pose))

    def _covariance(self, pose: Pose) -> Array:
        C, std = pose.covariance, pose.std_rad
        if (known := self._known) is not None and (
            (C is not None and known[0] is C)
            or (C is None and known[0] is None and _same(known[1], std))
        ):
            return known[2]
        if C is None:
            sigma = np.repeat(self._plain[:, None], 3, axis=1)
            if std is not None:
                stated = np.isfinite(std) & (std > 0)
                sigma = np.where(stated, std * self._scale[:, None], sigma)
            found = np.diag(np.clip(sigma, self._floor, self._ceiling).ravel() ** 2)
        else:
            found = C + self._floor**2 * np.eye(72)
        self._known = C, std, found
        return found


def _same(a: Array | None, b: Array | None) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def evidence_of(sample: Sample) -> Evidence:
    """One frame's, of a sample that was made clean (`hybrid.incoming`)."""
    turned = sample.valid & np.isfinite(sample.R_world_bone).all((-1, -2))
    moved = sample.valid & np.isfinite(sample.acc_world).all(-1)
    R = np.where(turned[:, None, None], sample.R_world_bone, np.eye(3))
    acc = np.where(moved[:, None], sample.acc_world, 0.0)
    return Evidence(R[None], acc[None], turned[None], moved[None])
