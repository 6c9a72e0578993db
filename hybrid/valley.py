"""A window that follows a wrong valley of the cost: would the network's poses be a cheaper beginning?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from sip import Horizon
from sip.horizon import HorizonState
from sip.kinematics import BODY
from sip.terms.arrival import of_constants

TROUBLED = 6.0  # cost of a frame; about 3 is usual, a window that has lost the person has 12 to 100
FRAMES = 4  # that the window in the network's valley gets to settle
SHARE = 0.5  # of the window's cost, under which the other valley is the right one


def troubled(state: HorizonState) -> bool:
    """Whether the window explains what was measured so badly that it may have lost the person."""
    return state.cost > TROUBLED * len(state)


def rival(horizon: Horizon, state: HorizonState) -> HorizonState | None:
    """The window as it would be in the network's poses; None where the network has not spoken.

    What has left the window is a quadratic about poses of the valley that it has followed and would say
    nothing else: it is forgotten where the valley is left.
    """
    evidence, point = state.evidence, state.point
    assert evidence is not None and point is not None and evidence.belief is not None
    belief = evidence.belief
    told = np.flatnonzero(belief.scale.any(axis=1))
    if not len(told):
        return None
    nearest = told[np.abs(told[:, None] - np.arange(len(state))).argmin(axis=0)]
    R = belief.R[nearest][:, int(belief.root) :]
    x = point.x.copy()
    x[:, BODY] = ori.log(R).reshape(len(x), -1)
    alone = _alone(horizon, state)
    return replace(alone, point=horizon.problem(alone).point(x, point.R_ref, point.u), factor=None)


def cheaper(horizon: Horizon, state: HorizonState, other: HorizonState) -> bool:
    """Whether the other's frames cost less than half of these, without what has left the windows.

    In one valley both cost the same but for what the past has pulled these to, and changing from one to the
    other forgets the past. Another valley that is the right one costs a fraction.
    """
    mine, others = (horizon.cost(_alone(horizon, s)) for s in (state, other))
    return others < SHARE * mine


def _alone(horizon: Horizon, state: HorizonState) -> HorizonState:
    assert state.point is not None
    sigma = np.tile(horizon.model.constants_sigma, horizon.kinematics.S)
    u, border = state.point.u, horizon.model.border
    return replace(state, arrival=of_constants(sigma, u, border, horizon.kinematics.n))
