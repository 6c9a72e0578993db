"""The offline optimizer: orientation, acceleration and anthropometric terms over whole sequences."""

from sip.prior import Prior
from sip.settings import Settings
from sip.solve import solve
from sip.starts import Start, cheapest

__all__ = ["Prior", "Settings", "Start", "cheapest", "solve"]
