"""Does a sensor measure what another one on another bone does?"""

from __future__ import annotations

from mocap.calibration.evidence import Evidence
from mocap.findings import Finding
from mocap.orientation import Array

ALIKE = 0.999
# Of two channels, root mean square: below, there is nothing to compare.
LIVELY_GYR, LIVELY_ACC = 0.1, 0.3  # rad/s, m/s^2


def check(evidence: Evidence) -> list[Finding]:
    """A finding for each sensor that measures what an earlier one does, and is on another bone.

    Two sensors never sit alike to a part in a thousand, even on one bone; noise-free data of a stiff trunk
    does, so that there only equal samples count.
    """
    raw, joints = evidence.raw, evidence.joints
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
                details = {"of": raw.sensors[r], "likeness": min(alike)}
                found.append(Finding("error", name, "copied", min(alike), details))
                break
    return found


def _likeness(a: Array, b: Array, least: float) -> float:
    """1 - |a - b|^2 / |a|^2 over the changes of two channels (T,3); 0 where a changes less than `least`."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    size = (a**2).sum()
    if size < least**2 * len(a):
        return 0.0
    return float(1 - ((a - b) ** 2).sum() / size)
