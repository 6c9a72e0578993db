"""Samples that no sensor can have measured, and that were taken for missing."""

from __future__ import annotations

from dataclasses import asdict

from mocap.calibration.evidence import Evidence
from mocap.findings import Finding


def check(evidence: Evidence) -> list[Finding]:
    """A warning for each sensor that has such samples."""
    return [
        Finding("warning", spike.sensor, "impossible-sample", spike.value, asdict(spike))
        for spike in evidence.spikes
    ]
