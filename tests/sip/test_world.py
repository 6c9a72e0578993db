"""Nothing but gravity tells directions of the world apart: turned about it, the answer turns along."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import sensors, synthesis
from mocap.synthesis.motions import walk
from sip import Settings, solve


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({"solver": "ipopt"}, sensors.SIX),
        ({"solver": "ipopt-cold"}, sensors.SIX),
        ({"solver": "ipopt", "self_calibration": True}, sensors.SIX),
        # Without a pelvis sensor the start's root is a guess, which must turn as well.
        ({"solver": "ipopt"}, sensors.FIVE),
        ({"solver": "ipopt-cold"}, sensors.FIVE),
    ],
    ids=str,
)
def test_turning_the_world_turns_the_answer(settings: dict, names: tuple[str, ...]) -> None:
    """The same in each way of solving, of which the default is the banded solver and IPOPT after it.

    The root is R_ref Exp(w) with R_ref turning along, and every term is either of angles or of lengths in
    the world, so the two solves take the same steps. They may part by rounding only, which the solvers
    amplify to some 1e-12 and, along the root's position that hardly anything holds, 1e-8 m: far below
    what their tolerance would let two different paths end apart (2e-3, see `test_solve`).
    """
    yaw = 2.1
    recording = synthesis.recording(walk(3.0, 15.0), names, synthesis.Noise(), 1)
    a = solve(recording, settings=Settings(**settings))
    b = solve(recording.turned(yaw), settings=Settings(**settings))
    assert a.converged and b.converged
    turned = a.motion.turned(yaw)
    assert np.abs(a.motion.R_world_joint - turned.R_world_joint).max() > 1.0
    assert np.abs(b.motion.R_world_joint - turned.R_world_joint).max() < 1e-7
    assert np.abs(b.motion.p_world_root - turned.p_world_root).max() < 1e-5
    assert b.total_cost == pytest.approx(a.total_cost, rel=1e-9)
