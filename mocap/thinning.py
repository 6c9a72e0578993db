"""Recordings faster than a body moves: fewer frames to estimate from, answers at their own rate.

Frame j of n-fold thinned data is the mean of the n samples around frame j n, so that what is faster than the
new rate does not come back as something slow, and noise falls by sqrt(n).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording

MOST_HZ = 120.0
"""Bodies move below 20 Hz; more frames than this only take longer."""


def factor(rate_hz: float, most_hz: float = MOST_HZ) -> int:
    """Of how many frames one is left, so that no more than `most_hz` (within 1 %) remain."""
    return max(1, int(np.ceil(rate_hz / (1.01 * most_hz))))


def thinned(recording: Recording, most_hz: float = MOST_HZ) -> Recording:
    """`recording` at rate_hz / n, the fastest that is at most `most_hz`; itself where it is no faster.

    Orientations are chordal means, accelerations means, over the n samples around each frame that is left
    (n + 1 for an even n, the outer two of half weight). One counts where at least half of its samples do. The
    reference is taken at the frames that are left.
    """
    n = factor(recording.rate_hz, most_hz)
    if n == 1:
        return recording
    at = np.arange(0, len(recording), n)
    R, seen = _means(
        recording.R_world_bone.reshape(*recording.valid.shape, 9), recording.ori_valid, n, at
    )
    acc, moved = _means(recording.acc_world, recording.acc_valid, n, at)
    matrices = np.full((*seen.shape, 3, 3), np.nan)
    matrices[seen] = ori.project(R[seen].reshape(-1, 3, 3))
    reference, rate = recording.reference, recording.rate_hz / n
    return replace(
        recording,
        rate_hz=rate,
        R_world_bone=matrices,
        acc_world=np.where(moved[..., None], acc, np.nan),
        valid=seen | moved,
        reference=None if reference is None else reference.sampled(at / recording.rate_hz, rate),
    )


def _means(x: Array, ok: np.ndarray, n: int, at: np.ndarray) -> tuple[Array, np.ndarray]:
    """Means (N,S,K) of valid x (T,S,K) around the frames `at` (N,), and whether half of it is valid.

    At the ends of the recording, of those that there are.
    """
    half = n // 2
    weights = np.ones(2 * half + 1)
    if n % 2 == 0:
        weights[[0, -1]] = 0.5
    rows = at[:, None] + np.arange(-half, half + 1)
    inside = (rows >= 0) & (rows < len(x))
    rows = np.clip(rows, 0, len(x) - 1)
    w = np.where(inside[..., None] & ok[rows], weights[:, None], 0.0)
    total, possible = w.sum(axis=1), (inside * weights).sum(axis=1)
    summed = np.einsum("nks,nksc->nsc", w, np.nan_to_num(x[rows]))
    mean = summed / np.maximum(total, 1e-9)[..., None]
    return mean, total >= 0.5 * possible[:, None]


def times(motion: Motion, recording: Recording) -> Array:
    """The times (T,) of the frames of `recording`, in s after the first frame of `motion`."""
    begin = recording.start_s - motion.start_s
    return np.asarray(begin + np.arange(len(recording)) / recording.rate_hz)


def given_back(motion: Motion, recording: Recording) -> Motion:
    """`motion` at every frame of `recording`, on its clock; the last pose holds to the recording's end."""
    if len(motion) == len(recording) and motion.rate_hz == recording.rate_hz:
        return motion
    return motion.sampled(times(motion, recording), recording.rate_hz)


def deviations_given_back(std_rad: Array, motion: Motion, recording: Recording) -> Array:
    """Deviations (N,24,3) of `motion` at every frame of `recording`, linear in between."""
    if len(std_rad) == len(recording):
        return std_rad
    own = np.arange(len(std_rad)) / motion.rate_hz
    flat = std_rad.reshape(len(std_rad), -1)
    at = times(motion, recording)
    columns = [np.interp(at, own, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(at), *std_rad.shape[1:])
