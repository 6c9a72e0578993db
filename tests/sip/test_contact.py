"""Feet that stand: derivatives of the term, what counts as standing, and the path that follows from it."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import Skeleton, sensors, synthesis
from mocap import orientation as ori
from mocap.synthesis.motions import walk
from sip import Settings, initial, solve
from sip.problem import build
from sip.soles import Soles, standing
from sip.solvers.band import Band
from sip.terms.contact import Contact
from tests.sip.conftest import wavy

FEET = (*sensors.SIX, "left_foot")


@pytest.mark.parametrize("names", [sensors.SIX, FEET], ids=["shanks", "a foot"])
def test_derivatives(rng: np.random.Generator, names: tuple[str, ...]) -> None:
    recording = synthesis.recording(wavy(7), names)
    problem = build(recording, Skeleton.default(), Settings())
    soles = Soles(Skeleton.default(), problem.model.kinematics.active, problem.prior)
    term = Contact(soles, rng.uniform(0, 1, (6, 4)), 0.1, 60.0)
    x, R_ref = initial.from_motion(wavy(7), problem.prior)
    point = problem.point(x + rng.normal(size=x.shape) * 0.2, R_ref, np.zeros((problem.S, 7)))
    grad, band = np.zeros_like(x), Band.zeros(7, 1, problem.n)
    term.pullback(point, term.residual(point), grad, np.zeros((problem.S, 7)))
    term.hessian(point, band)
    h = 1e-6
    for _ in range(3):
        dx = rng.normal(size=x.shape)
        ends = [problem.point(point.x + s * dx, R_ref, point.u) for s in (-h, h)]
        r = [term.residual(end) for end in ends]
        change = (term.loss(r[1]) - term.loss(r[0])) / (2 * h)
        assert np.vdot(grad, dx) == pytest.approx(change, rel=1e-6)
        square = float((((r[1] - r[0]) / (2 * h)) ** 2).sum())
        assert np.vdot(dx, band.dot(dx, np.zeros(0))[0]) == pytest.approx(square, rel=1e-6)


def test_soles_of_a_standing_body_are_under_its_joints() -> None:
    skeleton = Skeleton.default()
    joint, _ = sensors.joints_and_seats((*sensors.SIX, "left_foot", "right_foot"))
    active = tuple(sorted({j for s in joint for j in skeleton.ancestors(int(s))} - {0}))
    problem = build(synthesis.recording(wavy(3), FEET), skeleton, Settings())
    soles = Soles(skeleton, active, problem.model.settings.prior.given(active, 0.05))
    rest = skeleton.rest_positions
    x = np.zeros((1, soles.n))
    x[0, :3] = rest[0]
    q = soles.places(x, np.eye(3)[None])[0]
    assert np.allclose(q[:, 1], rest[[10, 11], 1].min() - skeleton.sole)
    for k, j in enumerate((7, 10, 8, 11)):
        assert np.allclose(q[k, [0, 2]], rest[j, [0, 2]])


def test_low_and_slow_stands_high_or_fast_or_falling_does_not() -> None:
    T, rate = 30, 60.0
    still = np.zeros((T, 6))
    q = np.zeros((T, 4, 3))
    q[:, 1, 1] = 0.2  # high
    q[:, 2, 0] = np.arange(T) / rate * 2.0  # fast
    w = standing(q, still, rate, 0.04, 0.2)
    assert w[:, [0, 3]].min() > 0.99
    assert w[:, [1, 2]].max() < 1e-3
    fall = still.copy()
    fall[:, 1] = -0.5 * ori.GRAVITY * (np.arange(T) / rate) ** 2
    assert standing(np.zeros((T, 4, 3)), fall, rate, 0.04, 0.2).max() < 1e-6


def test_the_path_of_a_walk_is_found_by_its_feet() -> None:
    recording = synthesis.recording(walk(4.0), sensors.SIX, synthesis.Noise(), 1)
    truth = recording.reference
    assert truth is not None
    far = {}
    for sigma in (0.3, np.inf):
        found = solve(recording, settings=Settings(solver="banded", sigma_contact=sigma)).motion
        moved = [m.p_world_root[-20] - m.p_world_root[20] for m in (found, truth)]
        far[sigma] = float(np.linalg.norm(moved[0] - moved[1]))
    assert far[0.3] < 0.35
    assert far[0.3] < far[np.inf] / 3
