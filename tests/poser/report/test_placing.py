"""Where skeletons are drawn beside the reference."""

from __future__ import annotations

import numpy as np

from mocap.synthesis import motions
from poser.report.placing import beside


def test_bodies_stand_on_the_references_floor() -> None:
    squat = motions.squat(2.0).p_world_joint
    standing = np.tile(squat[0] + [3.0, -0.7, 1.0], (len(squat), 1, 1))
    moved = beside(standing, squat)
    np.testing.assert_allclose(moved[..., 1].min(axis=1), squat[..., 1].min(axis=1), atol=1e-12)
    np.testing.assert_allclose(moved[:, 0, [0, 2]], squat[:, 0, [0, 2]], atol=1e-12)
    # A shift alone: the bones are the same.
    np.testing.assert_allclose(np.diff(moved, axis=1), np.diff(standing, axis=1), atol=1e-12)


def test_a_body_that_is_right_lies_on_the_reference() -> None:
    walk = motions.walk(3.0).p_world_joint
    np.testing.assert_allclose(beside(walk - [0.2, 0.4, 0.1], walk), walk, atol=1e-12)
