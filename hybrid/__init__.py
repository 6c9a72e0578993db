"""The real-time hybrid: a network's pose refined each frame by a small QP over the measurements.

`Tracker` goes around any `mocap.estimator.Estimator`; `TrackerSettings` are its numbers; `tasks` are what the
QP minimises, to which your own can be added.
"""

from hybrid import tasks
from hybrid.motion_filter import FilterNoise
from hybrid.settings import TrackerSettings
from hybrid.tracker import Tracker, TrackerState

__all__ = ["FilterNoise", "Tracker", "TrackerSettings", "TrackerState", "tasks"]
