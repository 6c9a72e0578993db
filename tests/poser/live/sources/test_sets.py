"""What every kind without a conversation of its own must bear: loss, other orders, restarts and noise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from mocap.recording import Recording
from tests.poser.live.sources.conftest import RATE, Time, heard, same_poses
from tests.poser.live.sources.sets import SETS, START_S, at


@pytest.fixture(params=SETS)
def devices(request: pytest.FixtureRequest, worn: Recording) -> Iterator[Any]:
    time = Time()
    made = SETS[request.param](worn, time)
    made.time = time
    with closing(made), closing(made.intake):
        yield made


def test_at_rate_the_poses_are_those_of_the_recording(devices: Any, worn: Recording) -> None:
    def send(k: int) -> None:
        for s in range(len(worn.sensors)):
            devices.bring(s, devices.frame(s, k, at(k)))

    source, got = heard(devices.intake, devices.time, worn, send, devices.where())
    same_poses(got, worn, within_deg=0.1)
    assert not devices.intake.rejected
    assert all(c["late"] == c["jumps"] == 0 for c in source.facts()["devices"].values())


def test_loss_other_orders_a_restart_and_noise(devices: Any, worn: Recording) -> None:
    """2 % lost, some swapped with the next, a device whose clock begins anew at 3 s, bytes that are none."""
    rng, held = np.random.default_rng(4), dict[int, bytes]()

    def send(k: int) -> None:
        if k == 50:
            devices.bring(0, devices.garbage)
        for s in range(len(worn.sensors)):
            anew = s == 1 and k >= 180
            body = devices.frame(s, k, (k - 180) / RATE if anew else at(k))
            if k % 40 == 20 and s in (2, 3):
                held[s] = body
            elif rng.random() > 0.02:
                devices.bring(s, body)
                if s in held:
                    devices.bring(s, held.pop(s))

    source, got = heard(devices.intake, devices.time, worn, send, devices.where())
    facts = source.facts()
    assert facts["rejected"] == {devices.reason: 1}
    t, valid = np.array([s.time_s for s in got]), np.array([s.valid for s in got])
    others = [0, 2, 3, 4, 5]
    assert valid[:, others].mean() > 0.98
    assert valid[t < 2.9, 1].mean() > 0.98
    assert valid[(t > 3.8) & (t < 5.9), 1].mean() > 0.98  # believed after half a second
    same_poses([s for s in got if s.valid.all()][:170], worn.slice(0, 170), within_deg=5.0)
    [counts] = [c for n, c in facts["devices"].items() if devices.where()[n] == worn.sensors[1]]
    assert counts["jumps"] == 1


@pytest.mark.parametrize("kind", ["text", "sensorlogger"])
def test_a_second_sender_of_a_name_is_counted(worn: Recording, kind: str) -> None:
    """Bluetooth and phyphox have one device of an address; elsewhere anybody may take a name."""
    time = Time()
    made = SETS[kind](worn, time)

    def send(k: int) -> None:
        for s in range(len(worn.sensors)):
            made.bring(s, made.frame(s, k, at(k)))
        if 100 <= k < 120:
            made.bring(0, made.frame(0, 0, START_S + k), other=True)

    with closing(made), closing(made.intake):
        source, got = heard(made.intake, time, worn, send, made.where())
    same_poses(got, worn, within_deg=0.1)
    facts, [first, *_] = source.facts(), made.where()
    counted = facts["devices"][first]["others"], facts["rejected"]
    taken = {"name taken by another device": 20}
    assert counted == {"text": (20, {}), "sensorlogger": (0, taken)}[kind]
