"""A window that follows a wrong valley of the cost: would the network's poses be a cheaper beginning?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from sip import Horizon
from sip.horizon import HorizonState
from sip.kinematics import BODY
from sip.terms.arrival import of_constants


class Valley:
    """late: frames at the window's end that the network has not spoken of."""

    def __init__(self, late: int, steps: int = 2) -> None:
        self.late, self.steps = late, steps

    def cheaper(self, horizon: Horizon, state: HorizonState) -> HorizonState | None:
        """The window in the network's valley where its frames alone cost less there, else None.

        What has left the window is a quadratic about poses of the valley that it has followed and would say
        nothing else: it counts on neither side, and is forgotten where the valley is left.
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
        g = horizon.model.border
        sigma = np.tile(horizon.model.constants_sigma, horizon.kinematics.S)
        fresh = of_constants(sigma, point.u, g, horizon.kinematics.n)
        here = replace(state, arrival=fresh)
        there = replace(here, point=horizon.problem(here).point(x, point.R_ref, point.u))
        for _ in range(self.steps):
            here, there = horizon.improved(here), horizon.improved(there)
        return there if horizon.cost(there) < horizon.cost(here) else None
