"""Which axis of a file's world points up: what a motion shows of it, and what the user says.

A motion stands at least once, so a trunk that is never upright means that the world was read with the wrong
axis up.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS

Up = Literal["y", "z"]
_LEAN = 0.5  # cosine of the least lean, 60 deg, from which a trunk counts as lying


def world(up: Up) -> Array:
    """(3,3): v_ours = world(up) v_file, of a file whose axis `up` points up; x stays."""
    return np.eye(3) if up == "y" else ori.R_YUP_ZUP


def doubts(motion: Motion, told: Up | None) -> list[str]:
    """A sentence where the trunk is never upright, and how to mend it unless the axis was told."""
    trunk = motion.p_world_joint[:, JOINTS.index("neck")] - motion.p_world_root
    up = trunk[:, 1] / np.maximum(np.linalg.norm(trunk, axis=1), 1e-300)
    if up.max() >= _LEAN:
        return []
    most = np.degrees(np.arccos(np.clip(up.max(), -1.0, 1.0)))
    said = f"the trunk is never upright, it leans by {most:.0f} deg or more"
    if told is not None:
        return [f"{said} with {told} up, as told"]
    return [f"{said}: another axis of the file may point up; --up y or --up z says which"]
