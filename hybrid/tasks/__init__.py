"""The tasks of a frame, one file each. A new one is a file here, or a class of the user's own:

class HeadLevel(Task):
    def term(self, frame):
        head = frame.at.on(15)              # any joint, and a point on it
        up = head.R_world_bone[:, 1]        # the head's own up, in world axes
        J = -rotations.hat(up) @ head.J_rotation
        return Residual(up[[0, 2]] / 0.1, J[[0, 2]] / 0.1)

Tracker(network, tasks=[*tasks.standard(), HeadLevel()])
"""

from __future__ import annotations

from hybrid.settings import TrackerSettings
from hybrid.tasks.orientation import Orientation
from hybrid.tasks.position import Position
from hybrid.tasks.prior import NetworkPrior
from hybrid.tasks.task import Frame, Residual, Task, TaskResult

__all__ = [
    "Frame",
    "NetworkPrior",
    "Orientation",
    "Position",
    "Residual",
    "Task",
    "TaskResult",
    "standard",
]


def standard(settings: TrackerSettings | None = None) -> tuple[Task, ...]:
    """What the tracker uses where nothing else is said: the network's pose, the measured orientations and,
    with `TrackerSettings.positions`, the sensors' positions."""
    s = settings or TrackerSettings()
    found: list[Task] = [NetworkPrior(), Orientation(s.orientation_sigma_deg)]
    if s.positions:
        found.append(
            Position(
                s.position_gate_sigma, s.position_robust_sigma, s.restart_after_s, s.filter_noise
            )
        )
    return tuple(found)
