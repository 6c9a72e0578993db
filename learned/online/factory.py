"""Online estimators of models."""

from __future__ import annotations

from learned.models import Dip, Imuposer
from learned.online.dip import DipWindow
from learned.online.estimator import Online
from learned.online.imuposer import ImuposerWindow
from mocap import sensors as places
from mocap.skeleton import Skeleton


def dip(
    model: Dip,
    rate_hz: float,
    window: tuple[int, int] = (20, 5),
    sensors: tuple[str, ...] = places.SIX,
    skeleton: Skeleton | None = None,
) -> Online:
    """DIP on samples at `rate_hz`; sensors: the six, in DIP's order, under the recording's names."""
    return Online(DipWindow(model, window, sensors), rate_hz, skeleton)


def imuposer(
    model: Imuposer,
    rate_hz: float,
    sensors: tuple[str, ...],
    place: tuple[int, ...] | None = None,
    skeleton: Skeleton | None = None,
) -> Online:
    """IMUPoser on samples at `rate_hz`; sensors and place: as in `ImuposerWindow`."""
    return Online(ImuposerWindow(model, sensors, place), rate_hz, skeleton)
