"""Does a sensor repeat one sample while the body moves?"""

from __future__ import annotations

import numpy as np

from mocap.calibration.evidence import Evidence
from mocap.findings import Finding, Severity
from mocap.recording import RawRecording

HELD_S = 1.0  # a sample repeated for longer to the bit is none: even small noise flips bits
HELD = 20  # samples of it at least: at low rates a stance lasts few
MOVING = 0.3  # rad/s, rms about the mean: what the others do meanwhile, so that nobody simply stands still
WHOLE = 0.9  # of its samples repeated: dead throughout
EDGE = 0.1  # of the recording, repeated at its beginning or end: padding, lost but no fault
# What a sensor that truly rests cannot do: turn while nothing changes, or go on with a jump.
TURNING, JUMP_GYR, JUMP_ACC = 0.2, 0.3, 1.0  # rad/s, rad/s, m/s^2


def check(evidence: Evidence) -> list[Finding]:
    """One finding for each sensor that repeats its sample for over `HELD_S` while most others move.

    Noise-free data of limbs at rest repeats samples as well, which is right: only a sensor that is dead
    throughout, holds a rate other than zero, or jumps where the run ends is accused, and where others rest
    to the bit, too, warned of. Samples that are not valid are gaps and end a run.
    """
    found = []
    raw = evidence.raw
    for s, name in enumerate(raw.sensors):
        if len(raw.sensors) < 2 or not np.isfinite(raw.acc[:, s]).any():
            continue
        least = max(HELD_S * raw.rate_hz, HELD)
        runs = [(a, b) for a, b in _held(raw, s) if b - a > least]
        runs = [(a, b) for a, b in runs if _turns(raw, s, a) or _others(raw, s, a, b)]
        held = sum(b - a for a, b in runs)
        share = held / max(int(raw.valid[:, s].sum()), 1)
        bad = [run for run in runs if share > WHOLE or _impossible(raw, s, *run)]
        if not bad:
            continue
        a, b = max(bad, key=lambda run: run[1] - run[0])
        seconds, start = (b - a) / raw.rate_hz, raw.start_s + a / raw.rate_hz
        T = len(raw)
        padding = (a == 0 or b == T) and b - a < EDGE * T and len(bad) == 1
        doubtful = padding or (_noiseless(raw, s) and not _impossible(raw, s, a, b))
        severity: Severity = "warning" if doubtful else "error"
        found.append(
            Finding(severity, name, "frozen", seconds, {"seconds": seconds, "start_s": start})
        )
    return found


def _noiseless(raw: RawRecording, s: int) -> bool:
    """Whether a sensor other than `s` rests to the bit as well: computed data, in which rest is no fault."""
    others = (r for r in range(len(raw.sensors)) if r != s)
    longest = (max((b - a for a, b in _held(raw, r)), default=0) for r in others)
    return any(n > HELD_S * raw.rate_hz for n in longest)


def _held(raw: RawRecording, s: int) -> list[tuple[int, int]]:
    """Runs [start, stop) of valid samples of sensor `s` whose gyr and acc are all the same."""
    x = np.concatenate([raw.gyr[:, s], raw.acc[:, s]], axis=1)
    ok = raw.valid[:, s]
    same = (x[1:] == x[:-1]).all(axis=1) & ok[1:] & ok[:-1]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False])).reshape(-1, 2)
    return [(int(a), int(b) + 1) for a, b in edges]


def _others(raw: RawRecording, s: int, a: int, b: int) -> bool:
    """Whether most of the other sensors turn in frames a to b-1."""
    gyr = np.where(raw.valid[a:b, :, None], raw.gyr[a:b], np.nan)
    gyr = np.delete(gyr, s, axis=1)
    count = np.isfinite(gyr).all(-1).sum(axis=0)
    known = count > 0.5 * (b - a)
    if not known.any():
        return False
    square = np.nanvar(gyr[:, known], axis=0).sum(axis=-1)
    return bool(np.sqrt(np.median(square)) > MOVING)


def _turns(raw: RawRecording, s: int, t: int) -> bool:
    """Whether frame t of sensor `s` turns faster than any bias: no turning stays the same to the bit."""
    return bool(np.linalg.norm(raw.gyr[t, s]) > TURNING)


def _impossible(raw: RawRecording, s: int, a: int, b: int) -> bool:
    """Whether the repeated sample turns, or the run begins or ends with a jump."""
    if _turns(raw, s, a):
        return True
    for inside, outside in ((a, a - 1), (b - 1, b)):
        if 0 <= outside < len(raw) and raw.valid[outside, s]:
            gyr = raw.gyr[outside, s] - raw.gyr[inside, s]
            acc = raw.acc[outside, s] - raw.acc[inside, s]
            if np.linalg.norm(gyr) > JUMP_GYR or np.linalg.norm(acc) > JUMP_ACC:
                return True
    return False
