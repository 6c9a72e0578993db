"""The offline optimizer: orientation, acceleration and anthropometric terms over whole sequences."""

from sip.belief import PoseBelief
from sip.emission import Shown, shown
from sip.horizon import Horizon, HorizonSettings
from sip.passes import passes
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
    "Shown",
    "Start",
    "cheapest",
    "passes",
    "shown",
    "solve",
]
