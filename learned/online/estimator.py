"""A network behind `mocap.estimator.Estimator`: samples at any rate in, one pose per sample out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from learned.online import resampling
from learned.online.holding import Held, take
from mocap import orientation as ori
from mocap.errors import ShapeError
from mocap.estimator import Pose, Sample
from mocap.motion import check_rate
from mocap.orientation import Array
from mocap.skeleton import Skeleton

UNKNOWN_RAD = np.pi / 2  # deviation of a joint of which nothing is known


@dataclass(frozen=True, eq=False)
class NetworkEstimate:
    """A network's pose: R_parent_joint (24,3,3), std_rad (24,3), why it is a fallback, if it is, and the
    covariance of its errors as in `mocap.estimator.Pose`."""

    R_parent_joint: Array
    std_rad: Array
    note: str = ""
    covariance: Array | None = None


class RollingWindow(Protocol):
    """Frames at `rate_hz` in, the pose of `future` frames ago out; None where nothing is known of it.

    tick(state, R_world_bone (S,3,3), acc_world (S,3), present (S,), jumped): `state` None starts. Frames
    without an answer get that of the next frame which has one, as far as the look-ahead reaches.
    """

    rate_hz: float
    sensors: tuple[str, ...]
    future: int

    def tick(
        self, state: Any, R: Array, acc: Array, present: NDArray[np.bool_], jumped: bool
    ) -> tuple[Any, NetworkEstimate | None]: ...


@dataclass(frozen=True, eq=False)
class OnlineState:
    """All that one step hands to the next; plain arrays, pickle it to resume later.

    network: the network's state. ticks: frames it has had. recent: the samples that the next tick needs.
    waiting: our time and the stamp of the samples whose poses are due. answers: the network's poses, our
    time first, that these lie between. Our time: s of `learned.online.holding`, at equal rates frames.
    """

    network: Any = None
    ticks: int = 0
    recent: tuple[Held, ...] = ()
    waiting: tuple[tuple[float, float], ...] = ()
    answers: tuple[tuple[float, NetworkEstimate], ...] = ()


class Online:
    """The estimator. The pelvis stays at the height of the standing body: networks tell no translation.

    tracker_hints: `mocap.estimator.tracker_hints` of it. Raises ShapeError for a rate outside 1 to 10,000 Hz.
    """

    def __init__(
        self,
        network: RollingWindow,
        rate_hz: float,
        skeleton: Skeleton | None = None,
        tracker_hints: Mapping[str, Any] | None = None,
    ) -> None:
        self.network = network
        self.tracker_hints = dict(tracker_hints or {})
        self.rate_hz = check_rate(rate_hz, "Online")
        self.sensors = network.sensors
        self.look_ahead_frames = resampling.look_ahead(
            self.rate_hz, network.rate_hz, network.future
        )
        self.p_world_root = standing(skeleton or Skeleton.default())
        self._equal = resampling.equal(self.rate_hz, network.rate_hz)
        self._reach = 0.0 if self._equal else resampling.reach_s(self.rate_hz, network.rate_hz)
        # How far back the network's answers lie, in our time.
        self._late = network.future / (1.0 if self._equal else network.rate_hz)

    def init(self) -> OnlineState:
        """A fresh state."""
        return OnlineState()

    def step(self, state: OnlineState, sample: Sample) -> tuple[OnlineState, Pose | None]:
        """Feed one sample; the pose of `look_ahead_frames` ago, or None before the first."""
        if np.shape(sample.valid) != (len(self.sensors),):
            raise ShapeError(f"a sample must hold {len(self.sensors)} sensors: {self.sensors}")
        held = take(state.recent[-1] if state.recent else None, sample, self.rate_hz)
        # At equal rates each sample is a frame, whatever its clock says.
        time = float(state.ticks) if self._equal else held.time_s
        waiting = (*state.waiting, (time, held.stamp_s))
        if self._equal:
            state = replace(state, recent=(held,), waiting=waiting)
            R, acc = held.R_world_bone, held.acc_world
            state = self._tick(state, R, acc, held.present, held.jumped, time)
        else:
            state = replace(state, recent=(*state.recent, held), waiting=waiting)
            state = self._resampled(state)
        if len(waiting) <= self.look_ahead_frames:
            return state, None
        now, stamp = waiting[0]
        pose = self._between(state.answers, now, stamp)
        # Of the answers, those before the last one at or before the next pose's time have done their duty.
        next_time = waiting[1][0] if len(waiting) > 1 else np.inf
        past = sum(1 for t, _ in state.answers if t <= next_time)
        answers = state.answers[max(0, past - 1) :]
        return replace(state, waiting=waiting[1:], answers=answers), pose

    def _resampled(self, state: OnlineState) -> OnlineState:
        """Every tick that is due."""
        reach = self._reach
        while True:
            tick_s = state.ticks / self.network.rate_hz
            recent = resampling.needed(state.recent, tick_s, reach)
            state = replace(state, recent=recent)
            if not resampling.due(recent, tick_s, reach):
                return state
            R, acc = resampling.at_tick(recent, tick_s, reach)
            present = resampling.present_at(recent, tick_s)
            begin = tick_s - 1 / self.network.rate_hz
            jumped = any(h.jumped for h in recent if begin < h.time_s <= tick_s)
            state = self._tick(state, R, acc, present, jumped, tick_s)

    def _tick(
        self,
        state: OnlineState,
        R: Array,
        acc: Array,
        present: NDArray[np.bool_],
        jumped: bool,
        time: float,
    ) -> OnlineState:
        network, answer = self.network.tick(state.network, R, acc, present, jumped)
        answers = state.answers
        if answer is not None:
            answers = (*answers, (time - self._late, answer))
        return replace(state, network=network, ticks=state.ticks + 1, answers=answers)

    def _between(
        self, answers: tuple[tuple[float, NetworkEstimate], ...], now: float, stamp: float
    ) -> Pose:
        """The pose at time `now`, geodesically between the network's; outside them the ends hold."""
        if not answers:  # nothing has been measured, or samples came faster than their rate
            rest = np.tile(np.eye(3), (24, 1, 1))
            std = np.full((24, 3), UNKNOWN_RAD)
            return Pose(stamp, rest, self.p_world_root, std, "no pose yet")
        times = np.array([t for t, _ in answers])
        k = int(np.clip(np.searchsorted(times, now, "right") - 1, 0, None))
        first = answers[k][1]
        if k + 1 >= len(answers) or times[k] >= now:
            R, std = first.R_parent_joint, first.std_rad
        else:
            second = answers[k + 1][1]
            pair = np.stack([first.R_parent_joint, second.R_parent_joint])
            R = ori.interpolate(times[k : k + 2], pair, [now])[0]
            share = (now - times[k]) / (times[k + 1] - times[k])
            std = first.std_rad + share * (second.std_rad - first.std_rad)
        return Pose(stamp, R, self.p_world_root, std, first.note, first.covariance)


def standing(skeleton: Skeleton) -> Array:
    """(3,) m: the pelvis of the rest pose, above the origin, soles on the floor."""
    p: Array = np.array([0.0, skeleton.standing_height, 0.0])
    p.setflags(write=False)
    return p
