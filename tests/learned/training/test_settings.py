"""Schedules and what settings refuse."""

from __future__ import annotations

import math
from typing import Any

import pytest

from learned.checkpoint import LARGEST_HIDDEN
from learned.config import Config
from learned.errors import TrainingError
from learned.training.settings import TrainSettings


def test_the_papers_schedules() -> None:
    """DIP 4.1 and IMUPoser 4.3."""
    dip, imuposer = TrainSettings.paper("dip"), TrainSettings.paper("imuposer")
    assert (dip.learning_rate, dip.decay, dip.decay_steps, dip.clip) == (1e-3, 0.96, 2000, 1.0)
    assert (imuposer.learning_rate, imuposer.batch, imuposer.frames) == (3e-4, 256, 125)
    assert imuposer.rate_at(50_000, 0.5) == 3e-4 and math.isinf(imuposer.clip)


def test_rate_decays_and_cools_down() -> None:
    s = TrainSettings(learning_rate=1.0, decay=0.5, decay_steps=10)
    assert s.rate_at(0, 0.0) == 1.0 and s.rate_at(20, 0.9) == pytest.approx(0.25)
    s = TrainSettings(learning_rate=1.0, decay=1.0, cooldown=0.4)
    rates = [s.rate_at(0, done) for done in (0.0, 0.6, 0.8, 1.0, 1.2)]
    assert rates == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"steps": 0}, "steps must be 1 or more"),
        ({"batch": 0}, "batch must be 1 or more"),
        ({"frames": 7}, "frames must be 8 or more"),
        ({"learning_rate": 0.0}, r"learning_rate must be .* above 0"),
        ({"learning_rate": math.nan}, r"learning_rate must be .* above 0"),
        ({"clip": -1.0}, r"clip must be .* above 0"),
        ({"average": 1.0}, "average must lie in"),
        ({"cooldown": 2.0}, "cooldown must lie in"),
        ({"minutes": 0.0}, "minutes must be above zero"),
        ({"steps": None}, "steps or minutes must say when the run ends"),
        ({"config": Config(hidden=LARGEST_HIDDEN + 1)}, "hidden must be 1 to 8192, got 8193"),
    ],
)
def test_refusals(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(TrainingError, match=said):
        TrainSettings(**changes)
