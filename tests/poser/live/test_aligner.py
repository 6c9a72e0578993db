"""Constants that are found anew while the session runs, and how a wearer asks for it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.calibration import Calibration
from mocap.estimator import Sample
from mocap.motion import Motion
from mocap.recording import RawRecording
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.live import alignment, asking, loop
from poser.live.aligner import Aligner
from poser.live.device_headings import HeadingWatch, WalkWatch
from tests.poser.live.conftest import Hold
from tests.poser.live.test_alignment import rows
from tests.poser.live.test_headings import led, off_deg, strapped

SIX, RATE = sensors.SIX, 60.0
AGAIN_S = 24.0  # where it stands again


@pytest.fixture(scope="module")
def session() -> Motion:
    """Stands, walks and more; then it stands and walks once more."""
    first = [motions.stand(3.0), motions.walk(8.0), motions.builtin(seconds=AGAIN_S - 11.0)]
    parts = [*first, motions.stand(4.0), motions.walk(16.0)]
    return synthesis.prepare(motions.joined(parts), RATE, 8.0)


@pytest.fixture(scope="module")
def raw(session: Motion) -> RawRecording:
    return strapped(session, SIX, 7)


@pytest.fixture(scope="module")
def known(raw: RawRecording) -> Calibration:
    found, _, _ = led(WalkWatch(SIX, RATE, "n", begin_s=0.5), raw)
    return found


def turned(raw: RawRecording, from_s: float, deg: float, sensor: int = 2) -> RawRecording:
    """One tracker has another heading from a time on: it was off and on."""
    assert raw.R_world_sensor is not None
    R = np.array(raw.R_world_sensor)
    R[round(from_s * RATE) :, sensor] = (
        ori.rot_y(np.radians(deg)) @ R[round(from_s * RATE) :, sensor]
    )
    return replace(raw, R_world_sensor=R)


def aligner(known: Calibration) -> Aligner:
    resets: Any = {
        "pose": lambda known, begin: HeadingWatch(known, SIX, RATE, "n", begin),
        "walk": lambda known, begin: WalkWatch(SIX, RATE, "n", begin_s=begin),
    }
    return Aligner(alignment.constants(known), None, known, resets, 0.3)


def reset(made: Aligner, raw: RawRecording, how: str) -> tuple[float | None, list[str]]:
    """Asks for it at AGAIN_S; when it was done, and what the wearer was told."""
    made.ask(how)
    told: list[str] = []
    for row in rows(raw)[round(AGAIN_S * RATE) :]:
        assert made.push(row)  # poses go on
        words = made.prompt(row.time_s).split(" ")[0]
        if words and told[-1:] != [words]:
            told.append(words)
        if made.turns:
            return row.time_s, told
        if made.trouble:
            break
    return None, told


def test_headings_are_taken_anew_in_a_running_session(
    session: Motion, raw: RawRecording, known: Calibration
) -> None:
    """By standing for 1.5 s: a shank that is off by 50 deg is where it was before."""
    lost, made = turned(raw, 20.0, 50.0), aligner(known)
    before = off_deg(known, lost, session, 30.0)
    at, told = reset(made, lost, "pose")
    assert at is not None and at < AGAIN_S + 3.0
    assert told == ["get", "stand"]
    assert made.calibration is not None and not made.waiting and made.prompt(at) == ""
    after = off_deg(made.calibration, lost, session, 30.0)
    assert before[2] > 40 and after[2] < off_deg(known, raw, session, 30.0)[2] + 8


def test_a_sensor_that_slipped_is_found_by_standing_and_walking(
    session: Motion, raw: RawRecording, known: Calibration
) -> None:
    """Its mounting, too; standing alone refuses it, and leaves all as it was."""
    assert raw.R_world_sensor is not None
    R = np.array(raw.R_world_sensor)
    R[round(20 * RATE) :, 4] = R[round(20 * RATE) :, 4] @ ori.exp([0.8, 0.8, 0.0])
    # What it felt turns with it.
    acc, gyr = np.array(raw.acc), np.array(raw.gyr)
    for x in (acc, gyr):
        x[round(20 * RATE) :, 4] = x[round(20 * RATE) :, 4] @ ori.exp([0.8, 0.8, 0.0])
    slipped, made = replace(raw, R_world_sensor=R, acc=acc, gyr=gyr), aligner(known)
    table = made.table
    assert reset(made, slipped, "pose")[0] is None
    assert "sensor head is" in made.trouble and made.table is table
    at, told = reset(made, slipped, "walk")
    assert at is not None and told == ["get", "stand", "now"] and made.trouble == ""
    assert made.calibration is not None
    assert off_deg(made.calibration, slipped, session, at)[4] < 15


def test_what_is_not_offered_is_not_asked(known: Calibration, raw: RawRecording) -> None:
    made = aligner(known)
    made.ask("dance")
    assert made.push(rows(raw)[0]) and made.prompt(0.0) == ""
    assert Aligner().resets == {}


class Turning:
    """A source whose world turns by 90 deg once."""

    rate_hz, sensors, joint, seat = RATE, ("pelvis",), None, None

    def __init__(self) -> None:
        self.k = self.turns = 0

    @property
    def ended(self) -> bool:
        return self.k >= 20

    def poll(self) -> list[Sample]:
        self.k += 1
        self.turns = int(self.k > 10)
        R = ori.rot_y(np.pi / 2 * self.turns)
        return [Sample(self.k / RATE, R[None], np.zeros((1, 3)), np.ones(1, bool))]

    def lag_s(self, time_s: float) -> None:
        return None

    def behind_s(self, time_s: float) -> float:
        return 0.0


class Walks(Hold):
    """Goes ahead by 1 cm a sample since it began."""

    def step(self, state: Any, sample: Sample) -> Any:
        state, pose = super().step(state, sample)
        assert pose is not None
        count = len(self.steps) if state is not None else 0
        self.steps.append(count)
        return state, replace(pose, p_world_root=np.array([0.0, 0.5, 0.01 * count]))

    def init(self) -> Any:
        self.steps: list[int] = []
        return super().init()


def test_the_body_stays_where_it_is_when_its_world_turns() -> None:
    """The estimator begins anew at its origin; the root goes on from where it was, on the floor."""
    found: list[Any] = []

    class Sink:
        name = "list"

        def write(self, pose: Any) -> None:
            found.append(pose)

        def close(self) -> dict[str, Any]:
            return {}

    loop.run(Turning(), Walks(RATE, ("pelvis",)), [Sink()], Skeleton.default(), loop.Report())  # type: ignore[arg-type,list-item]
    p = np.array([pose.p_world_root for pose in found])
    assert len(p) == 20
    np.testing.assert_allclose(np.diff(p[:, 2]), [0.01] * 9 + [0.0] + [0.01] * 9, atol=1e-12)
    np.testing.assert_allclose(p[:, 1], p[0, 1], atol=1e-9)


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[bytes], None]]:
    """A terminal whose lines the test writes."""
    own, theirs = os.openpty()
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        monkeypatch.setattr(asking.os, "tcgetpgrp", lambda _: os.getpgrp())

        def types(text: bytes) -> None:
            os.write(own, text)

        yield types
        os.close(own)


def test_a_key_asks(typed: Callable[[bytes], None], capsys: pytest.CaptureFixture[str]) -> None:
    from poser.live.assembler import Assembler
    from poser.live.samples import Network
    from tests.poser.live.test_network import Script

    made = Aligner(resets={"pose": lambda known, begin: None})  # type: ignore[dict-item,arg-type,return-value]
    source = Network(Script([]), Assembler(("head",), RATE), ("head",), {"head": "head"}, made)
    offered: list[Any] = []

    class Page:
        def offer(self, words: Any, ask: Any) -> None:
            offered.append(words)

    asking.offer(source, [Page()])  # type: ignore[list-item]
    assert "r and Enter: new headings" in capsys.readouterr().err
    assert offered == [{"pose": asking.WORDS["pose"]}]
    typed(b"x\nr\n")
    until = time.monotonic() + 5.0
    while made._asked is None and time.monotonic() < until:
        time.sleep(0.01)
    assert made._asked == "pose"
