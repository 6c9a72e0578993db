"""Online estimators of models. precision: of the recurrent matrices (`learned.runtime`)."""

from __future__ import annotations

from learned.dip.window import DipWindow
from learned.imuposer.window import ImuposerWindow
from learned.models import Dip, Imuposer
from learned.online.estimator import Online
from learned.runtime import Precision, prepare
from mocap import sensors as places
from mocap.skeleton import Skeleton


def dip(
    model: Dip,
    rate_hz: float,
    window: tuple[int, int] = (20, 5),
    sensors: tuple[str, ...] = places.SIX,
    skeleton: Skeleton | None = None,
    precision: Precision = "float32",
) -> Online:
    """DIP on samples at `rate_hz`; sensors: the six, in DIP's order, under the recording's names."""
    return Online(DipWindow(model, window, sensors, prepare(model, precision)), rate_hz, skeleton)


def imuposer(
    model: Imuposer,
    rate_hz: float,
    sensors: tuple[str, ...],
    place: tuple[int, ...] | None = None,
    skeleton: Skeleton | None = None,
    precision: Precision = "float32",
) -> Online:
    """IMUPoser on samples at `rate_hz`; sensors and place: as in `ImuposerWindow`."""
    window = ImuposerWindow(model, sensors, place, runtime=prepare(model, precision))
    return Online(window, rate_hz, skeleton)
