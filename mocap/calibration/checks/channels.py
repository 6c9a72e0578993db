"""Channels that carry nothing of their own: a sensor that repeats one sample, or copies another sensor; and
single samples that no sensor can have measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap.calibration.checks.units import WRONG_UNIT, gyr_ratio
from mocap.findings import Finding
from mocap.orientation import GRAVITY, Array
from mocap.recording import Bool, RawRecording
from mocap.sensors import joints_and_seats

HELD_S = 1.0  # a sample repeated for longer to the bit is none: even small noise flips bits
HELD = 20  # samples of it at least: at low rates a stance lasts few
MOVING = 0.3  # rad/s, rms about the mean: what the others do meanwhile, so that nobody simply stands still
WHOLE = 0.9  # of its samples repeated: dead throughout
EDGE = 0.1  # of the recording, repeated at its beginning or end: padding, lost but no fault
# What a sensor that truly rests cannot do: turn while nothing changes, or go on with a jump.
TURNING, JUMP_GYR, JUMP_ACC = 0.2, 0.3, 1.0  # rad/s, rad/s, m/s^2
ALIKE = 0.999
# Of two channels, root mean square: below, there is nothing to compare.
LIVELY_GYR, LIVELY_ACC = 0.1, 0.3  # rad/s, m/s^2
# Of one axis: the widest ranges of sensors people wear are 4000 deg/s (70 rad/s) and 200 g.
MOST_GYR, MOST_ACC = 75.0, 200 * GRAVITY  # rad/s, m/s^2
USUAL_ACC = 20 * GRAVITY  # m/s^2: a median above is another unit (mg, cm/s^2)
RARE = 0.01  # of a sensor's samples: gyr beyond its range more often is another unit (deg/s)
LEAP = 0.5  # of its peak, from one sample to the next: movement, in whatever unit, takes several


def without_spikes(raw: RawRecording) -> tuple[RawRecording, list[Finding]]:
    """`raw` with the samples that no sensor can have measured missing (NaN, not valid); a warning per sensor.

    Where such values are the sensor's usual ones, its unit is wrong, and nothing is changed.
    """
    beyond = {"acc": np.zeros_like(raw.valid), "gyr": np.zeros_like(raw.valid)}
    with np.errstate(invalid="ignore"):
        for what, x, most in (("acc", raw.acc, MOST_ACC), ("gyr", raw.gyr, MOST_GYR)):
            beyond[what] = raw.valid & (np.abs(x) > most).any(axis=-1)
    for s in range(len(raw.sensors)):
        if beyond["acc"][:, s].any():
            size = np.linalg.norm(raw.acc[raw.valid[:, s], s], axis=-1)
            beyond["acc"][:, s] &= bool(np.median(size) < USUAL_ACC)
        if beyond["gyr"][:, s].any():
            beyond["gyr"][:, s] &= _stray(raw, s, beyond["gyr"][:, s])
    bad: Bool = beyond["acc"] | beyond["gyr"]
    if not bad.any():
        return raw, []
    found = []
    for s in map(int, np.flatnonzero(bad.any(axis=0))):
        t, n = int(bad[:, s].argmax()), int(bad[:, s].sum())
        what, unit = ("acc", "m/s^2") if beyond["acc"][t, s] else ("gyr", "rad/s")
        values = getattr(raw, what)[t, s]
        value = float(values[np.abs(values).argmax()])
        first = raw.start_s + t / raw.rate_hz
        text = (
            f"sensor {raw.sensors[s]}: {n} sample{'s' if n > 1 else ''} beyond what sensors can measure, "
            f"taken for missing; the first at {first:.2f} s: {what} {value:.4g} {unit}"
        )
        found.append(Finding("warning", raw.sensors[s], "impossible-sample", text, value))
    gyr, acc = (np.where(bad[..., None], np.nan, x) for x in (raw.gyr, raw.acc))
    return replace(raw, gyr=gyr, acc=acc, valid=raw.valid & ~bad), found


def unmeasured(raw: RawRecording, s: int) -> list[str]:
    """Which of acc and gyr sensor `s` has no sample of."""
    quantities = (("acc", raw.acc), ("gyr", raw.gyr))
    return [what for what, x in quantities if not np.isfinite(x[:, s]).all(axis=-1).any()]


def _stray(raw: RawRecording, s: int, beyond: Bool) -> bool:
    """Whether gyr `beyond` (T,) its range is rare, comes and goes at a leap, and is no turning in deg/s."""
    gyr = raw.gyr[:, s]
    if beyond.sum() > max(1, RARE * raw.valid[:, s].sum()):
        return False
    for a, b in np.flatnonzero(np.diff(np.r_[False, beyond, False])).reshape(-1, 2):
        peak = np.linalg.norm(gyr[a:b], axis=-1).max()
        for inside, outside in ((a, a - 1), (b - 1, b)):
            known = 0 <= outside < len(gyr) and raw.valid[outside, s]
            if known and np.linalg.norm(gyr[inside] - gyr[outside]) < LEAP * peak:
                return False
    rest = raw.gyr.copy()
    rest[beyond, s] = np.nan
    ratio = gyr_ratio(replace(raw, gyr=rest), s)[0]
    return ratio is None or ratio < WRONG_UNIT


def check_channels(raw: RawRecording) -> list[Finding]:
    """Repeated samples of a sensor while others move, and sensors that are copies of others."""
    return _frozen(raw) + _copied(raw)


def _frozen(raw: RawRecording) -> list[Finding]:
    """One finding for each sensor that repeats its sample for over `HELD_S` while most others move.

    Noise-free data of limbs at rest repeats samples as well, which is right: only a sensor that is dead
    throughout, holds a rate other than zero, or jumps where the run ends is accused, and where others rest
    to the bit, too, warned of. Samples that are not valid are gaps and end a run.
    """
    found = []
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
        text = (
            f"sensor {name}: repeats one sample for {seconds:.1f} s from {start:.1f} s on while the body "
            f"moves: it is frozen or its channel is dead"
        )
        T = len(raw)
        padding = (a == 0 or b == T) and b - a < EDGE * T and len(bad) == 1
        doubtful = padding or (_noiseless(raw, s) and not _impossible(raw, s, a, b))
        found.append(Finding("warning" if doubtful else "error", name, "frozen", text, seconds))
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


def _copied(raw: RawRecording) -> list[Finding]:
    """A finding for each sensor that measures what an earlier one does, and is on another bone.

    Two sensors never sit alike to a part in a thousand, even on one bone; noise-free data of a stiff trunk
    does, so that there only equal samples count.
    """
    joints, _ = joints_and_seats(raw.sensors)
    found = []
    for s, name in enumerate(raw.sensors):
        for r in range(s):
            if joints[r] == joints[s]:
                continue
            both = raw.valid[:, r] & raw.valid[:, s]
            if both.sum() < 2 * raw.rate_hz:
                continue
            alike = [
                _likeness(x[both, r], x[both, s], least)
                for x, least in ((raw.gyr, LIVELY_GYR), (raw.acc, LIVELY_ACC))
            ]
            if min(alike) > ALIKE:
                text = (
                    f"sensor {name}: gyr and acc are those of {raw.sensors[r]} (alike to "
                    f"{min(alike):.4f}): one channel was copied to the other"
                )
                found.append(Finding("error", name, "copied", text, min(alike)))
                break
    return found


def _likeness(a: Array, b: Array, least: float) -> float:
    """1 - |a - b|^2 / |a|^2 over the changes of two channels (T,3); 0 where a changes less than `least`."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    size = (a**2).sum()
    if size < least**2 * len(a):
        return 0.0
    return float(1 - ((a - b) ** 2).sum() / size)
