"""Several starts: the cheapest is kept, all are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import Motion, Recording
from mocap import orientation as ori
from mocap.errors import SolveError
from sip import Settings, cheapest, solve

# Too few for the starts to end in one place; judging what stands would be followed by further ones.
FEW = Settings(solver="banded", max_iterations=2, sigma_contact=float("inf"))


def exchanged(motion: Motion) -> Motion:
    """A start far from the truth: left and right exchanged."""
    return motion.mirrored()


def test_the_cheapest_is_kept(recording: Recording, motion: Motion) -> None:
    starts = {"mirror": exchanged(motion), "truth": motion}
    words: list[str] = []
    kept = cheapest(recording, starts, settings=FEW, progress=lambda f, w: words.append(w))
    alone = {n: solve(recording, settings=replace(FEW, start=s)) for n, s in starts.items()}
    assert alone["truth"].total_cost < 0.9 * alone["mirror"].total_cost
    assert kept.report["start"] == "truth"
    assert kept.total_cost == alone["truth"].total_cost
    for name, solution in alone.items():
        assert kept.report["starts"][name]["cost"] == solution.total_cost
    apart = ori.angle_between(
        alone["mirror"].motion.R_world_joint, alone["truth"].motion.R_world_joint
    )
    assert kept.report["starts_apart_deg"] == pytest.approx(np.rad2deg(apart.mean()))
    assert any(w.startswith("from mirror") for w in words)
    assert any(w.startswith("from truth") for w in words)


def test_one_start_is_a_solve(recording: Recording) -> None:
    one = cheapest(recording, {"prior": "prior"}, settings=FEW)
    assert one.total_cost == solve(recording, settings=FEW).total_cost
    assert "starts_apart_deg" not in one.report


def test_costs_that_cannot_be_compared_are_refused(recording: Recording, motion: Motion) -> None:
    with pytest.raises(SolveError, match="no start"):
        cheapest(recording, {})
    with pytest.raises(SolveError, match="self-calibration"):
        cheapest(
            recording, {"prior": "prior", "truth": motion},
            settings=Settings(self_calibration=True),
        )  # fmt: skip
