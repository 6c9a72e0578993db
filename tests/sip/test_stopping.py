"""When the banded way calls a point converged, and what it says otherwise."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mocap import Skeleton, sensors, synthesis
from sip import Settings, initial
from sip.problem import Problem, build
from sip.solvers import banded
from tests.sip.conftest import wavy


@pytest.fixture(scope="module")
def problem() -> Problem:
    recording = synthesis.recording(wavy(30), sensors.SIX, synthesis.Noise(), 1)
    return build(recording, Skeleton.default(), Settings())


def solved(problem: Problem, **how: float) -> banded.Result:
    x, R_ref = initial.from_prior(
        problem.recording, problem.skeleton, problem.prior, 0, len(problem.recording)
    )
    return banded.minimise(problem, x, R_ref, np.zeros((problem.S, 7)), **how)  # type: ignore[arg-type]


def promised(result: banded.Result) -> float:
    """The share of the cost that the status says a full step promises."""
    found = re.search(r"promises (\S+) % of the cost", result.status)
    assert found is not None
    return float(found.group(1)) / 100


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_what_is_left_is_what_was_said(problem: Problem, tolerance: float) -> None:
    """Solving on to rounding wins no more than a few times the promise, and that is below the tolerance."""
    result = solved(problem, tolerance=tolerance)
    assert result.converged
    assert result.status.startswith("converged: ")
    assert promised(result) <= tolerance
    best = solved(problem, tolerance=1e-12)
    left = 1 - problem.cost(best.point) / problem.cost(result.point)
    assert left < 4 * promised(result) + 1e-9


@pytest.mark.parametrize(
    ("size", "words"),
    [(1e-5, "stopped after 3 steps that each lowered"), (1e-6, "stalled on steps too short")],
)
def test_short_steps_are_no_convergence(
    problem: Problem, monkeypatch: pytest.MonkeyPatch, size: float, words: str
) -> None:
    """Damped to a crawl no step lowers the cost by the tolerance: that alone is no minimum."""
    monkeypatch.setattr(banded, "_STEP_ROOT", size)
    monkeypatch.setattr(banded, "_STEP_ANGLE", size)
    result = solved(problem, tolerance=0.2)
    assert not result.converged
    assert promised(result) > 0.2
    assert result.status.startswith(words)


def test_the_iteration_limit_is_said(problem: Problem) -> None:
    result = solved(problem, max_iterations=1)
    assert not result.converged
    assert result.iterations == 1
    assert result.status.startswith("stopped at the limit of 1 iterations: a full step promises")
