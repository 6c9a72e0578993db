"""Simulated owners move through the device combinations of IMUPoser's study: signals, and the truth.

The paper asked seven people for 15 combinations of a phone (absent, in a pocket, in a hand), a watch on
the left wrist and earbuds, in random order; which 15 is in a picture only. With one watch arm these
devices can occupy exactly 15 different sets of body points (a watch and a phone on one arm are one
point), which are taken here. In each trial the owner walks, squats and stands; in between, devices are
handed over or put on a table. Nothing here is measured on a person.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from mocap import orientation as ori
from mocap import seats
from mocap import sensors as places
from mocap.motion import Motion
from mocap.synthesis import motions
from poser.live.devices import DEVICES, EARBUDS, PHONE, WATCH, Preferences, Seen, State, step

RATE_HZ = 25.0
HAND_OVER_S = 4.0
DISTANCE_SIGMA_M = 0.1  # ranging by radio, 1 sigma
DARK_SHARE = 0.1  # of the time in the hand in which the screen has gone dark
HELD = np.deg2rad(80.0)  # the elbow of a hand that holds a phone
WATCH_PLACE = "left_wrist"
PHONE_PLACES = ("left_pocket", "right_pocket", "left_wrist", "right_wrist")


@dataclass(frozen=True)
class Combination:
    """Where the devices are; None: on the table."""

    phone: str | None
    watch: bool
    earbuds: bool

    @property
    def truth(self) -> dict[str, str]:
        """Place by device."""
        worn = {PHONE: self.phone, WATCH: WATCH_PLACE if self.watch else None,
                EARBUDS: "head" if self.earbuds else None}  # fmt: skip
        return {k: v for k, v in worn.items() if v is not None}

    def decidable(self, owner: Preferences) -> bool:
        """Whether anything tells the phone's side: a worn watch, or that it is the preferred one."""
        usual = (f"{owner.pocket}_pocket", f"{owner.hand}_wrist")
        return self.phone is None or self.watch or self.phone in usual


def combinations() -> tuple[Combination, ...]:
    """One combination for each of the 15 sets of body points."""
    found: dict[frozenset[str], Combination] = {}
    for phone in (None, *PHONE_PLACES):
        for watch in (False, True):
            for earbuds in (False, True):
                c = Combination(phone, watch, earbuds)
                if c.truth:
                    found.setdefault(frozenset(c.truth.values()), c)
    return tuple(found.values())


@dataclass(frozen=True)
class Moment:
    """What is seen at one time. trial: the combination, None while devices are handed over."""

    time_s: float
    seen: dict[str, Seen]
    trial: Combination | None


def owner_of(rng: np.random.Generator) -> Preferences:
    """Right-handed, the watch on the left, as in the study; the pocket as drawn."""
    return Preferences("left" if rng.uniform() < 0.5 else "right", "right", "left")


def session(
    rng: np.random.Generator, order: tuple[Combination, ...] | None = None
) -> Iterator[Moment]:
    """Combinations in random order (default: the study's)."""
    dt, time_s = 1.0 / RATE_HZ, 0.0
    order = order or combinations()
    for i in rng.permutation(len(order)):
        frames = round(HAND_OVER_S * RATE_HZ)
        for k in range(frames):
            time_s += dt
            # Handled first; then all is in place, and the owner waits for the trial to begin.
            seen = (
                _handed_over(order[i])
                if k < frames / 2
                else _worn(order[i], float(_distance(order[i].phone)[0]), False, rng)
            )
            yield Moment(time_s, seen, None)
        distance = _distance(order[i].phone)
        dark = _dark(len(distance), rng)
        for metres, is_dark in zip(distance, dark, strict=True):
            time_s += dt
            yield Moment(time_s, _worn(order[i], float(metres), bool(is_dark), rng), order[i])


@lru_cache(maxsize=8)
def _distance(phone: str | None) -> np.ndarray:
    """Watch to phone in m over one trial."""
    motion = motions.joined([motions.walk(10.0, RATE_HZ), motions.squat(3.0, RATE_HZ),
                             motions.stand(2.0, RATE_HZ)])  # fmt: skip
    if phone is None:
        return np.full(len(motion), 2.0)
    motion = _holding(motion, phone)
    seat = phone.replace("wrist", "hand")
    joint, placement = places.joints_and_seats((WATCH_PLACE, seat))
    p = seats.sensor_positions(motion, joint, placement)
    return np.asarray(np.linalg.norm(p[:, 1] - p[:, 0], axis=1))


def _holding(motion: Motion, phone: str) -> Motion:
    """The motion with the elbow bent whose hand holds the phone."""
    R = np.array(motion.R_parent_joint)
    if phone == "left_wrist":
        R[:, 18] = ori.rot_y(-HELD)
    elif phone == "right_wrist":
        R[:, 19] = ori.rot_y(HELD)
    return replace(motion, R_parent_joint=R)


def _dark(frames: int, rng: np.random.Generator) -> np.ndarray:
    """When a held phone's screen is dark: spells of 2 s."""
    starts = rng.uniform(size=frames) < DARK_SHARE / (2.0 * RATE_HZ)
    return np.convolve(starts, np.ones(round(2.0 * RATE_HZ)))[:frames] > 0


def _worn(c: Combination, metres: float, dark: bool, rng: np.random.Generator) -> dict[str, Seen]:
    measured = abs(metres + DISTANCE_SIGMA_M * rng.normal())
    in_hand = c.phone is not None and c.phone.endswith("wrist")
    phone = Seen(
        connected=True,  # it relays the others, worn or not
        moving=c.phone is not None,
        screen=in_hand and not dark,
        proximity=c.phone is not None and not in_hand,
        to_watch_m=measured,
    )
    return {PHONE: phone, WATCH: Seen(True, c.watch), EARBUDS: Seen(c.earbuds, c.earbuds)}


def _handed_over(c: Combination) -> dict[str, Seen]:
    """Every device is moved by somebody's hands, its screen dark."""
    phone = Seen(True, moving=True, screen=False, proximity=False, to_watch_m=1.0)
    return {PHONE: phone, WATCH: Seen(True, moving=True), EARBUDS: Seen(c.earbuds, c.earbuds)}


def accuracy(owners: int, seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """Share of moments in trials at which each device is placed right, over sessions of `owners`.

    The second: in those trials alone in which anything tells the phone's side.
    """
    right, of = Counter[tuple[str, bool]](), Counter[tuple[str, bool]]()
    for rng in np.random.default_rng(seed).spawn(owners):
        owner, state = owner_of(rng), State()
        for moment in session(rng):
            state = step(state, moment.time_s, moment.seen, owner)
            if moment.trial is None:
                continue
            for device in DEVICES:
                key = (device, moment.trial.decidable(owner))
                of[key] += 1
                right[key] += state.where.get(device) == moment.trial.truth.get(device)
    every = {d: (right[d, True] + right[d, False]) / (of[d, True] + of[d, False]) for d in DEVICES}
    return every, {d: right[d, True] / of[d, True] for d in DEVICES}
