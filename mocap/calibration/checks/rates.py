"""Are the sampling rate and the scale of each gyroscope as they are said to be?"""

from __future__ import annotations

import numpy as np

from mocap.calibration.evidence import Evidence
from mocap.findings import Finding, Severity

FAR = float(np.log(1.25))  # a scale off by more is an error


def check(evidence: Evidence) -> list[Finding]:
    """An error where the rate is another one, a finding for each sensor whose gyr has another scale."""
    rates, given = evidence.rates, evidence.raw.rate_hz
    found = []
    if rates.ratio != 1:
        details = {"given_hz": given, "ratio": rates.ratio, "by": rates.by}
        found.append(Finding("error", None, "sampling-rate", rates.rate_hz, details))
    for name, ratio in rates.scales.items():
        severity: Severity = "error" if abs(np.log(ratio)) > FAR else "warning"
        details = {"ratio": ratio}
        if len(evidence.judged) == 1:
            details["or_rate_hz"] = given * ratio
        found.append(Finding(severity, name, "gyr-scale", ratio, details))
    return found
