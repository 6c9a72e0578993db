"""Recordings of devices that change places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import sensors, synthesis
from mocap.recording import Recording
from mocap.synthesis import motions


def handed_over(
    phone: tuple[str, str] = ("left_pocket", "right_pocket"), s: float = 4.0
) -> Recording:
    """A watch, earphones and a phone at 25 Hz that changes places half way: four columns, three devices."""
    made = synthesis.recording(
        motions.walk(s + 2, 25.0), ("left_wrist", *phone, "head"), synthesis.NOISES["none"], 3
    ).slice(50, 50 + round(s * 25))
    valid, half = np.array(made.valid), len(made) // 2
    valid[half:, 1] = False
    valid[:half, 2] = False
    return replace(made, valid=valid)


def all_five() -> Recording:
    """Two devices, then three others: all five places, never more than three of them at once."""
    made = synthesis.recording(motions.walk(6.0, 25.0), sensors.FIVE, synthesis.NOISES["none"], 3)
    valid = np.zeros((len(made), 5), bool)
    valid[:75, [0, 2]] = True
    valid[75:, [1, 3, 4]] = True
    return replace(made, valid=valid)
