"""Is much lost of a sensor, or lost for long?"""

from __future__ import annotations

from mocap.calibration.evidence import Evidence
from mocap.findings import Finding
from mocap.recording import gaps

MUCH, LONG_S = 0.1, 1.0  # of its samples; s


def check(evidence: Evidence) -> list[Finding]:
    """A warning for each sensor that lacks over a tenth of its samples, or a second of them in a row."""
    raw, found = evidence.raw, []
    longest: dict[int, int] = {}
    for gap in gaps(raw.valid):
        longest[gap["sensor"]] = max(longest.get(gap["sensor"], 0), gap["frames"])
    for s, frames in longest.items():
        share, seconds = float(1 - raw.valid[:, s].mean()), frames / raw.rate_hz
        if share > MUCH or seconds > LONG_S:
            details = {"share": share, "longest_s": seconds}
            found.append(Finding("warning", raw.sensors[s], "gaps", share, details))
    return found
