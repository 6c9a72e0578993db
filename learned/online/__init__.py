"""The networks as online estimators (`mocap.estimator.Estimator`): any input rate, explicit state."""

from learned.online.estimator import NetworkEstimate, Online, OnlineState, RollingWindow
from learned.online.streaming import stream

__all__ = ["NetworkEstimate", "Online", "OnlineState", "RollingWindow", "stream"]
