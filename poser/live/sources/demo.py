"""A wearer who is not there: simulated sensors on the built-in motion, strapped on anyhow, over and over.

It stands for the countdown and the pose, as a wearer is asked to, then does the built-in motion.
"""

from __future__ import annotations

import numpy as np

from mocap import synthesis
from mocap.synthesis import motions
from poser.live.sources.playback import Playback
from poser.live.sources.protocol import Intake, Kind, Told

STANDS_S = 3.0  # behind the countdown
SEED = 0


def _make(told: Told) -> Intake:
    stands = motions.stand(told.countdown_s + STANDS_S)
    motion = synthesis.prepare(motions.joined([stands, motions.builtin()]), told.rate_hz, 8.0)
    raw = synthesis.raw_recording(
        motion, told.sensors, synthesis.NOISES["realistic"], np.random.default_rng(SEED)
    )
    return Playback(raw, told.clock, again=True)


SOURCE = Kind("demo", "simulated sensors on the built-in motion; needs nothing", _make, None)
