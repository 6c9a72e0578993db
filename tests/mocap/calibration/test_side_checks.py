"""Exchanged sides: named when they are, and people who move unusually are not accused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import limb_levels
from mocap.calibration.checks import pairs, sides
from mocap.calibration.sides import FLOOR, side_cues, side_score
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.synthesis.motions import builtin, walk
from mocap.synthesis.staging import with_static_pose
from tests.mocap.calibration.people import clip, posed, worn

ARMS = ("left_upper_arm", "right_upper_arm", "pelvis")


def exchanged(raw: RawRecording, kinds: tuple[str, ...]) -> RawRecording:
    sides = (("left", "right"), ("right", "left"))
    return raw.renamed({f"{a}_{k}": f"{b}_{k}" for k in kinds for a, b in sides})


def named(raw: RawRecording, pose: str = "n", facing: float = 0.0) -> set[str | None]:
    """What both checks say of sensors whose facing is known."""
    evidence = posed(raw, pose, facing=facing)
    return {f.sensor for f in sides.check(evidence) + pairs.check(evidence)}


def with_arms_turned_out(seconds: float) -> Motion:
    """Walking, then both arms raised forward by 80 deg and turned outward by 70, which carries up outward."""
    motion = with_static_pose(walk(10.0), "n", 3.0)
    n = round(seconds * motion.rate_hz)
    raised = ori.rot_x(np.radians(-80))
    R = np.array(motion.R_parent_joint)
    R[-n:] = R[0]
    for joint, sign in ((16, 1.0), (17, -1.0)):
        R[-n:, joint] = raised @ ori.rot_y(np.radians(sign * 70)) @ R[0, joint]
    return replace(motion, R_parent_joint=R)


@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_arms_on_the_wrong_side_of_the_body_are_named(noise: str) -> None:
    """The programme raises both arms sideways for some seconds."""
    raw = worn(builtin(60.0, 22.6), places.SUIT, noise)
    assert named(raw.select(ARMS)) == set()
    assert named(exchanged(raw.select(ARMS), ("upper_arm",))) == set(ARMS[:2])


def test_arms_turned_outward_for_a_moment_are_not_exchanged() -> None:
    raw = worn(with_arms_turned_out(1.5), ARMS)
    assert named(raw) == set()
    # Nothing but their length tells the two: for longer it is more likely an exchange.
    assert named(worn(with_arms_turned_out(4.0), ARMS)) == set(ARMS[:2])
    # An own heading is told by the swing, and may be the opposite.
    assert named(replace(worn(with_arms_turned_out(4.0), ARMS), common_heading=False)) == set()


def test_levels_that_agree_are_on_the_same_sides() -> None:
    raw = worn(builtin(60.0, 22.6), places.SUIT, "realistic")
    for kind in ("upper_arm", "forearm", "hand", "thigh", "shank"):
        joints, _ = places.joints_and_seats(raw.sensors)
        assert limb_levels.agrees(raw, joints, kind)
    one = exchanged(raw, ("forearm",))
    assert not limb_levels.agrees(one, places.joints_and_seats(one.sensors)[0], "forearm")
    six = raw.select(places.SIX)
    assert not limb_levels.agrees(six, places.joints_and_seats(six.sensors)[0], "forearm")


def test_a_whole_limb_takes_a_clearer_score(monkeypatch: pytest.MonkeyPatch) -> None:
    """-1.3 names pairs that are alone, not those of a suit whose other levels agree; -1.6 does."""
    raw = worn(builtin(60.0, 22.6), places.SUIT, "realistic")
    monkeypatch.setattr(pairs, "side_score", lambda *_: -1.3)
    assert named(raw) == set()
    both = {f"{side}_{kind}" for side in ("left", "right") for kind in ("forearm", "shank")}
    assert named(raw.select(places.SIX)) == both
    monkeypatch.setattr(pairs, "side_score", lambda *_: -1.6)
    assert named(raw) == both


@pytest.mark.parametrize("name", ["14_31", "14_07", "salsa_22", "14_37", "02_05", "indian_04"])
def test_other_people_are_not_accused(name: str) -> None:
    """14_31 raises the upper arms turned outward, 14_07 holds the forearms outward, 14_37 is short."""
    motion = clip(name)
    facing = float(ori.heading(motion.R_world_joint[0, 0]))
    for noise in ("none", "realistic"):
        raw = worn(motion, places.SUIT, noise)
        assert named(raw, facing=facing) == set(), noise
        assert named(raw.select(places.SIX), facing=facing) == set(), noise


def score(raw: RawRecording, kind: str, facing: float = 0.0, sigma: float = 0.1) -> float:
    """The side score of sensors whose facing is known to sigma, rad."""
    pose = posed(raw, facing=facing, sigma=sigma).pose
    return side_score(raw, pose.static, pose.facing, pose.sigma, kind)


@pytest.mark.parametrize("kind", ["shank", "forearm"])
def test_an_exchange_changes_the_sign_of_the_score(kind: str) -> None:
    raw = worn(builtin(60.0, 22.6), places.SIX, "realistic")
    assert score(raw, kind) > 1.0
    np.testing.assert_allclose(score(exchanged(raw, (kind,)), kind), -score(raw, kind), atol=1e-9)


def test_forearms_need_no_facing_and_do_not_accuse_where_it_is_opposite() -> None:
    raw = worn(builtin(60.0, 22.6), places.SIX, "realistic")
    assert score(raw, "shank", sigma=np.pi) == 0.0
    assert score(raw, "forearm", sigma=np.pi) > 1.0
    np.testing.assert_allclose(
        score(raw, "forearm", sigma=np.pi),
        score(raw, "forearm", facing=2.0, sigma=np.pi),
        atol=0.05,
    )
    assert score(raw, "forearm", facing=np.pi) >= 0.0  # tilt says one side, habits the other


def test_the_side_to_which_up_tilts_is_independent_of_what_the_pelvis_does() -> None:
    """`tilt` is +-(mean over spread) of sin(angle) of arms raised sideways by that angle, whoever turns."""
    t = np.linspace(0.0, 2 * np.pi, 400)
    angle = 0.6 * (1 - np.cos(t))
    turned = ori.rot_y(3.0 * np.sin(t))
    D = np.stack([turned, turned @ ori.rot_z(angle), turned @ ori.rot_z(-angle)], axis=1)
    x = 2 * np.sin(angle)
    cues = side_cues(D, np.zeros((400, 3, 3)), 60.0)
    np.testing.assert_allclose(cues["tilt"], x.mean() / (x.std() + FLOOR), atol=1e-9)
    np.testing.assert_allclose(cues["outward"], 0.0, atol=1e-6)


def test_a_body_that_turns_throws_its_left_side_outward_and_back() -> None:
    """Rigid body, heading a sin(f t), sides 0.2 m apart: acc = dw/dt e_y x r - w^2 r."""
    t = np.arange(1800) / 60.0
    heading = 1.5 * np.sin(2 * np.pi * 0.15 * t)
    w = np.gradient(heading, t)
    left = np.stack([np.cos(heading), np.zeros_like(t), -np.sin(heading)], axis=-1)
    back = -np.stack([np.sin(heading), np.zeros_like(t), np.cos(heading)], axis=-1)
    at = 0.1 * (np.gradient(w, t)[:, None] * back - w[:, None] ** 2 * left)
    acc = np.stack([np.zeros_like(at), at, -at], axis=1)
    D = np.repeat(ori.rot_y(heading)[:, None], 3, axis=1)
    cues = side_cues(D, acc, 60.0)
    assert cues["turning"] > 0.95 and cues["round"] > 0.95
