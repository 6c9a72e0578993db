"""The offline optimizer: orientation, acceleration and anthropometric terms over whole sequences."""

from sip.belief import PoseBelief
from sip.horizon import Horizon, HorizonSettings
from sip.prior import Prior
from sip.settings import Settings
from sip.solve import solve
from sip.starts import Start, cheapest

__all__ = [
    "Horizon",
    "HorizonSettings",
    "PoseBelief",
    "Prior",
    "Settings",
    "Start",
    "cheapest",
    "solve",
]
