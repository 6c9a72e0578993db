"""Is there enough of a sensor to judge it by?"""

from __future__ import annotations

import numpy as np

from mocap.calibration.evidence import Evidence
from mocap.calibration.measures import unmeasured
from mocap.findings import Finding


def check(evidence: Evidence) -> list[Finding]:
    """An error for each sensor without any acc or gyr, or with less than a second of both."""
    raw, found = evidence.raw, []
    least = int(np.ceil(raw.rate_hz))
    for s, name in evidence.each:
        # A sample counts where gyr and acc are both there.
        absent, count = unmeasured(raw, s), int(raw.valid[:, s].sum())
        if absent or count < least:
            details = {"absent": absent, "count": count, "least": least}
            found.append(Finding("error", name, "no-data", float(count), details))
    return found
