"""What is made of recordings before a network learns from them (which places are worn: test_devices.py)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from learned.training.recorded import Recorded, at_rate
from mocap import sensors as places
from mocap import synthesis
from mocap.errors import PoserError
from tests.learned.swing import wavy


def test_one_frame_is_the_same_at_any_rate() -> None:
    made = synthesis.recording(wavy(30, 100.0), places.SIX).slice(10, 11)
    found = at_rate(made, 60.0)
    assert len(found) == 1 and found.reference is not None and len(found.reference) == 1
    np.testing.assert_allclose(found.acc_world, made.acc_world)
    np.testing.assert_allclose(found.R_world_bone, made.R_world_bone, atol=1e-12)


def test_why_there_is_nothing_to_train_on_is_said() -> None:
    made = synthesis.recording(wavy(30), places.SIX)
    with pytest.raises(PoserError, match="no recording with a reference of 31 frames or more"):
        Recorded([made], 31)
    never = replace(made, valid=np.zeros((30, 6), bool))
    with pytest.raises(PoserError, match="no recording to train on has a sensor that measured"):
        Recorded([never, made.slice(0, 11)], 12)
