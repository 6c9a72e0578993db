"""The root's path: what standing, walking, jumping and the ground say about it."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid import contact
from mocap import Motion, Skeleton
from mocap import orientation as ori
from mocap.synthesis import motions


def follow(
    motion: Motion, acc: np.ndarray | None = None, skeleton: Skeleton | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Path (T,3) m and its deviation (T,3) m by the true pose of every frame."""
    c = contact.Contact(skeleton or motion.skeleton)
    state, p, std = contact.start(), [], []
    for t in range(len(motion)):
        a = np.full(3, np.nan) if acc is None else acc[t]
        state = c.step(
            state, c.soles(motion.R_parent_joint[t]), a, 1 / motion.rate_hz, motion.p_world_root[0]
        )
        p.append(state.p)
        std.append(state.std_m)
    return np.array(p), np.array(std)


def acceleration(motion: Motion) -> np.ndarray:
    p = motion.p_world_root
    acc = np.full_like(p, np.nan)
    acc[1:-1] = (p[:-2] - 2 * p[1:-1] + p[2:]) * motion.rate_hz**2
    return acc


def test_soles_are_the_feet_of_the_tree_and_flat_at_rest() -> None:
    motion = motions.squat(3.0, 20.0)
    c = contact.Contact(motion.skeleton)
    rest = c.soles(np.tile(np.eye(3), (24, 1, 1)))
    assert np.ptp(rest[..., 1]) < 1e-12
    t = 30
    soles = c.soles(motion.R_parent_joint[t])
    joints = motion.p_world_joint[t] - motion.p_world_root[t]
    for k, pair in enumerate(((7, 8), (10, 11))):
        under = soles[k] - joints[list(pair)]
        depth = rest[k, :, 1] - (
            motion.skeleton.rest_positions[list(pair), 1] - motion.skeleton.rest_positions[0, 1]
        )
        down = motion.R_world_joint[t, list(pair), :, 1] * depth[:, None]
        assert np.allclose(under, down)


@pytest.mark.parametrize("with_acc", [True, False])
def test_a_standing_person_stays_and_is_as_high_as_the_legs(with_acc: bool) -> None:
    motion = motions.stand(10.0, 30.0)
    p, std = follow(motion, np.zeros((300, 3)) if with_acc else None)
    assert np.abs(p[:, [0, 2]] - p[0, [0, 2]]).max() < 1e-9
    assert np.abs(p[:, 1] - motion.p_world_root[:, 1]).max() < 0.03
    # The height is held by the ground, the place drifts as a sum of small steps.
    assert std[-1, 1] < 0.02 < std[-1, 0] < 0.3


@pytest.mark.parametrize("with_acc", [True, False])
def test_a_walk_goes_as_far_as_the_feet_say(with_acc: bool) -> None:
    motion = motions.walk(6.0, 60.0)
    p, std = follow(motion, acceleration(motion) if with_acc else None)
    travelled = motion.p_world_root[-1, 2] - motion.p_world_root[0, 2]
    assert travelled > 3
    assert abs((p[-1, 2] - p[0, 2]) / travelled - 1) < 0.15
    assert abs(p[-1, 0] - p[0, 0]) < 0.1
    error = np.abs(p - motion.p_world_root)
    assert error[:, 1].max() < 0.08
    assert std[-1, 2] > std[60, 2] > 0


def test_a_jump_is_flown_on_the_accelerometer() -> None:
    """In the air neither foot holds the body: the path rises with the jump, not stays on the ground."""
    motion = motions.jumping_jack(4.0, 60.0)
    p, _ = follow(motion, acceleration(motion))
    assert np.abs(p[:, 1] - motion.p_world_root[:, 1]).max() < 0.08
    top = motion.p_world_root[:, 1].argmax()
    assert p[top, 1] - p[0, 1] > 0.5 * (motion.p_world_root[top, 1] - motion.p_world_root[0, 1])


def test_turned_about_gravity_turns_the_path() -> None:
    motion = motions.walk(3.0, 30.0)
    acc = acceleration(motion)
    p, _ = follow(motion, acc)
    turned, _ = follow(motion.turned(1.1), acc @ ori.rot_y(1.1).T)
    assert np.allclose(turned, p @ ori.rot_y(1.1).T, atol=1e-9)


def test_ten_minutes_of_standing_with_a_biased_accelerometer() -> None:
    motion = motions.stand(1.0, 10.0)
    c = contact.Contact(motion.skeleton)
    soles, state = c.soles(motion.R_parent_joint[0]), contact.start()
    rng = np.random.default_rng(0)
    for _ in range(3000):
        state = c.step(state, soles, 0.1 + 0.2 * rng.normal(size=3), 0.2, np.zeros(3))
    assert np.abs(state.v).max() < 0.05 and abs(state.p[1] - motion.p_world_root[0, 1]) < 0.05
    pp, pv, vv = state.covariance
    assert np.all(pp > 0) and np.all(pp * vv > pv**2)
