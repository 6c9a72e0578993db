"""The poses that calibrate: N (arms down) and T (arms to the sides)."""

from __future__ import annotations

import numpy as np

from mocap import orientation as ori
from mocap.errors import CalibrationError
from mocap.orientation import Array

LEFT_ARM, RIGHT_ARM = (16, 18, 20, 22), (17, 19, 21, 23)
ARM_ANGLE_DEG = 80.0
ARM_ANGLES_DEG = (0.0, 100.0)


def pose_bones(joints: np.ndarray, pose: str = "n", arm_angle_deg: float = ARM_ANGLE_DEG) -> Array:
    """R_world_bone (S,3,3) of bones `joints` (S,) in the T- or N-pose of a wearer who faces +z."""
    if pose not in ("n", "t"):
        raise CalibrationError(f"pose {pose!r} unknown: n (arms down) or t (arms to the sides)")
    low, high = ARM_ANGLES_DEG
    if not low <= arm_angle_deg <= high:
        raise CalibrationError(f"arm angle {arm_angle_deg:g} deg is outside {low:g} to {high:g}")
    a = np.radians(arm_angle_deg) if pose == "n" else 0.0
    angles = np.where(np.isin(joints, LEFT_ARM), -a, np.where(np.isin(joints, RIGHT_ARM), a, 0.0))
    return ori.rot_z(angles)
