"""Is a sensor's range too small for the motion?"""

from __future__ import annotations

import numpy as np

from mocap.calibration.evidence import Evidence
from mocap.findings import Finding
from mocap.orientation import Array


def check(evidence: Evidence) -> list[Finding]:
    """A warning for each sensor whose acc or gyr reaches its range's end."""
    found = []
    for s, name in evidence.each:
        gyr, acc, _ = evidence.channels(s)
        found += _of_channel(name, "acc", acc) + _of_channel(name, "gyr", gyr)
    return found


def _of_channel(name: str, what: str, x: Array) -> list[Finding]:
    """Samples that stay at an axis's extreme while the other axes move."""
    worst, limit = 0, 0.0
    for k in range(3):
        for sign in (1.0, -1.0):
            top = float((sign * x[:, k]).max())
            if top <= 1e-3:
                continue
            at = sign * x[:, k] >= top * (1 - 1e-9)
            others = np.abs(np.diff(np.delete(x, k, axis=1), axis=0)).max(axis=1)
            n = int((at[1:] & at[:-1] & (others > 0.02 * top)).sum())
            if n > worst:
                worst, limit = n, top
    if worst < 3:
        return []
    details = {"what": what, "limit": limit, "samples": worst}
    return [Finding("warning", name, "clipping", limit, details)]
