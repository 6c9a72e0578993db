"""Findings become sentences where they are told: all of them, and those of older files as they were."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mocap import sensors as places
from mocap.calibration import Calibration, calibrate, sentence, summary
from mocap.findings import Finding
from mocap.recording import RawRecording
from mocap.synthesis.motions import builtin
from tests.mocap.calibration.people import worn


@pytest.fixture(scope="module")
def doubtful() -> Calibration:
    """Of a recording with a head in g, a gap at a shank, and forearms exchanged."""
    raw: RawRecording = worn(builtin(60.0, 22.6), places.SIX)
    acc, valid = raw.acc.copy(), raw.valid.copy()
    acc[:, raw.sensors.index("head")] /= 9.80665
    valid[400:600, raw.sensors.index("left_shank")] = False
    raw = replace(raw, acc=acc, valid=valid).renamed(
        {"left_forearm": "right_forearm", "right_forearm": "left_forearm"}
    )
    return calibrate(raw, strict=False)[1]


def test_the_number_and_the_remedy_are_in_the_sentence(doubtful: Calibration) -> None:
    said = {(f.sensor, f.code): sentence(f) for f in doubtful.diagnostics}
    assert said["head", "acc-in-g"] == (
        "sensor head: a still sensor reads 1, expected 9.81 m/s^2: acc is in g, multiply by 9.80665"
    )
    assert said["left_shank", "gaps"].startswith("sensor left_shank: 15% of its samples")
    assert "longest gap is 3.3 s" in said["left_shank", "gaps"]


def test_findings_are_kept_in_the_file_with_their_sentences(doubtful: Calibration) -> None:
    data = json.loads(doubtful.to_json())
    assert [f["sentence"] for f in data["diagnostics"]] == list(map(sentence, doubtful.diagnostics))
    assert Calibration.from_json(json.dumps(data)).diagnostics == doubtful.diagnostics


def test_a_file_of_before_there_were_details_says_what_it_said(doubtful: Calibration) -> None:
    data = json.loads(doubtful.to_json())
    for f in data["diagnostics"]:
        del f["details"]
    old = Calibration.from_json(json.dumps(data)).diagnostics
    assert list(map(sentence, old)) == list(map(sentence, doubtful.diagnostics))
    assert [(f.sensor, f.code, f.value) for f in old] == [
        (f.sensor, f.code, f.value) for f in doubtful.diagnostics
    ]


def test_sensors_with_one_fault_are_named_together() -> None:
    same = [
        Finding("error", n, "clipping", 16.0, {"what": "acc", "limit": 16.0, "samples": 5})
        for n in ("head", "pelvis")
    ]
    other = Finding("warning", None, "facing-uncertain", 20.0, {"sigma_deg": 20.0})
    told = summary([other, *same])
    assert told.startswith("sensors head, pelvis: acc stays at its limit of 16 m/s^2")
    assert "known to" not in told and summary([]) == "nothing doubtful"
    assert sentence(other) == "where the wearer faces is known to 20 deg only"
