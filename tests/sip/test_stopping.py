"""When the banded way calls a point converged, and what it says otherwise."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from mocap import Recording, Skeleton, sensors, synthesis
from sip import Settings, initial
from sip.problem import Problem, build
from sip.solvers import banded
from tests.sip.conftest import wavy


@pytest.fixture(scope="module")
def noisy() -> Recording:
    return synthesis.recording(wavy(30), sensors.SIX, synthesis.Noise(), 1)


@pytest.fixture(scope="module")
def problem(noisy: Recording) -> Problem:
    return build(noisy, Skeleton.default(), Settings())


Solved = Callable[..., banded.Result]


@pytest.fixture(scope="module")
def solved(noisy: Recording, problem: Problem) -> Solved:
    """From the prior's mean, with options of `banded.minimise`."""
    x, R_ref = initial.from_prior(noisy, Skeleton.default(), problem.prior, 0, len(noisy))

    def run(**how: float) -> banded.Result:
        return banded.minimise(problem, x, R_ref, np.zeros((problem.S, 7)), **how)  # type: ignore[arg-type]

    return run


def promised(result: banded.Result) -> float:
    """The share of the cost that the status says a full step promises."""
    found = re.search(r"promises (\S+) % of the cost", result.status)
    assert found is not None
    return float(found.group(1)) / 100


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_what_is_left_is_what_was_said(problem: Problem, solved: Solved, tolerance: float) -> None:
    """Solving on to rounding wins no more than a few times the promise, and that is below the tolerance."""
    result = solved(tolerance=tolerance)
    assert result.converged
    assert result.status.startswith("converged: ")
    assert promised(result) <= tolerance
    best = solved(tolerance=1e-12)
    left = 1 - problem.cost(best.point) / problem.cost(result.point)
    assert left < 4 * promised(result) + 1e-9


@pytest.mark.parametrize(
    ("size", "words"),
    [(1e-5, "stopped after 3 steps that each lowered"), (1e-6, "stalled on steps too short")],
)
def test_short_steps_are_no_convergence(
    solved: Solved, monkeypatch: pytest.MonkeyPatch, size: float, words: str
) -> None:
    """Damped to a crawl no step lowers the cost by the tolerance: that alone is no minimum."""
    monkeypatch.setattr(banded, "_STEP_ROOT", size)
    monkeypatch.setattr(banded, "_STEP_ANGLE", size)
    result = solved(tolerance=0.2)
    assert not result.converged
    assert promised(result) > 0.2
    assert result.status.startswith(words)


def test_the_iteration_limit_is_said(solved: Solved) -> None:
    result = solved(max_iterations=1)
    assert not result.converged
    assert result.iterations == 1
    assert result.status.startswith("stopped at the limit of 1 iterations: a full step promises")
