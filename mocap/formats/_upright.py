"""Which axis of a file's world points up: what a motion shows of it, and what the user says.

A motion stands at least once, so a trunk that is never upright means that the world was read with the wrong
axis up.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mocap import orientation as ori
from mocap.findings import Finding, doubt
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS

Up = Literal["y", "z"]
_LEAN = 0.5  # cosine of the least lean, 60 deg, from which a trunk counts as lying


def world(up: Up) -> Array:
    """(3,3): v_ours = world(up) v_file, of a file whose axis `up` points up; x stays."""
    return np.eye(3) if up == "y" else ori.R_YUP_ZUP


def doubts(motion: Motion, told: Up | None) -> list[Finding]:
    """A doubt where the trunk is never upright. told: the axis that the user said is up."""
    trunk = motion.p_world_joint[:, JOINTS.index("neck")] - motion.p_world_root
    up = trunk[:, 1] / np.maximum(np.linalg.norm(trunk, axis=1), 1e-300)
    if up.max() >= _LEAN:
        return []
    least = float(np.degrees(np.arccos(np.clip(up.max(), -1.0, 1.0))))
    return [doubt("never-upright", lean_deg=least, told=told)]
