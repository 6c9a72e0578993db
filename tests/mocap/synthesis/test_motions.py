"""The built-in motion: smooth, on the floor, knees that bend forward, pieces that join."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import Skeleton
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.synthesis import motions
from sip.prior import shipped

PIECES = [motions.stand, motions.walk, motions.squat, motions.arm_raises, motions.jumping_jack]
PIECES += [motions.leg_raise]
TOES = (10, 11)


@pytest.fixture(scope="module")
def builtin() -> Motion:
    return motions.builtin()


def test_the_programme_lasts_as_long_as_it_says(builtin: Motion) -> None:
    assert builtin.seconds == pytest.approx(sum(s for _, s in motions.PROGRAMME), abs=1 / 60)
    assert motions.builtin(50.0, 30.0).seconds == pytest.approx(30.0)


@pytest.mark.parametrize("piece", PIECES, ids=lambda p: p.__name__)
def test_a_piece_begins_and_ends_at_rest_in_the_n_pose(piece: motions.Piece) -> None:
    m = piece(4.0)
    still = motions.stand(1.0)
    # A piece's last frame is one period before the end of its curves.
    for t in (0, -1):
        off = ori.angle_between(m.R_parent_joint[t], still.R_parent_joint[0])
        assert np.rad2deg(off).max() < 0.5
    assert np.abs(np.diff(m.p_world_joint[[0, 1, -2, -1]], axis=0)[[0, 2]]).max() < 1e-3


def test_feet_stay_on_or_above_the_floor(builtin: Motion) -> None:
    height = builtin.p_world_joint[:, list(TOES), 1]
    assert height.min() > 0.015  # the toe joint lies 2 cm above the sole
    assert height.min(axis=1)[:60].max() < 0.03


def test_a_planted_foot_stands_still() -> None:
    m = motions.walk(6.0)
    toes = m.p_world_joint[:, list(TOES)]
    planted = (toes[:-1, :, 1] < 0.0265) & (toes[1:, :, 1] < 0.0265)
    slide = np.linalg.norm(np.diff(toes[:, :, [0, 2]], axis=0), axis=-1)
    assert planted.mean() > 0.4
    assert np.median(slide[planted]) < 1e-9


def test_knees_bend_backward_only_as_knees_do(builtin: Motion) -> None:
    for knee in (4, 5):
        w = ori.log(builtin.R_parent_joint[:, knee])
        assert np.abs(w[:, 1:]).max() < 1e-9
        assert np.rad2deg(w[:, 0].min()) > -1.0


def test_joints_stay_within_the_limits_of_the_prior(builtin: Motion) -> None:
    """Those that the optimizer enforces, for all 69 angles in all frames; they hold the rest pose as well."""
    prior = shipped()
    angles = ori.log(builtin.R_parent_joint[:, 1:]).reshape(len(builtin), 69)
    assert (angles >= prior.lower).all() and (angles <= prior.upper).all()
    assert (prior.lower <= 0).all() and (prior.upper >= 0).all()


def test_left_and_right_are_not_exchanged(builtin: Motion) -> None:
    R = builtin.R_world_joint[:, 0]
    across = np.einsum("tji,tkj->tki", R, builtin.p_world_joint - builtin.p_world_root[:, None])
    assert (across[:, 7, 0] > across[:, 8, 0]).all()
    assert (across[:, 18, 0] > across[:, 19, 0]).all()


def test_it_walks_ahead_and_accelerates_as_people_do(builtin: Motion) -> None:
    p = builtin.p_world_joint
    assert p[-1, 0, 2] - p[0, 0, 2] > 3.0
    acc = np.linalg.norm(np.diff(p, n=2, axis=0), axis=-1) * 60**2
    assert acc.max() < 60.0


def test_another_body_stands_on_the_same_floor() -> None:
    small = motions.builtin(seconds=4.0, skeleton=Skeleton.default(1.5))
    assert 0.015 * 1.5 / 1.8 < small.p_world_joint[:, list(TOES), 1].min() < 0.02


def test_too_short_a_piece_says_so() -> None:
    with pytest.raises(PoserError, match="at least 3 s"):
        motions.walk(1.0)
    with pytest.raises(PoserError, match="positive"):
        motions.builtin(seconds=0.0)
