"""Motion drawn at random, free of data: a collection to train on beside motion capture.

Legs stand, squat, step, march, lunge, kick or jump; each arm moves between random places or swings to a
beat; the trunk bends and turns. Everything runs on smooth curves through `posing`, so that feet that
stand do stand. Nobody moves so; it shows a network combinations of arms, legs and trunk that few clips have.
It holds none of the pieces of `mocap.synthesis.motions`, on which the demo measures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.synthesis.posing import (
    ARM_DOWN,
    COLLARS,
    SHOULDERS,
    SIDES,
    WRISTS,
    Score,
    bump,
    pose,
    step,
)

NAME = "generated"
VERSION = "1"  # changes with the motion that a seed gives
COUNT, SECONDS, RATE_HZ = 120, 10.0, 60.0
# The collars of CMU's clips hang so far below SMPL's and never move: beside them, others' would only say
# that the same arm has two answers.
COLLAR_HANG = np.deg2rad(34.0)
_LOWER_M, _TRIES = 0.03, 12  # a pelvis too high for a foot's reach comes down

Draw = Callable[[], float]


def motions(
    count: int | None = None, seconds: float = SECONDS, seed: int = 0
) -> Iterator[tuple[str, Motion]]:
    """Name and motion of `count` clips (default: `COUNT`) at `RATE_HZ`; the same for the same seed, whatever
    the count."""
    for k in range(COUNT if count is None else count):
        yield f"{NAME} {seed}-{k}", motion(seconds, np.random.default_rng([seed, k]))


def motion(seconds: float, rng: np.random.Generator) -> Motion:
    """One clip of a stance, a way of moving the legs, of the trunk and of each arm."""
    s = Score.blank(seconds, RATE_HZ)
    _stance(s, rng)
    LEGS[rng.choice(len(LEGS), p=_SHARES)](s, rng)
    _trunk(s, rng)
    twist, wrist = _arms(s, rng)
    made = _reaching(s)
    R = np.array(made.R_parent_joint)
    for side, sign in enumerate(SIDES):
        hang = ori.rot_z(np.full(len(s.t), -sign * COLLAR_HANG))
        down = R[:, COLLARS[side]] @ R[:, SHOULDERS[side]]
        R[:, COLLARS[side]] = hang
        R[:, SHOULDERS[side]] = np.swapaxes(hang, -1, -2) @ down @ ori.rot_x(twist[:, side])
        R[:, WRISTS[side]] = ori.rot_x(wrist[:, side])
    return Motion(RATE_HZ, R, made.p_world_root, made.skeleton)


def _reaching(s: Score) -> Motion:
    """The motion of a score, its pelvis as low as both feet need it."""
    for _ in range(_TRIES):
        try:
            return pose(s)
        except PoserError:
            s.pelvis[:, 1] -= _LOWER_M
    return pose(s)


def levels(
    rng: np.random.Generator, t: Array, draw: Draw, moving_s: tuple[float, float], rest_s: float
) -> Array:
    """A curve (T,) between drawn levels: smooth moves of `moving_s` (shortest, longest), rests of `rest_s`
    on average between them."""
    level = draw()
    x, at = np.full(len(t), level), rng.exponential(rest_s)
    while at < t[-1]:
        duration, next_level = rng.uniform(*moving_s), draw()
        x += (next_level - level) * step((t - at) / duration)
        level, at = next_level, at + duration + rng.exponential(rest_s)
    return x


def gauss(rng: np.random.Generator, size: float) -> Draw:
    """Draws of mean zero."""
    return lambda: float(rng.normal(0, size))


def beat(rng: np.random.Generator, t: Array, hz: float, size: float, phase: float) -> Array:
    """A sine (T,) whose size comes and goes."""
    on: Array = levels(rng, t, lambda: rng.uniform(0.3, 1.0), (1.0, 3.0), 1.0)
    return size * on * np.sin(2 * np.pi * hz * t + phase)


# -- legs ---------------------------------------------------------------------------------------------


def _stance(s: Score, rng: np.random.Generator) -> None:
    """Feet apart and one before the other, knees a little bent, weight that shifts slowly."""
    for foot, sign in enumerate(SIDES):
        s.toes[:, foot, 0] += sign * max(-0.03, rng.normal(0.03, 0.05))
    stagger = rng.normal(0, 0.08)
    s.toes[:, 0, 2] += stagger
    s.toes[:, 1, 2] -= stagger
    s.pelvis[:, 1] -= rng.uniform(0.01, 0.06)
    for axis, size in ((0, 0.03), (2, 0.02)):
        s.pelvis[:, axis] += levels(rng, s.t, gauss(rng, size), (0.6, 2.0), 1.0)


def _stand(s: Score, rng: np.random.Generator) -> None:
    """As the stance is."""


def _squat(s: Score, rng: np.random.Generator) -> None:
    """Down by up to 45 cm and up again, as deep as to sit."""
    down = levels(rng, s.t, lambda: rng.choice([0.0, rng.uniform(0.05, 0.45)]), (0.5, 1.8), 0.6)
    s.pelvis[:, 1] -= down
    s.pelvis[:, 2] -= rng.uniform(0.2, 0.6) * down
    s.turn[:, 0] += rng.uniform(0.3, 1.4) * down
    s.bend[:, 0] += rng.uniform(-0.3, 1.2) * down


def _steps(s: Score, rng: np.random.Generator) -> None:
    """Steps to any side, one foot after the other, the pelvis between them."""
    first = s.toes[0].copy()
    place, at, foot = first.copy(), rng.uniform(0, 0.5), int(rng.integers(2))
    while at < s.t[-1]:
        air = rng.uniform(0.3, 0.6)
        # Side by side again most of the time, or the feet would wander off each other.
        far = place[1 - foot] + first[foot] - first[1 - foot] + rng.normal(0, (0.15, 0.0, 0.25))
        on = step((s.t - at) / air)[:, None]
        s.toes[:, foot] += (far - place[foot]) * on
        s.pelvis += 0.5 * (far - place[foot]) * step((s.t - at + 0.15) / (air + 0.3))[:, None]
        _swing(s, foot, at, air, rng.uniform(0.04, 0.15), 25)
        place[foot] = far
        foot, at = 1 - foot, at + air + rng.exponential(0.4)


def _march(s: Score, rng: np.random.Generator) -> None:
    """On the spot, knees low or high."""
    period, height = rng.uniform(0.35, 0.9), rng.uniform(0.06, 0.45)
    forward = rng.uniform(-0.3, 0.6) * height
    for k in range(int(s.t[-1] / period)):
        foot, at = k % 2, k * period
        s.toes[:, foot, 2] += forward * bump((s.t - at) / (0.95 * period))
        _swing(s, foot, at, 0.95 * period, height, 20)
    s.pelvis[:, 0] += 0.03 * np.sin(np.pi * s.t / period)
    s.pelvis[:, 1] += rng.uniform(0, 0.03) * np.cos(2 * np.pi * s.t / period)


def _lunge(s: Score, rng: np.random.Generator) -> None:
    """Now and then one foot goes far forward or to its side, the pelvis half the way and down."""
    at = rng.uniform(0, 1.0)
    while at < s.t[-1] - 2.5:
        foot, there = int(rng.integers(2)), rng.uniform(0.5, 1.0)
        way = np.array([0.0, 0.0, rng.uniform(0.3, 0.65)])
        if rng.uniform() < 0.4:
            way = np.array([SIDES[foot] * rng.uniform(0.25, 0.5), 0.0, 0.0])
        stay = rng.uniform(0.8, 2.0)
        on = step((s.t - at) / there) * step((at + there + stay - s.t) / there)
        s.toes[:, foot] += way * on[:, None]
        s.pelvis += way * 0.5 * on[:, None]
        s.pelvis[:, 1] -= rng.uniform(0.1, 0.3) * on
        s.heel[:, 1 - foot] += np.deg2rad(rng.uniform(10, 45)) * on
        s.toes[:, foot, 1] += 0.06 * (bump((s.t - at) / there) + bump((s.t - at - stay) / there))
        at += there + stay + rng.uniform(0.3, 1.5)


def _kick(s: Score, rng: np.random.Generator) -> None:
    """One leg swings to the front, the side or the back while the other stands."""
    at = rng.uniform(0, 1.0)
    while at < s.t[-1] - 1.0:
        foot, long = int(rng.integers(2)), rng.uniform(0.6, 1.6)
        sign = SIDES[foot]
        up = bump((s.t - at) / long)
        way = rng.choice(3, p=(0.5, 0.25, 0.25))
        size = rng.uniform(0.3, 0.9)
        far = np.array([(0, 0.35, 0.55), (sign * 0.45, 0.35, 0), (0, 0.25, -0.45)][way]) * size
        s.toes[:, foot] += far * up[:, None]
        s.heel[:, foot] += np.deg2rad((-20, 0, 60)[way]) * size * up
        s.pelvis[:, 0] -= sign * 0.08 * bump((s.t - at + 0.3) / (long + 0.6))
        s.turn[:, 0] += np.deg2rad((-10, 0, 20)[way]) * size * up
        at += long + rng.uniform(0.3, 1.5)


def _jump(s: Score, rng: np.random.Generator) -> None:
    """Jumps with both feet, a crouch before and after."""
    at = rng.uniform(0, 0.8)
    while at < s.t[-1] - 1.5:
        air, crouch = rng.uniform(0.3, 0.5), rng.uniform(0.08, 0.25)
        height = 9.81 * air**2 / 8
        x = np.clip((s.t - at - 0.45) / air, 0, 1)
        flight = 4 * height * x * (1 - x)
        s.pelvis[:, 1] += flight - crouch * (
            bump((s.t - at) / 0.55) + bump((s.t - at - 0.4 - air) / 0.6)
        )
        s.toes[:, :, 1] += flight[:, None]
        s.heel += np.deg2rad(30) * bump((s.t - at - 0.35) / (air + 0.15))[:, None]
        at += 1.1 + air + rng.exponential(0.5)


def _swing(s: Score, foot: int, at: float, air: float, height: float, heel_deg: float) -> None:
    s.toes[:, foot, 1] += height * bump((s.t - at) / air)
    s.heel[:, foot] += np.deg2rad(heel_deg) * bump((s.t - at + 0.15) / (air + 0.15))


LEGS: tuple[Callable[[Score, np.random.Generator], None], ...] = (
    _stand, _squat, _steps, _march, _lunge, _kick, _jump,
)  # fmt: skip
_SHARES = (0.2, 0.16, 0.2, 0.16, 0.1, 0.1, 0.08)


# -- trunk and arms -----------------------------------------------------------------------------------


def _trunk(s: Score, rng: np.random.Generator) -> None:
    """Bends (forward more than back), turns and leans; now and then to a beat."""
    lively = rng.choice([0.4, 1.0, 2.0])
    sizes = np.deg2rad((14, 14, 7)) * lively
    for axis, size in enumerate(sizes):
        s.bend[:, axis] += levels(rng, s.t, gauss(rng, size), (0.4, 1.8), 0.8)
        s.turn[:, axis] += levels(rng, s.t, gauss(rng, 0.3 * size), (0.5, 2.0), 0.8)
    s.bend[:, 0] += np.abs(levels(rng, s.t, gauss(rng, sizes[0]), (0.5, 2.0), 1.0))
    if rng.uniform() < 0.3:
        s.bend[:, 1] += beat(rng, s.t, rng.uniform(0.5, 1.6), np.deg2rad(15), rng.uniform(0, 6.3))
    s.nod += levels(rng, s.t, gauss(rng, 0.25), (0.4, 1.2), 1.0)


def _arms(s: Score, rng: np.random.Generator) -> tuple[Array, Array]:
    """Raised, forward and elbow of the score; the upper arms' twist and the wrists' turn (T,2), rad.

    Both arms do the same, the same in turn, or each its own.
    """
    together = rng.choice(["alike", "in turn", "apart"])
    own = [_arm(s.t, rng) for _ in range(2)]
    beats = [_beats(s.t, rng, 0.0)] * 2
    if together != "apart":
        own[1] = own[0]
        state = rng.bit_generator.state
        for side, phase in enumerate((0.0, np.pi if together == "in turn" else 0.0)):
            rng.bit_generator.state = state
            beats[side] = _beats(s.t, rng, phase)
    elif rng.uniform() < 0.5:
        beats[1] = _beats(s.t, rng, rng.uniform(0, 2 * np.pi))
    raised, forward, elbow, twist, wrist = (
        np.stack([own[0][k] + beats[0][k], own[1][k] + beats[1][k]], axis=1) for k in range(5)
    )
    s.raised += np.clip(raised, np.deg2rad(-8), np.deg2rad(165))
    s.forward += np.clip(forward, np.deg2rad(-50), np.deg2rad(170))
    s.elbow += np.clip(elbow, np.deg2rad(3), np.deg2rad(145))
    sign = np.array(SIDES)
    # Of an arm that hangs, the twist would turn the forearm behind the back.
    low = np.clip(raised / ARM_DOWN, 0, 1)
    return sign * np.clip(twist, -1.2, 1.2) * (0.4 + 0.6 * low), sign * np.clip(wrist, -1.4, 1.4)


def _arm(t: Array, rng: np.random.Generator) -> list[Array]:
    """Places of one arm: hanging most of the time, else anywhere."""
    busy = rng.choice([0.15, 0.5, 0.85])
    pace = rng.choice([0.35, 0.7, 1.2])

    def between(low: float, high: float, rest: float) -> Draw:
        def draw() -> float:
            x = rng.uniform(low, high) if rng.uniform() < busy else rest + rng.normal(0, 6)
            return float(np.deg2rad(x))

        return draw

    ranges = ((0, 150, 4), (-30, 130, 0), (5, 140, 18), (-60, 60, 0), (-60, 60, 0))
    rest_s = rng.uniform(0.2, 1.2)
    return [levels(rng, t, between(*r), (pace * 0.7, pace * 1.6), rest_s) for r in ranges]


def _beats(t: Array, rng: np.random.Generator, phase: float) -> list[Array]:
    """Swings, waves and circles of one arm, or none."""
    sizes, hz = np.zeros(5), rng.uniform(0.5, 2.2)
    if rng.uniform() < 0.55:
        kinds = (
            (0, 35, 6, 0, 0),
            (30, 0, 10, 0, 0),
            (20, 20, 0, 0, 0),
            (0, 0, 35, 0, 10),
            (0, 10, 10, 30, 0),
        )
        sizes = np.deg2rad(kinds[rng.integers(len(kinds))]) * rng.uniform(0.3, 1.4)
    lag = rng.uniform(0, 2 * np.pi, 5)
    return [beat(rng, t, hz, size, phase + part) for size, part in zip(sizes, lag, strict=True)]
