"""Time stamps on a regular grid: jitter is evened out, a wandering clock is followed, gaps stay gaps.

Stamp k of frame f_k is t_k = start + f_k / rate + wander(k) + jitter(k). Jitter stays around zero, so a
stamp that is late by chance is made up for by the next; after a loss all later stamps are late by whole
steps. Where jitter is small, the step itself tells how many samples are lost; where it is large, the
median lateness before and after it does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.errors import FormatError
from mocap.findings import Finding, doubt
from mocap.orientation import Array

MAX_GROWTH = 4  # a grid with its gaps filled holds at most this many times the samples of the file
CLEAN = 0.05  # of a step, 1 sigma: below it a single step tells of losses
NO_CLOCK = 0.45  # of a step, 1 sigma: stamps that scatter so much say no rate
LARGEST_DRIFT = 0.02  # of the rate, over LONG stamps: quartz is a thousand times better
LONG = 510
SLOW = 51  # stamps whose median is free of jitter
LEVEL = 15  # stamps on either side of a step whose median tells a loss from jitter
USUAL_SPAN = 16
SWEEPS = 100
Frames = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Grid:
    """rate_hz; frame (N,) of each stamp; doubts: what was found; slow_s (N,): the stamps
    without their jitter, s."""

    rate_hz: float
    frames: Frames
    doubts: tuple[Finding, ...]
    slow_s: Array


def grid(path: Path, t: Array, where: str = "time") -> Grid:
    """The grid of time stamps t (N,) s, which must rise.

    Raises FormatError where they do not, where a gap is longer than all of the samples, and where the stamps
    follow no constant rate.
    """
    _check_rises(path, t, where)
    step = np.diff(t)
    # The mean over steps without a gap: stamps rounded to 0.01 s have a median step that is wrong.
    usual = float(step[step < 1.5 * np.median(step)].mean())
    lost = np.maximum(np.rint(step / usual), 1).astype(np.int64) - 1
    _check_gaps(path, t, step, usual, lost, where)
    frames, off = _frames(t, lost)
    if off.jitter > CLEAN:
        lost = _losses(t, step, usual)
        _check_gaps(path, t, step, usual, lost, where)
        frames, off = _frames(t, lost)
    if off.jitter > NO_CLOCK or off.steepest > LARGEST_DRIFT:
        apart = np.abs(step - (lost + 1) / off.rate_hz)
        k = int(np.argmax(apart))
        raise FormatError(
            path,
            f"a step of {step[k]:.4g} s where {1 / off.rate_hz:.4g} s is usual, expected a constant rate",
            f"frame {k + 1}, {where}",
        )
    rate = float(f"{off.rate_hz:.9g}")
    return Grid(rate, frames, tuple(_doubts(where, off, frames, len(t))), off.slow_s)


@dataclass(frozen=True, eq=False)
class _Off:
    """How stamps lie around the grid. worst, jitter: of a step, the largest and 1 sigma; wander: frames;
    steepest: change of the rate that the wandering is, as a fraction."""

    rate_hz: float
    worst: float
    jitter: float
    wander: float
    steepest: float
    slow_s: Array


def _frames(t: Array, lost: Frames) -> tuple[Frames, _Off]:
    frames = np.r_[0, np.cumsum(lost + 1)].astype(np.int64)
    slope, start = np.polyfit(frames, t - t[0], 1)
    off = (t - t[0] - start) / slope - frames
    slow = _slow(off)
    jitter = off - slow
    span = max(1, min(LONG, len(t) // 2))
    turn = np.abs(slow[span:] - slow[:-span]) / np.maximum(frames[span:] - frames[:-span], 1)
    steepest = float(turn.max(initial=0.0)) if len(t) > 4 * SLOW else 0.0
    return frames, _Off(
        float(1 / slope), float(np.abs(jitter).max()), float(np.sqrt(np.mean(jitter**2))),
        float(np.ptp(slow)), steepest, t[0] + start + (frames + slow) * slope,
    )  # fmt: skip


def _slow(off: Array) -> Array:
    """What of the stamps' lateness (N,) is no jitter: medians of SLOW stamps, straight lines in between."""
    n = len(off)
    if n < 4 * SLOW:
        return np.zeros(n)
    blocks = n // SLOW
    edges = np.linspace(0, n, blocks + 1).astype(int)
    middle = (edges[:-1] + edges[1:] - 1) / 2
    level = np.array([np.median(off[a:b]) for a, b in pairwise(edges)])
    # Beyond the outer middles the last line goes on.
    k = np.arange(n)
    out = np.interp(k, middle, level)
    for side, (a, b) in ((k < middle[0], (0, 1)), (k > middle[-1], (-2, -1))):
        tilt = (level[b] - level[a]) / (middle[b] - middle[a])
        out[side] = level[a] + tilt * (k[side] - middle[a])
    return out


def _losses(t: Array, step: Array, usual: float) -> Frames:
    """Samples lost in each step (N-1,), of stamps that jitter: by the lateness before and after it."""
    span = min(USUAL_SPAN, len(t) - 1)
    usual = float(np.median(t[span:] - t[:-span])) / span if len(t) > 4 * span else usual
    late = np.flatnonzero(step > 1.5 * usual)
    lost = np.zeros(len(step), np.int64)
    lost[late] = np.rint(step[late] / usual) - 1
    for _ in range(SWEEPS):
        shift = _shifts(t / usual - np.r_[0, np.cumsum(lost + 1)], late)
        change = np.maximum(np.rint(shift), -lost[late]).astype(np.int64)
        first = _first_of_neighbours(
            late, np.abs(change) + 0.1 * np.sign(change) * step[late] / usual
        )
        if not change[first].any():
            break
        lost[late[first]] += change[first]
    return lost


def _shifts(off: Array, at: Frames) -> Array:
    """How much later the LEVEL stamps after each step of `at` are than those up to it, in the median."""
    around = np.pad(off, LEVEL, constant_values=np.nan)
    window = np.arange(LEVEL)
    before, after = (around[(at + LEVEL)[:, None] + k] for k in (-window, 1 + window))
    return np.asarray(np.nanmedian(after, axis=1) - np.nanmedian(before, axis=1))


def _first_of_neighbours(at: Frames, score: Array) -> NDArray[np.bool_]:
    """Which of the steps `at`, rising, have the largest score within LEVEL steps: two that see the same
    loss must not both count it."""
    first = np.ones(len(at), bool)
    for k in range(1, LEVEL + 1):
        near = at[k:] - at[:-k] <= LEVEL
        if not near.any():
            break
        first[k:] &= ~(near & (score[:-k] >= score[k:]))
        first[:-k] &= ~(near & (score[k:] > score[:-k]))
    return first


def _check_rises(path: Path, t: Array, where: str) -> None:
    if len(t) < 2:
        raise FormatError(path, "fewer than two samples", where)
    if not (np.abs(t) < 1e12).all():
        k = int(np.argmin(np.abs(t) < 1e12))
        raise FormatError(path, f"is {t[k]}, expected seconds", f"frame {k}, {where}")
    step = np.diff(t)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0)) + 1
        raise FormatError(
            path, f"{t[k]:g} s after {t[k - 1]:g} s, must rise", f"frame {k}, {where}"
        )


def _check_gaps(path: Path, t: Array, step: Array, usual: float, lost: Frames, where: str) -> None:
    """Raises FormatError where filled gaps would be MAX_GROWTH times what the file holds."""
    if lost.sum() + len(step) > MAX_GROWTH * len(t) + 10:
        k = int(np.argmax(step)) + 1
        raise FormatError(
            path, f"a gap of {step.max():.3g} s at steps of {usual:.3g} s", f"frame {k}, {where}"
        )


def _doubts(where: str, off: _Off, frames: Frames, samples: int) -> list[Finding]:
    found = []
    if off.worst > 0.1:
        found.append(doubt("stamps-jitter", where=where, jitter=float(off.worst)))
    if off.wander > 0.5:
        wander, rate = float(off.wander), float(off.rate_hz)
        found.append(doubt("clock-wanders", where=where, wander_frames=wander, rate_hz=rate))
    lost = int(frames[-1]) + 1 - samples
    if lost:
        found.append(doubt("stamps-missing", where=where, count=lost, of=int(frames[-1]) + 1))
    return found


def within(place: str, doubts: Sequence[Finding]) -> list[Finding]:
    """Doubts of one of several clocks: `place` stands before where they are."""
    return [
        replace(d, details={**d.details, "where": f"{place}: {d.details['where']}"}) for d in doubts
    ]
