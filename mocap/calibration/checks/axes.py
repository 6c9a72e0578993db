"""Are axes of one sensor reversed or exchanged, or is its gyr in another unit?

See `mocap.calibration.axes` for what tells, and what cannot be told.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap.calibration.axes import (
    Better,
    better,
    from_up,
    readings,
    relative,
    stretches,
    wandering,
    wandering_if_scaled,
)
from mocap.calibration.evidence import Evidence
from mocap.calibration.measures import DEG, FASTEST, turning
from mocap.findings import Finding, Severity
from mocap.orientation import Array
from mocap.recording import Bool

FAST = 20.0  # rad/s: people seldom turn faster
LEAST_TURNING = 0.15  # rad/s, rms: below, gyr is not held against the orientation


def check(evidence: Evidence) -> list[Finding]:
    """Axes and unit of each sensor, against its orientation where there is one, else gyr against acc.

    By the likely rate and scale of gyr (`Evidence.rates`): a wrong one would look like wrong axes.
    """
    found = []
    rates, R_all = evidence.rates, evidence.raw.R_world_sensor
    for k, (s, name) in enumerate(evidence.each):
        gyr, acc, ok = evidence.channels(s)
        gyr = gyr * rates.factor[k]
        told: list[Finding] = []
        if R_all is not None:
            has = ok & np.isfinite(R_all[:, s]).all((-1, -2))
            if has.sum() > rates.rate_hz:
                told = _against_orientation(name, gyr, acc, R_all[:, s], has, rates.rate_hz)
        found += told or _against_each_other(name, gyr, acc, ok, rates.rate_hz)
    return found


def _against_each_other(
    name: str, gyr: Array, acc: Array, ok: Bool, rate_hz: float
) -> list[Finding]:
    """gyr and acc (T,3), bridged over what is not `ok` (T,): gravity must rest where gyr carries it."""
    fast = float(np.percentile(np.linalg.norm(gyr, axis=1), 99.5))
    if fast > FASTEST:
        return [_finding(name, np.eye(3) * DEG, None, fast, {"by": "speed", "fastest": fast})]
    windows = stretches(gyr, acc, ok, rate_hz)
    if windows is None:
        return []
    wanders = wandering(*windows)
    trials = list(readings())
    factors = [DEG] if fast > FAST else [1 / DEG] if fast < FASTEST * DEG else []
    for factor in factors:
        trials.append(np.eye(3) * factor)
        wanders = np.vstack([wanders, wandering_if_scaled(windows, factor)])
    found = better(wanders, trials)
    return [] if found is None else [_told(name, found, None, "gravity")]


def _against_orientation(
    name: str, gyr: Array, acc: Array, R: Array, has: Bool, rate_hz: float
) -> list[Finding]:
    """gyr against the rate of R_world_sensor, and acc, turned by it, against gravity."""
    found = []
    w, g = turning(gyr, R, has, rate_hz)
    if np.sqrt((w**2).sum(axis=1).mean()) > LEAST_TURNING:
        trials = [*readings(), np.eye(3) * DEG]
        off = [relative(w, g @ M.T) for M in trials]
        best = int(np.argmin(off))
        if off[0] > 0.4 and off[best] < 0.5 * off[0]:
            found.append(_finding(name, trials[best], "gyr", off[0], {"by": "rate", "off": off[0]}))
    wanders = from_up(R, acc, has, rate_hz)
    upright = None if wanders is None else better(wanders, readings())
    if upright is not None:
        found.append(_told(name, upright, "acc", "upright"))
    return found


def _told(name: str, found: Better, of: str | None, by: str) -> Finding:
    """An error where it is sure, else a warning."""
    details = {"by": by, "before_deg": found.before_deg, "after_deg": found.after_deg}
    severity: Severity = "error" if found.sure else "warning"
    return _finding(name, found.reading, of, found.before_deg, details, severity)


def _finding(
    name: str,
    M: Array,
    of: str | None,
    value: float,
    details: dict[str, Any],
    severity: Severity = "error",
) -> Finding:
    """The finding for the correction M (3,3) that fits: `of` gyr or acc, or (None) of either."""
    if abs(abs(M).max() - DEG) < 1e-9:
        code = "gyr-in-deg"
    elif abs(M).max() > 1:
        code = "gyr-unit"
    else:
        # Of either: two reversed axes of gyr are the same as the third of acc, the simpler mistake.
        either = "acc" if (np.diag(M) < 0).sum() == 2 and np.diag(M).all() else "gyr"
        code = f"{of or either}-axes"
    return Finding(severity, name, code, value, {**details, "of": of, "correction": M.tolist()})
