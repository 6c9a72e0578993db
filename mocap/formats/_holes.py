"""Holes in a reference motion: a motion has none, files do.

Short ones are bridged on the manifold, R_a Exp(s Log(R_a^T R_b)) from the last known rotation to the next,
joint by joint. Frames at either end, and what lies beyond a long hole, are cut off with the sensors' data
of those frames. The larger part decides: where cutting would cost half of the frames or more, the
sensors stay whole and the reference is given up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.findings import Finding, doubt
from mocap.orientation import Array
from mocap.recording import Bool, gaps

# A limb that stops or turns back does so within this time, unseen by a straight line.
LONGEST_S = 0.25


@dataclass(frozen=True, eq=False)
class Bridged:
    """Values without holes of the frames `kept` of the file, and what was done.

    Where too little would be left, the values as they were, of all frames, and nothing done.
    """

    values: Array
    kept: slice
    notes: tuple[Finding, ...] = ()


def rotations(R: Array, rate_hz: float) -> Bridged:
    """R (T,K,3,3), NaN where missing, mended."""
    has = np.asarray(np.isfinite(R).all(axis=(-1, -2)), bool)
    whole = np.asarray(has.all(axis=1), bool)
    kept = _kept(whole, rate_hz)
    if whole.all() or kept is None:
        return Bridged(R, slice(0, len(R)))
    out, known = R[kept].copy(), has[kept]
    times = np.arange(len(out))
    for j in np.flatnonzero(~known.all(axis=0)):
        ok = known[:, j]
        out[~ok, j] = ori.interpolate(times[ok], out[ok, j], times[~ok])
    return Bridged(out, kept, _notes(whole, kept))


def poses(values: Array, rate_hz: float) -> Bridged:
    """SMPL axis-angle (T,72) rad, NaN where missing, mended; what is there stays to the last digit."""
    w = values.reshape(len(values), -1, 3)
    has = np.asarray(np.isfinite(w).all(axis=-1), bool)
    R = np.full((*has.shape, 3, 3), np.nan)
    R[has] = ori.exp(w[has])
    found = rotations(R, rate_hz)
    out, known = w[found.kept].copy(), has[found.kept]
    out[~known] = ori.log(found.values[~known])
    return Bridged(out.reshape(len(out), -1), found.kept, found.notes)


def _kept(whole: Bool, rate_hz: float) -> slice | None:
    """The longest stretch that starts and ends with a whole frame and has no long hole.

    None where it is half of the frames or less.
    """
    first, stretches = 0, []
    for hole in _holes(whole):
        stop = hole[0] + hole[1]
        if hole[1] > LONGEST_S * rate_hz or hole[0] == 0 or stop == len(whole):
            stretches.append((first, hole[0]))
            first = stop
    start, stop = max([*stretches, (first, len(whole))], key=lambda s: s[1] - s[0])
    return slice(start, stop) if 2 * (stop - start) > len(whole) else None


def _holes(whole: Bool) -> list[tuple[int, int]]:
    """(first frame, frames) of each run of frames that are not whole."""
    return [(g["start"], g["frames"]) for g in gaps(whole[:, None])]


def _notes(whole: Bool, kept: slice) -> tuple[Finding, ...]:
    said = []
    cut = [(0, kept.start), (kept.stop, len(whole))]
    ends = [[a, b - 1] for a, b in cut if b > a]
    if ends:
        said.append(doubt("hole-cut", cut=ends, of=len(whole)))
    inside = _holes(whole[kept])
    if inside:
        lengths = [n for _, n in inside]
        said.append(doubt("hole-bridged", poses=sum(lengths), longest_frames=max(lengths)))
    return tuple(said)
