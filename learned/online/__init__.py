"""The networks as online estimators (`mocap.estimator.Estimator`): any input rate, explicit state."""

from learned.online.estimator import Online, OnlineState
from learned.online.factory import dip, imuposer

__all__ = ["Online", "OnlineState", "dip", "imuposer"]
