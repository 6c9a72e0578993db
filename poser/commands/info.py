"""What a file holds: kind, rate, length, sensors, gaps, and what its reader assumed or doubts."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files, options
from poser.console import DONE, emit, say

if TYPE_CHECKING:
    from mocap.findings import Finding
    from mocap.formats import Document
    from mocap.recording import RawRecording, Recording

HELP = "what a file holds: rate, length, sensors, gaps"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="a motion or a recording")
    options.add_reading(parser)
    options.add_json(parser)


def run(args: Namespace) -> int:
    doc = files.read(args.file, options.reading(args))
    facts = describe(doc)
    if args.json:
        emit(facts)
    else:
        _print(args.file, facts | {"warnings": _untold(doc)})
    return DONE


def _untold(doc: Document) -> list[str]:
    """The warnings beside those about missing samples, which are told sensor by sensor."""
    from mocap.words import sentence

    def gap(finding: Finding) -> bool:
        return finding.code == "missing-samples" and finding.details["what"] is None

    return [sentence(f) for f in doc.doubts if not gap(f)]


def describe(doc: Document) -> dict[str, Any]:
    """The JSON of `poser info`; lengths in s, a body's stature in m."""
    from mocap.motion import Motion

    content = doc.content
    facts: dict[str, Any] = {
        "kind": doc.kind,
        "format": doc.format,
        "rate_hz": content.rate_hz,
        "frames": len(content),
        "seconds": content.seconds,
    }
    if isinstance(content, Motion):
        facts |= {"sensors": [], "has_reference": False, "gaps": []}
        facts["height_m"] = content.skeleton.stature
    else:
        facts["sensors"] = list(content.sensors)
        facts["has_reference"] = content.reference is not None
        facts["gaps"] = _gaps(content)
    facts["start_s"] = content.start_s
    return facts | {"assumptions": list(doc.assumptions), "warnings": list(doc.warnings)}


def _gaps(recording: Recording | RawRecording) -> list[dict[str, Any]]:
    """Per sensor that has any: how many gaps, frames missing in all, and the longest."""
    from mocap.recording import gaps

    runs: dict[int, list[int]] = {}
    for gap in gaps(recording.valid):
        runs.setdefault(gap["sensor"], []).append(gap["frames"])
    return [
        {
            "sensor": recording.sensors[s],
            "count": len(lengths),
            "frames": sum(lengths),
            "longest_frames": max(lengths),
            "longest_seconds": max(lengths) / recording.rate_hz,
        }
        for s, lengths in sorted(runs.items())
    ]


def _print(path: Path, facts: dict[str, Any]) -> None:
    say(f"{path}: {facts['kind']} ({facts['format']})")
    say(
        f"  {facts['frames']} frames at {facts['rate_hz']:g} Hz, {facts['seconds']:.2f} s"
        + (f", from {facts['start_s']:g} s" if facts["start_s"] else "")
    )
    if facts["kind"] == "motion":
        say(f"  body of {facts['height_m']:.2f} m")
    else:
        say(f"  {len(facts['sensors'])} sensors: {', '.join(facts['sensors'])}")
        say(f"  reference motion: {'yes' if facts['has_reference'] else 'no'}")
    for gap in facts["gaps"]:
        say(
            f"  gaps of {gap['sensor']}: {gap['count']}, {gap['frames']} frames in all, "
            f"the longest {gap['longest_frames']} ({gap['longest_seconds']:.2f} s)"
        )
    for name in ("assumptions", "warnings"):
        for text in facts[name]:
            say(f"  {name.removesuffix('s')}: {text}")
