"""The cues and how they are combined, on cases small enough to see the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import calibrate
from mocap.calibration.facing import (
    Cue,
    ambiguous,
    combine,
    complex_heading,
    heading_off,
    hinge,
    lean,
    wrap,
)
from mocap.calibration.headings import Relative, comparable, distance, limb, solve
from mocap.errors import CalibrationError
from mocap.synthesis.motions import builtin
from tests.mocap.calibration.people import clip, worn


def test_complex_heading_turns_with_the_world() -> None:
    assert complex_heading(np.array([0.0, 5.0, 1.0])) == 1  # forward
    assert complex_heading(np.array([1.0, 5.0, 0.0])) == 1j  # left
    d = np.array([0.3, 0.2, -0.8])
    turned = complex_heading(ori.rot_y(0.6) @ d)
    assert turned == pytest.approx(np.exp(0.6j) * complex_heading(d))


@pytest.mark.parametrize("facing", [-2.5, 0.0, 1.1])
def test_a_knee_that_bends_tells_forward(facing: float) -> None:
    """A shank turning about the left axis by 0 to 60 deg: R = R_x(a), up in its frame R_x(-a) e_y."""
    t = np.arange(0, 10, 0.01)
    a = np.radians(30) * (1 - np.cos(2 * np.pi * t))
    turn = ori.rot_y(facing)
    u = np.gradient(a, t)[:, None] * np.array([1.0, 0, 0]) @ turn.T
    v = ori.rot_x(-a) @ [0, 1.0, 0] @ turn.T
    cue = hinge("left_shank", u, v, 5.0, -1.0)
    assert cue is not None and abs(wrap(cue.heading - facing)) < 1e-6
    thigh = hinge("left_thigh", -u, ori.rot_x(a) @ [0, 1.0, 0] @ turn.T, 5.0, 1.0)
    assert thigh is not None and abs(wrap(thigh.heading - facing)) < 1e-6
    assert hinge("left_shank", 0.01 * u, v, 5.0, -1.0) is None  # it hardly moves


def test_a_trunk_that_bends_tells_forward() -> None:
    a = np.radians(np.linspace(0, 60, 300))
    v = ori.rot_x(-a) @ [0, 1.0, 0] @ ori.rot_y(0.4).T
    cue = lean("sternum", v, 10.0, -1.0, 100.0)
    assert cue is not None and cue.heading == pytest.approx(0.4)
    both = np.concatenate([v, ori.rot_x(a) @ [0, 1.0, 0] @ ori.rot_y(0.4).T])
    assert lean("sternum", both, 10.0, -1.0, 100.0) is None  # as far back as forward


def test_combine_leaves_out_the_one_that_is_turned() -> None:
    """Around pi, where plain means fail, and with one cue the wrong way round."""
    cues = [Cue(n, a, 0.1, "m") for n, a in (("a", 3.1), ("b", -3.1), ("d", np.pi), ("c", 0.0))]
    mean, sigma, kept = combine(cues)
    assert abs(wrap(mean - np.pi)) < 1e-9
    assert [c.sensor for c in kept] == ["a", "b", "d"]
    assert sigma == pytest.approx(0.1 / np.sqrt(3))
    assert combine([cues[0], cues[3]])[1] > np.radians(45)  # one against one
    with pytest.raises(CalibrationError, match="no cue"):
        combine([])


def cues_at(
    *degrees: float, sigma_deg: float = 10.0, method: str = "hinge of the shank"
) -> list[Cue]:
    return [
        Cue(f"s{k}", np.radians(d), np.radians(sigma_deg), method) for k, d in enumerate(degrees)
    ]


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [
        ((10,), True),
        ((0, 10), False),
        ((0, 10, 175), True),
        ((0, 10, 90), False),
        ((0, 5, 5, 5, 5, 180), False),
    ],
)
def test_a_sign_that_rests_on_little_is_ambiguous(
    degrees: tuple[float, ...], expected: bool
) -> None:
    cues = cues_at(*degrees)
    mean, _, kept = combine(cues)
    assert ambiguous(cues, mean, kept) is expected


def test_a_given_facing_is_not_ambiguous() -> None:
    cues = cues_at(10, method="facing as given")
    assert not ambiguous(cues, cues[0].heading, cues)


@pytest.mark.parametrize("off", [60.0, -90.0])
def test_a_sharp_cue_against_all_others_is_a_heading_that_is_off(off: float) -> None:
    cues = cues_at(0, 3, -3, off)
    mean, _, kept = combine(cues)
    ((cue, angle),) = heading_off(cues, mean, kept)
    assert cue is cues[3] and np.degrees(angle) == pytest.approx(off)
    assert heading_off(cues[1:], mean, kept[1:]) == []  # two are not enough
    blunt = [*cues[:3], *cues_at(off, sigma_deg=20.0)]
    assert heading_off(blunt, mean, kept) == []


@pytest.mark.parametrize("sensor", ["right_shank", "right_thigh"])
def test_a_sensor_with_a_heading_of_its_own_in_a_suit_is_named(sensor: str) -> None:
    raw = worn(builtin(60.0, 22.6), places.SUIT)
    assert raw.R_world_sensor is not None
    R = np.array(raw.R_world_sensor)
    s = raw.sensors.index(sensor)
    R[:, s] = ori.rot_y(np.radians(60)) @ R[:, s]
    _, cal = calibrate(replace(raw, R_world_sensor=R), strict=False)
    (said,) = [f for f in cal.diagnostics if f.code == "heading-off"]
    assert said.sensor == sensor and said.value == pytest.approx(60, abs=10)
    assert "heading-off" not in {f.code for f in calibrate(raw)[1].diagnostics}


@pytest.mark.parametrize("name", ["salsa_01", "indian_14", "salsa_16"])
def test_a_facing_that_may_be_opposite_is_not_called_known(name: str) -> None:
    motion = clip(name)
    _, cal = calibrate(worn(motion, places.SIX), at=1.5, strict=False)
    off = wrap(-cal.heading[0] - ori.heading(motion.R_world_joint[0, 0]))
    said = {f.code for f in cal.diagnostics}
    assert abs(off) < np.radians(50) or (
        "facing-ambiguous" in said and cal.heading_sigma[0] == np.pi
    )


def test_solve_spreads_a_cue_along_the_edges() -> None:
    """a - b = 1 and b - c = -2 with a known: b = a - 1, c = b + 2; d has no edge."""
    relatives = [Relative(0, 1, 1.0, 0.1, 0.9), Relative(1, 2, -2.0, 0.1, 0.9)]
    phi, sigma = solve(("a", "b", "c", "d"), [Cue("a", 0.5, 0.1, "m")], relatives)
    assert phi[:3] == pytest.approx([0.5, -0.5, 1.5])
    assert sigma[:3] == pytest.approx(0.1 * np.sqrt([1, 2, 3]))
    assert np.isnan(phi[3]) and sigma[3] == np.pi


def test_solve_outvotes_a_cue_turned_by_half() -> None:
    names = ("a", "b", "c")
    relatives = [Relative(0, 1, 0.0, 0.1, 0.9), Relative(1, 2, 0.0, 0.1, 0.9)]
    cues = [Cue("a", 1.0, 0.1, "m"), Cue("b", 1.0, 0.1, "m"), Cue("c", 1.0 + np.pi, 0.1, "m")]
    phi, _ = solve(names, cues, relatives)
    assert np.abs(wrap(phi - 1.0)).max() < 0.2


def test_limbs_that_swing_against_each_other_are_not_compared() -> None:
    assert [limb(j) for j in (0, 9, 13, 15, 1, 8, 16, 23)] == [
        *["trunk"] * 4, "left_leg", "right_leg", "left_arm", "right_arm",
    ]  # fmt: skip
    assert comparable(0, 4) and comparable(4, 7) and not comparable(4, 5) and not comparable(4, 18)
    assert (distance(4, 7), distance(0, 4), distance(4, 5), distance(9, 9)) == (1, 2, 4, 0)
