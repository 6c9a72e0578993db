"""The sentences of evaluation: what a finding about a reference says to a person."""

from __future__ import annotations

from mocap.findings import Finding
from mocap.timeline import seconds


def sentence(finding: Finding, source: str = "the motion") -> str:
    """One sentence about the recording. source: what the motion is called in it."""
    d = finding.details
    if finding.code == "reference-cut":
        return f"of its {seconds(*d['of'])}, {seconds(*d['kept'])} are in {source} and kept"
    if finding.code == "reference-replaced":
        return "the reference motion that it holds is replaced"
    return (
        f"its sensors are {d['apart_deg']:.0f} deg (median) from the bones of {source}: is it the motion of "
        f"this recording, and does it face the same way?"
    )
