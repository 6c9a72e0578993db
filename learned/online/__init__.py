"""The networks as online estimators (`mocap.estimator.Estimator`): any input rate, explicit state."""

from learned.online.estimator import NetworkPose, Online, OnlineState, RollingWindow
from learned.online.streaming import stream

__all__ = ["NetworkPose", "Online", "OnlineState", "RollingWindow", "stream"]
