"""Motion drawn at random: repeatable, varied, and of a body that could move so."""

from __future__ import annotations

import numpy as np
import pytest

from learned.training import corpus
from mocap import faults
from mocap import orientation as ori
from mocap.synthesis import generated
from mocap.synthesis.posing import ANKLES, COLLARS, ELBOWS, KNEES, WRISTS

CLIPS = dict(generated.motions(20))
NAMES = list(CLIPS)


def test_a_seed_and_a_place_give_a_clip() -> None:
    """Whatever the count; another place or seed gives another."""
    again = dict(generated.motions(3))
    assert list(again) == NAMES[:3] and len(set(NAMES)) == 20
    for name, motion in again.items():
        assert np.array_equal(motion.R_parent_joint, CLIPS[name].R_parent_joint)
    others = [CLIPS[NAMES[1]], *dict(generated.motions(1, seed=1)).values()]
    for other in others:
        off = np.abs(other.R_parent_joint - CLIPS[NAMES[0]].R_parent_joint)
        assert off.max() > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_a_body_could_move_so(name: str) -> None:
    motion = corpus.prepared(CLIPS[name])
    R, p = motion.R_parent_joint, motion.p_world_joint
    assert len(motion) == 600 and motion.rate_hz == generated.RATE_HZ
    np.testing.assert_allclose(
        R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9
    )
    assert p[..., 1].min() > -0.02  # nothing sinks into the floor
    assert p[:, 15, 1].min() > 0.5  # the head stays well over it
    flexed = ori.log(R)
    for k, joint in enumerate(KNEES):
        assert flexed[:, joint, 0].min() > -0.01 and flexed[:, joint, 0].max() < np.deg2rad(150)
        assert ori.angle(R[:, ELBOWS[k]]).max() < np.deg2rad(150)
        assert ori.angle(R[:, ANKLES[k]]).max() < np.deg2rad(faults.BEYOND_DEG["left_ankle"])
        hang = ori.angle(R[:, COLLARS[k]])
        np.testing.assert_allclose(hang, generated.COLLAR_HANG, atol=1e-6)
    # A person's: CMU's fastest hands are at 100 to 150 m/s^2.
    acc = np.diff(p[:, WRISTS], n=2, axis=0) * motion.rate_hz**2
    assert 1.0 < np.linalg.norm(acc, axis=-1).max() < 150.0


def test_a_standing_foot_stands() -> None:
    """Somewhere in nearly every clip, and never do both slide at once but in the air."""
    standing = []
    for motion in CLIPS.values():
        toes = motion.p_world_joint[:, [10, 11]]
        speed = np.linalg.norm(np.diff(toes, axis=0), axis=-1) * motion.rate_hz
        low = toes[1:, :, 1].min(axis=1) < 0.03
        slides = (speed.min(axis=1) > 0.05) & low
        standing.append((speed < 0.01).any(axis=1).mean())
        assert slides.mean() < 0.1
    assert np.median(standing) > 0.6


def test_clips_differ_in_arms_legs_and_trunk() -> None:
    """Over clips the arms reach over the head and hang, knees bend deeply, the trunk bows and turns."""
    wrists = np.concatenate(
        [m.p_world_joint[:, 20, 1] - m.p_world_joint[:, 15, 1] for m in CLIPS.values()]
    )
    knees = np.concatenate([ori.angle(m.R_parent_joint[:, KNEES[0]]) for m in CLIPS.values()])
    spine = np.concatenate([ori.angle(m.R_parent_joint[:, 3]) for m in CLIPS.values()])
    assert wrists.min() < -0.6 and wrists.max() > 0.1
    assert np.rad2deg(knees).min() < 15 and np.rad2deg(knees).max() > 80
    assert np.rad2deg(spine).max() > 15
