"""Skeletons side by side that play in a page: data and script are part of the page, nothing is fetched."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from mocap.motion import Motion
from mocap.skeleton import JOINTS, PARENTS
from poser.report.placing import beside
from poser.report.results import COLOURS, NAMES, NO_SKILL, Compared, joint_colour
from poser.report.templating import fill

RATE_HZ = 30.0
BUDGET_BYTES = 24_000_000
"""Of joint positions in a page; recordings beyond it are left out, and said so."""


def section(recordings: Sequence[Compared]) -> Markup:
    """The player's HTML: as many of the recordings as `BUDGET_BYTES` holds, the first ones."""
    shown: list[dict[str, Any]] = []
    spent = 0
    for compared in recordings:
        entry, size = _entry(compared)
        if shown and spent + size > BUDGET_BYTES:
            break
        shown.append(entry)
        spent += size
    left = len(recordings) - len(shown)
    data = {
        "parents": list(PARENTS),
        "colours": [joint_colour(name) for name in JOINTS],
        "recordings": shown,
    }
    return fill("player.html", data=data, left=left)


def _entry(compared: Compared) -> tuple[dict[str, Any], int]:
    reference = compared.truth
    rate = min(RATE_HZ, reference.rate_hz)
    tracks: list[dict[str, Any]] = [
        {"name": "reference", "colour": "#888888"} | _positions(reference, rate, reference)
    ]
    for name, result in compared.methods.items():
        if name in NO_SKILL:
            continue
        track: dict[str, Any] = {
            "name": NAMES.get(name, name),
            "colour": COLOURS.get(name, "#333333"),
        }
        track |= _positions(result.motion, rate, reference)
        error = result.metrics.frame_position_cm
        if error is not None:
            source = result.metrics.rate_hz or reference.rate_hz
            at = np.minimum(
                (np.arange(track["frames"]) * source / rate).astype(int), len(error) - 1
            )
            track["error_cm"] = [round(float(e), 1) for e in error[at]]
        tracks.append(track)
    size = sum(len(t["data"]) for t in tracks)
    start = round(compared.start_s, 6)
    return {"name": compared.name, "rate": rate, "start": start, "tracks": tracks}, size


def _positions(motion: Motion, rate_hz: float, reference: Motion) -> dict[str, Any]:
    """Joints in mm as little-endian int16, base64: frame by frame, 24 joints, xyz.

    The reference's pelvis stays over the middle of the floor, the others stand there with it (`beside`).
    """
    true = reference.resampled(rate_hz).p_world_joint
    true = true - true[:, :1] * [1, 0, 1]
    p = motion.resampled(rate_hz).p_world_joint
    p = beside(p, true[np.minimum(np.arange(len(p)), len(true) - 1)])
    mm = np.clip(np.round(1000 * p), -32768, 32767).astype("<i2")
    return {"frames": len(p), "data": base64.b64encode(mm.tobytes()).decode("ascii")}
