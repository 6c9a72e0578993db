"""A network that knows the truth and errs by a known amount: what the tracker is tested on."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid import Tracker, TrackerSettings
from mocap import Motion, Recording
from mocap import orientation as ori
from mocap import sensors as places
from mocap.estimator import Estimator, Pose, Sample, samples
from mocap.orientation import Array


def smooth_errors(
    frames: int, rate_hz: float, sigma_deg: float, seed: int, correlation_s: float = 0.4
) -> Array:
    """(T,24,3) rad: two first-order filters in a row over white noise, stationary, unit variance first."""
    rng = np.random.default_rng(seed)
    settle = int(10 * correlation_s * rate_hz)
    keep = np.exp(-2 / (rate_hz * correlation_s))
    x = rng.normal(size=(settle + frames, 24, 3))
    for _ in range(2):
        for t in range(1, len(x)):
            x[t] += keep * x[t - 1]
    x = x[settle:]
    # Variance of the AR(2) process with the double root `keep`.
    variance = (1 + keep**2) / (1 - keep**2) ** 3
    return np.deg2rad(sigma_deg) * x / np.sqrt(variance)


class FakeNetwork:
    """Emits truth Exp(error), `look_ahead` frames late; its state is the times it has seen.

    error (T,24,3) rad. std_deg: what it says of itself (None: nothing). Frames past the truth's end
    repeat it.
    """

    def __init__(
        self,
        truth: Motion,
        error: Array | None = None,
        names: tuple[str, ...] = places.SIX,
        look_ahead: int = 5,
        std_deg: float | None = None,
    ) -> None:
        self.rate_hz, self.sensors, self.look_ahead_frames = truth.rate_hz, names, look_ahead
        error = np.zeros((len(truth), 24, 3)) if error is None else error
        self._R = truth.R_parent_joint @ ori.exp(error)
        self._p = truth.p_world_root
        self._std = None if std_deg is None else np.full((24, 3), np.deg2rad(std_deg))

    def init(self) -> tuple[float, ...]:
        return (0,)

    def step(
        self, state: tuple[float, ...], sample: Sample
    ) -> tuple[tuple[float, ...], Pose | None]:
        count, times = int(state[0]), (*state[1:], sample.time_s)
        times = times[-self.look_ahead_frames - 1 :]
        state = (count + 1, *times)
        if count < self.look_ahead_frames:
            return state, None
        t = (count - self.look_ahead_frames) % len(self._R)
        return state, Pose(times[0], self._R[t], self._p[t], self._std)


def run(estimator: Estimator, recording: Recording) -> tuple[list[Pose], object]:
    """All poses of a recording, the last `look_ahead_frames` of it fed once more to push them out."""
    state = estimator.init()
    poses = []
    rows = list(samples(recording))
    for k in range(estimator.look_ahead_frames):
        last = rows[-1]
        end = rows[len(recording) - 1].time_s + (k + 1) / recording.rate_hz
        rows.append(Sample(end, last.R_world_bone, last.acc_world, last.valid))
    for sample in rows:
        state, pose = estimator.step(state, sample)
        if pose is not None:
            poses.append(pose)
    return poses, state


def motion_of(poses: list[Pose], like: Motion) -> Motion:
    """The motion that poses make."""
    R = np.stack([p.R_parent_joint for p in poses])
    return Motion(like.rate_hz, R, np.stack([p.p_world_root for p in poses]), like.skeleton)


def single(**changes: Any) -> TrackerSettings:
    """Of the single frame's QP alone, with these changes."""
    return TrackerSettings(horizon_s=0.0, **changes)


def tracked(network: FakeNetwork, recording: Recording, **kwargs: object) -> tuple[Motion, Motion]:
    """The network's own motion and the tracker's, the single frame's where no settings say more, over one
    recording."""
    like = recording.reference
    assert like is not None
    alone, _ = run(network, recording)
    refined, _ = run(Tracker(network, **{"settings": single(), **kwargs}), recording)  # type: ignore[arg-type]
    return motion_of(alone, like), motion_of(refined, like)
