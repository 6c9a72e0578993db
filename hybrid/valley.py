"""A window that follows a wrong valley of the cost: would the network's poses be a cheaper beginning?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from sip import Horizon
from sip.horizon import HorizonState
from sip.kinematics import BODY
from sip.terms.arrival import of_constants


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
    """Whether the other's frames alone cost less than these, without what has left the windows."""
    return horizon.cost(_alone(horizon, other)) < horizon.cost(_alone(horizon, state))


def _alone(horizon: Horizon, state: HorizonState) -> HorizonState:
    assert state.point is not None
    sigma = np.tile(horizon.model.constants_sigma, horizon.kinematics.S)
    u, border = state.point.u, horizon.model.border
    return replace(state, arrival=of_constants(sigma, u, border, horizon.kinematics.n))
