"""Which devices are worn, and where: single rules, and simulated owners."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from mocap import orientation as ori
from poser.live import device_study as study
from poser.live.assembler import Row
from poser.live.devices import (
    DISTANCE_S,
    EARBUDS,
    HOLD_S,
    PHONE,
    STILL_S,
    WATCH,
    DeviceTracker,
    Preferences,
    Seen,
    State,
    step,
)  # fmt: skip
from poser.live.packets import Status

OWNER = Preferences(pocket="left", hand="right", watch="left")
WORN_WATCH = Seen(True, True)


def hold(
    state: State, seen: Mapping[str, Seen], seconds: float, owner: Preferences = OWNER
) -> State:
    for _ in range(round(seconds * 25)):
        state = step(state, state.time_s + 0.04, seen, owner)
    return state


def phone(**what: object) -> Seen:
    return Seen(True, True, **what)  # type: ignore[arg-type]


IN_HAND, IN_POCKET = {"screen": True, "proximity": False}, {"screen": False, "proximity": True}


@pytest.mark.parametrize(
    ("seen", "where"),
    [
        ({}, {}),
        ({EARBUDS: Seen(True)}, {EARBUDS: "head"}),
        ({WATCH: WORN_WATCH}, {WATCH: "left_wrist"}),
        ({WATCH: Seen(True, False)}, {}),
        ({PHONE: phone(**IN_HAND)}, {PHONE: "right_wrist"}),
        ({PHONE: Seen(True, False, True, False)}, {}),
        ({PHONE: phone(**IN_POCKET)}, {PHONE: "left_pocket"}),
        ({PHONE: phone(**IN_HAND, to_watch_m=0.6)}, {PHONE: "right_wrist"}),
        # Without a worn watch a distance to it says nothing.
        ({PHONE: phone(**IN_HAND, to_watch_m=0.1)}, {PHONE: "right_wrist"}),
        (
            {PHONE: phone(**IN_HAND, to_watch_m=0.1), WATCH: WORN_WATCH},
            {PHONE: "left_wrist", WATCH: "left_wrist"},
        ),
        (
            {PHONE: phone(**IN_POCKET, to_watch_m=0.44), WATCH: WORN_WATCH},
            {PHONE: "right_pocket", WATCH: "left_wrist"},
        ),
        (
            {PHONE: phone(**IN_POCKET, to_watch_m=0.25), WATCH: WORN_WATCH},
            {PHONE: "left_pocket", WATCH: "left_wrist"},
        ),
    ],
)
def test_the_paper_s_rules(seen: dict[str, Seen], where: dict[str, str]) -> None:
    assert hold(State(), seen, 2.0).where == where


def test_a_left_hander_with_the_watch_on_the_right() -> None:
    owner = Preferences(pocket="right", hand="left", watch="right")
    seen = {PHONE: phone(**IN_HAND, to_watch_m=0.1), WATCH: WORN_WATCH}
    assert hold(State(), seen, 2.0, owner).where == {PHONE: "right_wrist", WATCH: "right_wrist"}
    assert hold(State(), {PHONE: phone(**IN_HAND)}, 2.0, owner).where == {PHONE: "left_wrist"}


def test_a_change_counts_after_a_while_and_a_lost_connection_at_once() -> None:
    state = hold(State(), {PHONE: phone(**IN_POCKET)}, 2.0)
    glance = hold(state, {PHONE: phone(**IN_HAND)}, HOLD_S - 0.1)
    assert glance.where == {PHONE: "left_pocket"}
    assert hold(glance, {PHONE: phone(**IN_HAND)}, 0.2).where == {PHONE: "right_wrist"}
    assert hold(state, {}, 0.04).where == {}


def test_a_dark_uncovered_phone_stays_until_it_lies_still() -> None:
    dark = {"screen": False, "proximity": False}
    state = hold(State(), {PHONE: phone(**IN_HAND)}, 2.0)
    assert hold(state, {PHONE: phone(**dark)}, 5.0).where == {PHONE: "right_wrist"}
    lying = {PHONE: Seen(True, False, **dark)}
    assert hold(state, lying, STILL_S - 0.1).where == {PHONE: "right_wrist"}
    assert hold(state, lying, STILL_S + HOLD_S + 0.2).where == {}


def test_the_study_s_combinations() -> None:
    found = study.combinations()
    assert len(found) == 15
    assert len({frozenset(c.truth.values()) for c in found}) == 15


@pytest.mark.parametrize("phone_at", [None, *study.PHONE_PLACES])
@pytest.mark.parametrize("watch", [True, False])
def test_simulated_owners_in_every_combination(phone_at: str | None, watch: bool) -> None:
    """Once settled, everything is right that anything could tell, and nothing else is."""
    c = study.Combination(phone_at, watch, earbuds=True)
    rng, owner, state = np.random.default_rng(5), OWNER, State()
    wrong = total = 0
    for m in study.session(rng, (c,)):
        state = step(state, m.time_s, m.seen, owner)
        if m.trial is not None:
            total += 1
            wrong += state.where != c.truth
    if c.decidable(owner):
        assert wrong < 0.12 * total
    else:
        # Right by chance while the watch, just put down, still seems worn.
        assert wrong > 0.8 * total


def test_accuracy_over_transitions() -> None:
    """Below the paper's 90.8 % for the phone, since preferences do not help in 2 of 15 trials."""
    right, decidable = study.accuracy(owners=2, seed=1)
    assert right[EARBUDS] == 1.0
    assert right[WATCH] > 0.93
    assert 0.82 < right[PHONE] < 0.90
    assert decidable[PHONE] > 0.96


def test_the_tracker_reads_rows_and_messages() -> None:
    tracker = DeviceTracker(OWNER, rate_hz=25.0)
    devices = (WATCH, PHONE, EARBUDS)
    tracker.hear(PHONE, Status(screen=False, proximity=True))
    tracker.hear(WATCH, Status(distances={PHONE: 0.45}))
    where = {}
    for k in range(100):
        # The watch turns 1 deg/s, the phone 3 deg/s; the earbuds are not heard.
        R = ori.rot_z(np.deg2rad([1.0, 3.0, 0.0]) * k / 25)
        row = Row(k / 25, R, np.zeros((3, 3)), np.array([True, True, False]))
        where = tracker.step(row, devices)
    assert where == {WATCH: "left_wrist", PHONE: "right_pocket"}
    changes = tracker.changes
    for k in range(100, 225):
        row = Row(k / 25, R, np.zeros((3, 3)), np.array([True, True, True]))
        where = tracker.step(row, devices)
    assert where == {EARBUDS: "head"}
    assert tracker.changes > changes


def places_over(tracker: DeviceTracker, begin_s: float, end_s: float) -> dict[str, str]:
    """Where the devices are at the end; watch and phone turn slowly all the while."""
    where: dict[str, str] = {}
    for k in range(round(begin_s * 25), round(end_s * 25)):
        R = ori.rot_z(np.deg2rad([1.0, 3.0, 0.0]) * k / 25)
        row = Row(k / 25, R, np.zeros((3, 3)), np.array([True, True, False]))
        where = tracker.step(row, (WATCH, PHONE, EARBUDS))
    return where


@pytest.mark.parametrize("told_by", [WATCH, PHONE])
def test_a_distance_expires_and_the_preference_holds_again(told_by: str) -> None:
    """The status stays: the phone is in a pocket as long as it says nothing else."""
    tracker = DeviceTracker(OWNER, rate_hz=25.0)
    tracker.hear(PHONE, Status(screen=False, proximity=True))
    other = WATCH if told_by == PHONE else PHONE
    tracker.hear(told_by, Status(distances={other: 0.45}))
    assert places_over(tracker, 0.0, DISTANCE_S)[PHONE] == "right_pocket"
    assert places_over(tracker, DISTANCE_S, DISTANCE_S + 1.0)[PHONE] == "left_pocket"
    assert places_over(tracker, DISTANCE_S + 1.0, 60.0)[PHONE] == "left_pocket"
    # Distances that come again count again, from when they are heard.
    tracker.hear(told_by, Status(distances={other: 0.45}))
    assert places_over(tracker, 60.0, 62.0)[PHONE] == "right_pocket"


def test_a_message_without_a_field_says_nothing_about_it() -> None:
    tracker = DeviceTracker(OWNER, rate_hz=25.0)
    tracker.hear(PHONE, Status(screen=False, proximity=True, distances={WATCH: 0.45}))
    tracker.hear(PHONE, Status(screen=False))
    assert places_over(tracker, 0.0, 2.0)[PHONE] == "right_pocket"
    tracker.hear(PHONE, Status(screen=True))
    assert places_over(tracker, 2.0, 4.0)[PHONE] == "right_wrist"
