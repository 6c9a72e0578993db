"""Bodies side by side that play in a page: data and script are part of the page, nothing is fetched."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from mocap import orientation as ori
from mocap.body import Skin, mesh_skin
from mocap.motion import Motion
from mocap.skeleton import JOINTS, PARENTS, Skeleton
from poser.report.placing import beside
from poser.report.results import COLOURS, NAMES, NO_SKILL, Compared, joint_colour
from poser.report.templating import fill

RATE_HZ = 30.0
BUDGET_BYTES = 24_000_000
"""Of poses in a page; recordings beyond it are left out, and said so."""


def section(recordings: Sequence[Compared]) -> Markup:
    """The player's HTML: as many of the recordings as `BUDGET_BYTES` holds, the first ones."""
    shown: list[dict[str, Any]] = []
    spent, mesh = 0, Mesh()
    for compared in recordings:
        entry, size = _entry(compared, mesh)
        if shown and spent + size > BUDGET_BYTES:
            break
        shown.append(entry)
        spent += size
    left = len(recordings) - len(shown)
    data = {
        "parents": list(PARENTS),
        "colours": [joint_colour(name) for name in JOINTS],
        "recordings": shown,
        "mesh": mesh.data(),
    }
    return fill("player.html", data=data, left=left)


class Mesh:
    """The free mesh as the page has it: faces and weights once, vertices for each skeleton that is shown."""

    def __init__(self) -> None:
        self._skins: dict[bytes, Skin] = {}

    def index(self, skeleton: Skeleton) -> int:
        """Which of the bodies a skeleton's is."""
        key = skeleton.offsets.tobytes()
        if key not in self._skins:
            self._skins[key] = mesh_skin(skeleton)
        return list(self._skins).index(key)

    def data(self) -> dict[str, Any]:
        """Lengths in mm; a vertex hangs on four joints by weights of 255."""
        found = list(self._skins.values())
        joints, weights = found[0].largest(4)
        share = np.round(255 * weights)
        share[:, 0] += 255 - share.sum(axis=1)
        return {
            "faces": _packed(found[0].faces, "<u2"), "joints": _packed(joints, "u1"),
            "weights": _packed(share, "u1"),
            "bodies": [
                {"vertices": _packed(1000 * s.vertices, "<i2"), "rest": _packed(1000 * s.rest, "<i2")}
                for s in found
            ],
        }  # fmt: skip


def _packed(values: Any, kind: str) -> str:
    """Whole numbers of a kind, in base64."""
    return base64.b64encode(np.round(values).astype(kind).tobytes()).decode("ascii")


def _entry(compared: Compared, mesh: Mesh) -> tuple[dict[str, Any], int]:
    reference = compared.truth
    rate = min(RATE_HZ, reference.rate_hz)
    tracks: list[dict[str, Any]] = [
        {"name": "reference", "colour": "#888888"} | _poses(reference, rate, reference, mesh)
    ]
    for name, result in compared.methods.items():
        if name in NO_SKILL:
            continue
        track: dict[str, Any] = {
            "name": NAMES.get(name, name),
            "colour": COLOURS.get(name, "#333333"),
        }
        track |= _poses(result.motion, rate, reference, mesh)
        error = result.metrics.frame_position_cm
        if error is not None:
            source = result.metrics.rate_hz or reference.rate_hz
            at = np.minimum(
                (np.arange(track["frames"]) * source / rate).astype(int), len(error) - 1
            )
            track["error_cm"] = [round(float(e), 1) for e in error[at]]
        tracks.append(track)
    size = sum(len(t["data"]) + len(t["turns"]) for t in tracks)
    start = round(compared.start_s, 6)
    return {"name": compared.name, "rate": rate, "start": start, "tracks": tracks}, size


def _poses(motion: Motion, rate_hz: float, reference: Motion, mesh: Mesh) -> dict[str, Any]:
    """Joints in mm as little-endian int16, base64: frame by frame, 24 joints, xyz; `turns` their global
    rotations, quaternions w x y z of 32767.

    The reference's pelvis stays over the middle of the floor, the others stand there with it (`beside`).
    """
    true = reference.resampled(rate_hz).p_world_joint
    true = true - true[:, :1] * [1, 0, 1]
    shown = motion.resampled(rate_hz)
    p = beside(shown.p_world_joint, true[np.minimum(np.arange(len(shown)), len(true) - 1)])
    return {
        "frames": len(p), "data": _packed(np.clip(1000 * p, -32768, 32767), "<i2"),
        "turns": _packed(32767 * ori.to_quat(shown.R_world_joint), "<i2"),
        "body": mesh.index(motion.skeleton),
    }  # fmt: skip
