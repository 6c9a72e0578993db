"""Bones turn as their sensors measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid import rotations
from hybrid.point_kinematics import Configuration
from hybrid.tasks.task import Frame, Residual, Task, TaskResult
from mocap.orientation import Array

# Past this angle the logarithm's gradient points the wrong way as soon as noise crosses the half turn.
MAX_ANGLE = np.deg2rad(150.0)


class Orientation(Task):
    """Log(R_measured^T R_world_bone) / sigma of every limb's sensor that has measured.

    sigma_deg: of a measured bone orientation (mounting, heading, soft tissue). The pelvis sensor has no
    share: its rotation is taken as it is (`hybrid.refinement`).
    """

    def __init__(self, sigma_deg: float = 8.0) -> None:
        self.sigma_deg = sigma_deg
        self._sigma = float(np.deg2rad(sigma_deg))

    def evidence(self, frame: Frame, state: Any) -> TaskResult:
        """Counts "orientation refused": sensors further off than `MAX_ANGLE`."""
        use = (frame.seen & frame.worn.limbs).nonzero()[0]
        term, angle = residual(frame.at, use, frame.sample.R_world_bone[use], self._sigma)
        refused = int((angle > MAX_ANGLE).sum())
        return TaskResult(term, state, {"orientation refused": refused})


def residual(
    at: Configuration, point: np.ndarray, R_measured: Array, sigma: float
) -> tuple[Residual, Array]:
    """Log(R_measured^T R_world_bone) / sigma of the points `point`, sigma in rad.

    R(dv) = R Exp(R^T J_rotation dv), so the Jacobian is J_r^-1(Log(R_measured^T R)) R^T J_rotation. Also
    returns the angles (m,) rad; a term whose angle exceeds MAX_ANGLE is left out (zero).
    """
    R = at.R_world_bone[point]
    w = rotations.log(R_measured.mT @ R)
    angle = rotations.norm(w)
    weight = (angle <= MAX_ANGLE) / sigma
    turning = rotations.right_jacobian_inv(w) * weight[:, None, None] @ R.mT
    J = turning @ at.J_rotation[point]
    return Residual((w * weight[:, None]).ravel(), J.reshape(-1, J.shape[-1])), angle
