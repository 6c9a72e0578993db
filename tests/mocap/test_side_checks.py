"""Exchanged sides: named when they are, and people who move unusually are not accused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people import clip, worn

from mocap import limb_levels, side_checks
from mocap import orientation as ori
from mocap import sensors as places
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.static_pose import average, find_static
from poser.motions import builtin, walk
from poser.staging import with_static_pose

ARMS = ("left_upper_arm", "right_upper_arm", "pelvis")


def exchanged(raw: RawRecording, kinds: tuple[str, ...]) -> RawRecording:
    sides = (("left", "right"), ("right", "left"))
    return raw.renamed({f"{a}_{k}": f"{b}_{k}" for k in kinds for a, b in sides})


def named(raw: RawRecording, pose: str = "n", facing: float = 0.0) -> set[str | None]:
    """What both checks say of sensors whose facing is known."""
    static = average(raw, find_static(raw, 1.5))
    phi, sigma = np.full(len(raw.sensors), facing), np.full(len(raw.sensors), 0.1)
    found = side_checks.check_sides(raw, static, phi, pose)
    found += side_checks.check_pairs(raw, static, phi, sigma, pose, set())
    return {f.sensor for f in found}


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
    """-1.3 names forearms that are alone, not those of a suit whose other levels agree; -1.6 does."""
    raw = worn(builtin(60.0, 22.6), places.SUIT, "realistic")
    monkeypatch.setattr(side_checks, "side_score", lambda raw, pose, facing, kind: -1.3)
    assert named(raw) == set()
    assert {"left_forearm", "right_forearm"} <= named(raw.select(places.SIX))
    monkeypatch.setattr(side_checks, "side_score", lambda raw, pose, facing, kind: -1.6)
    assert {"left_forearm", "right_forearm"} == named(raw)


@pytest.mark.parametrize("name", ["14_31", "14_07", "salsa_22", "14_37", "02_05", "indian_04"])
def test_other_people_are_not_accused(name: str) -> None:
    """14_31 raises the upper arms turned outward, 14_07 holds the forearms outward, 14_37 is short."""
    motion = clip(name)
    facing = float(ori.heading(motion.R_world_joint[0, 0]))
    for noise in ("none", "realistic"):
        raw = worn(motion, places.SUIT, noise)
        assert named(raw, facing=facing) == set(), noise
        assert named(raw.select(places.SIX), facing=facing) == set(), noise
