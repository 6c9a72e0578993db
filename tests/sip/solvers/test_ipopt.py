"""What IPOPT is given: the matrix that the banded solver factors, and a start on its central path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import Skeleton, sensors, synthesis
from sip import Settings, initial
from sip.problem import Problem, build
from sip.solvers import banded, ipopt
from sip.solvers.band import Factor
from tests.sip.conftest import wavy
from tests.sip.solvers.test_band import dense


def built(settings: Settings, frames: int, fixed: int = 0, names=sensors.FIVE) -> Problem:
    recording = synthesis.recording(wavy(frames), names, synthesis.Noise(), 1)
    return build(recording, Skeleton.default(), settings, fixed=fixed)


@pytest.mark.parametrize("calibrating", [False, True])
@pytest.mark.parametrize("order", [0, 2, 3])
@pytest.mark.parametrize(("frames", "fixed"), [(9, 0), (9, 3), (2, 0)])
def test_matrix_is_that_of_the_band(
    rng: np.random.Generator, calibrating: bool, order: int, frames: int, fixed: int
) -> None:
    settings = Settings(self_calibration=calibrating, smooth_order=order)  # type: ignore[arg-type]
    problem = built(settings, frames, fixed)
    x = rng.normal(size=(frames, problem.n)) * 0.2
    R_ref = np.broadcast_to(np.eye(3), (frames, 3, 3))
    band = problem.hessian(problem.point(x, R_ref, np.zeros((problem.S, 7))))
    H = dense(band)[fixed * problem.n :, fixed * problem.n :]
    scale = rng.uniform(0.5, 2, size=len(H))
    triangle = ipopt._Triangle(problem, scale)
    given = np.zeros_like(H)
    rows, columns = triangle.sparsity.get_triplet()
    given[rows, columns] = triangle.gather(band)
    assert np.allclose(given, np.triu(H / np.outer(scale, scale)), rtol=1e-12, atol=0)


def test_central_path() -> None:
    """Slack times multiplier is mu, and an active bound's multiplier balances the slope."""
    mu = 1e-4
    z = np.array([-1.0, 1.0, 0.0, -1.0, 5.0])
    slope = np.array([2.0, -3.0, 0.0, 0.0, 7.0])
    lower, upper = np.array([-1.0] * 4 + [-np.inf]), np.array([1.0] * 4 + [np.inf])
    point, multiplier = ipopt._central(z, slope, lower, upper, mu)
    assert np.allclose(multiplier[:2], -slope[:2])
    assert np.allclose(np.abs(multiplier[:4]) * (1 - np.abs(point[:4])), mu)
    assert point[2] == 0
    assert point[3] == pytest.approx(-1 + np.sqrt(mu))  # no slope: a slack of sqrt(mu), no more
    assert point[4] == 5
    assert multiplier[4] == 0


def test_finish_is_short_where_limits_bind() -> None:
    """All angles want to leave a narrow box: the banded way settles which do, IPOPT confirms it."""
    frames = 24
    recording = synthesis.recording(wavy(frames), sensors.SUIT)
    narrow = replace(Settings().prior, lower=np.full(69, -0.1), upper=np.full(69, 0.1))
    settings = Settings(prior=narrow, tolerance=1e-5)
    problem = build(recording, Skeleton.default(), settings)
    x, R_ref = initial.from_prior(recording, Skeleton.default(), problem.prior, 0, frames)
    soft = banded.minimise(problem, x, R_ref, np.zeros((problem.S, 7))).point
    hard = banded.minimise(problem, soft.x, soft.R_ref, soft.u, box=problem.box)
    bound = (hard.point.x == problem.box.lower) | (hard.point.x == problem.box.upper)
    assert bound.sum() > 100
    done = ipopt.minimise(problem, hard.point.x, hard.point.R_ref, hard.point.u, True)
    assert done.converged
    # From the soft minimum, or from the bounds themselves, it takes hundreds.
    assert done.iterations <= 10
    assert problem.cost(done.point) == pytest.approx(problem.cost(hard.point), rel=1e-4)
    cold = ipopt.minimise(problem, x, R_ref, soft.u, False)
    assert problem.cost(done.point) <= problem.cost(cold.point) * (1 + 1e-4)


@pytest.mark.parametrize("calibrating", [False, True])
def test_size_grows_linearly_with_length(calibrating: bool) -> None:
    """Each further frame adds the same to the band, to its factor and to what IPOPT is given."""
    sizes = []
    for frames in (10, 20, 30, 40):
        problem = built(Settings(self_calibration=calibrating), frames)
        x = np.zeros((frames, problem.n))
        band = problem.hessian(
            problem.point(x, np.tile(np.eye(3), (frames, 1, 1)), np.zeros((problem.S, 7)))
        )
        factor = Factor(band, 1e-6, 1e-6)
        triangle = ipopt._Triangle(problem, np.ones(frames * problem.n + problem.border))
        held = [factor.diag, factor.panel] + ([] if factor.border is None else [factor.border])
        sizes.append((band.blocks.size, sum(a.size for a in held), triangle.sparsity.nnz()))
        # Accelerations and smoothness reach two frames: three block diagonals, whatever the length.
        assert band.blocks.shape == (frames, 3, problem.n, problem.n)
    steps = np.diff(sizes, axis=0)
    assert (steps[0] > 0).all()
    assert (steps == steps[0]).all()
