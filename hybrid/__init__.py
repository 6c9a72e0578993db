"""The real-time hybrid: a network's pose refined each frame by a small QP over the measurements."""

from hybrid.settings import TrackerSettings
from hybrid.tracker import Tracker, TrackerState

__all__ = ["Tracker", "TrackerSettings", "TrackerState"]
