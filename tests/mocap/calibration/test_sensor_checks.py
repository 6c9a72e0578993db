"""Dead and copied channels, wrong rates, scales and orientations are named; right data raises no alarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import calibrate, sentence
from mocap.calibration.checks import check_sensors, copied, frozen, spikes
from mocap.calibration.checks.orientations import explained
from mocap.calibration.evidence import gather
from mocap.calibration.measures import constant_force, rate_ratio, usual_force
from mocap.calibration.spikes import without_spikes
from mocap.errors import CalibrationError
from mocap.findings import Finding
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, raw_recording
from mocap.synthesis.motions import builtin

SENSORS = ("left_forearm", "right_forearm", "left_shank", "pelvis")


@pytest.fixture(scope="module", params=["none", "realistic"])
def raw(request: pytest.FixtureRequest) -> RawRecording:
    """22 s of the built-in programme."""
    motion = builtin(60.0, 22.6).turned(0.7)
    six = raw_recording(motion, places.SIX, NOISES[request.param], 3)
    return replace(six.select(SENSORS), mag=None)


def codes(raw: RawRecording) -> set[tuple[str | None, str]]:
    return {(f.sensor, f.code) for f in check_sensors(raw)}


def check_channels(raw: RawRecording) -> list[Finding]:
    return frozen.check(gather(raw)) + copied.check(gather(raw))


def edited(
    raw: RawRecording, s: int, gyr: Callable | None = None, acc: Callable | None = None
) -> RawRecording:
    new = {"gyr": raw.gyr.copy(), "acc": raw.acc.copy()}
    for name, change in (("gyr", gyr), ("acc", acc)):
        if change is not None:
            new[name][:, s] = change(new[name][:, s])
    return replace(raw, **new)


def held(raw: RawRecording, s: int, a: int, b: int, at: int) -> RawRecording:
    """Frames a to b-1 of sensor `s` repeat the valid sample next after `at`."""
    at += int(np.argmax(raw.valid[at:, s]))
    new = {"gyr": raw.gyr.copy(), "acc": raw.acc.copy()}
    for x in new.values():
        x[a:b, s] = x[at, s]
    return (
        replace(raw, valid=np.ones_like(raw.valid), **new)
        if raw.valid.all()
        else replace(raw, **new)
    )


def test_right_data_has_no_dead_channel_and_the_right_rate(raw: RawRecording) -> None:
    """Noise-free limbs repeat their samples bit by bit while others move; that is no fault."""
    for seen in (raw, replace(raw, R_world_sensor=None)):
        assert codes(seen) == set()
        assert gather(seen).rates.rate_hz == raw.rate_hz


def test_a_sensor_frozen_throughout(raw: RawRecording) -> None:
    dead = edited(
        raw, 2, gyr=np.zeros_like, acc=lambda x: np.broadcast_to(np.nanmedian(x, axis=0), x.shape)
    )
    assert (SENSORS[2], "frozen") in codes(dead)
    (finding,) = check_channels(dead)
    # In noise-free data the pelvis rests to the bit as well: only noise makes such rest a fault.
    rests = (raw.gyr[1:, 3] == raw.gyr[:-1, 3]).all(axis=-1).sum() > raw.rate_hz
    assert finding.severity == ("warning" if rests else "error")
    assert "repeats one sample" in sentence(finding)


def test_a_sensor_that_freezes_in_motion(raw: RawRecording) -> None:
    rate = np.linalg.norm(np.nan_to_num(raw.gyr[:, 0]), axis=1)
    at = int(np.argmax(np.convolve(rate, np.ones(90), "valid")))
    dead = replace(held(raw, 0, at, at + 90, at), valid=None)
    (finding,) = [f for f in check_channels(dead) if f.code == "frozen"]
    assert (finding.sensor, finding.severity) == (SENSORS[0], "error")
    assert finding.value == pytest.approx(1.5, abs=0.1)


def test_who_stands_still_and_gaps_are_not_frozen(raw: RawRecording) -> None:
    same = {n: np.repeat(0.1 * getattr(raw, n)[90:91], len(raw), axis=0) for n in ("gyr", "acc")}
    assert check_channels(replace(raw, valid=None, **same)) == []
    gap = np.array(raw.valid)
    gap[300:500, 0] = False
    assert check_channels(replace(raw, valid=gap)) == []


def test_padding_at_the_beginning_is_a_warning() -> None:
    rng = np.random.default_rng(0)
    gyr, acc = rng.normal(0, 1, (1200, 3, 3)), rng.normal(3, 3, (1200, 3, 3))
    gyr[:90, 1], acc[:90, 1] = 0.0, (0, 9.8, 0)
    (finding,) = check_channels(RawRecording(60.0, ("pelvis", "head", "left_shank"), gyr, acc))
    assert (finding.sensor, finding.severity) == ("head", "warning")


def test_a_channel_copied_to_another(raw: RawRecording) -> None:
    gyr, acc = raw.gyr.copy(), raw.acc.copy()
    gyr[:, 1], acc[:, 1] = gyr[:, 0], acc[:, 0]
    (finding,) = check_channels(replace(raw, gyr=gyr, acc=acc))
    assert (finding.sensor, finding.code) == (SENSORS[1], "copied")
    assert SENSORS[0] in sentence(finding)


@pytest.mark.parametrize("factor", [0.5, 1.2, 2.0])
def test_a_wrong_rate_is_named_by_the_orientation(raw: RawRecording, factor: float) -> None:
    wrong = replace(raw, rate_hz=raw.rate_hz * factor, reference=None)
    (finding,) = [f for f in check_sensors(wrong) if f.severity == "error"]
    assert (finding.sensor, finding.code) == (None, "sampling-rate")
    assert finding.value == pytest.approx(60.0, rel=0.03)
    assert "the sampling rate is probably" in sentence(finding)


def test_half_the_rate_is_named_without_orientation(raw: RawRecording) -> None:
    wrong = replace(raw, rate_hz=30.0, reference=None, R_world_sensor=None)
    assert (None, "sampling-rate") in codes(wrong)
    assert gather(wrong).rates.rate_hz == pytest.approx(60.0)


@pytest.mark.parametrize(("factor", "severity"), [(1.5, "error"), (1.17, "warning")])
def test_the_scale_of_one_gyroscope(raw: RawRecording, factor: float, severity: str) -> None:
    findings = check_sensors(edited(raw, 2, gyr=lambda x: factor * x))
    (finding,) = findings
    assert (finding.sensor, finding.code, finding.severity) == (SENSORS[2], "gyr-scale", severity)
    assert finding.value == pytest.approx(factor, rel=0.03)
    assert rate_ratio(raw, 2) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("with_R", [True, False])
def test_radians_taken_for_degrees(raw: RawRecording, with_R: bool) -> None:
    seen = raw if with_R else replace(raw, R_world_sensor=None)
    assert (SENSORS[2], "gyr-unit") in codes(edited(seen, 2, gyr=np.radians))
    small = replace(seen, gyr=np.radians(seen.gyr))
    assert {(n, "gyr-unit") for n in SENSORS[:3]} <= codes(small)


@pytest.mark.parametrize("of", ["all", "one"])
@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda R: np.swapaxes(R, -1, -2), "orientation-transposed"),
        (lambda R: ori.from_quat(ori.to_quat(R), scalar_first=False), "quaternion-order"),
        (
            lambda R: ori.from_quat(np.roll(ori.to_quat(R), -1, axis=-1), scalar_first=True),
            "quaternion-order",
        ),
        (lambda R: ori.R_ZUP_YUP @ R, "orientation-world"),
    ],
    ids=["transposed", "wxyz as xyzw", "xyzw as wxyz", "z up"],
)
def test_orientation_written_the_wrong_way(
    raw: RawRecording, change: Callable, code: str, of: str
) -> None:
    assert raw.R_world_sensor is not None
    R = np.array(raw.R_world_sensor)
    some = slice(None) if of == "all" else slice(0, 1)
    has = np.isfinite(R).all((-1, -2))
    has[:, [s for s in range(4) if s not in range(4)[some]]] = False
    R[has] = change(R[has])
    found = [f for f in check_sensors(replace(raw, R_world_sensor=R)) if f.severity == "error"]
    assert {f.code for f in found} == {code}
    named = {f.sensor for f in found}
    assert named == {SENSORS[0]} if of == "one" else set(SENSORS[:3]) <= named


def test_a_refusal_names_the_orientation_and_not_the_axes_it_makes_wrong(raw: RawRecording) -> None:
    assert raw.R_world_sensor is not None
    R = np.array(raw.R_world_sensor)
    has = np.isfinite(R).all((-1, -2))
    has[:, [0, 1, 3]] = False
    R[has] = ori.from_quat(np.roll(ori.to_quat(R[has]), 1, axis=-1))
    with pytest.raises(CalibrationError, match="quaternions look like") as refused:
        calibrate(replace(raw, R_world_sensor=R), at=1.0)
    assert ";" not in str(refused.value) and "axes" not in str(refused.value)


def test_the_right_orientation_is_left_alone(raw: RawRecording) -> None:
    assert raw.R_world_sensor is not None
    for s in range(len(SENSORS)):
        ok = raw.valid[:, s]
        parts = (raw.gyr[:, s], np.nan_to_num(raw.acc[:, s]), raw.R_world_sensor[:, s])
        assert explained(*parts, ok, raw.rate_hz) is None


def test_gravity_that_is_removed_is_not_taken_for_g(raw: RawRecording) -> None:
    """Noise and shaking leave 0.9 m/s^2 in |acc|, which looks like acc in g; the mean does not."""
    assert raw.R_world_sensor is not None
    up = np.einsum("tsji,j->tsi", raw.R_world_sensor, [0, ori.GRAVITY, 0])
    free = replace(raw, acc=raw.acc - up)
    assert {c for _, c in codes(free)} == {"acc-without-gravity"}
    assert {c for _, c in codes(replace(free, R_world_sensor=None))} == {"acc-without-gravity"}
    assert {c for _, c in codes(replace(raw, acc=raw.acc / ori.GRAVITY))} == {"acc-in-g"}


def test_constant_force_keeps_gravity_and_drops_noise() -> None:
    rng = np.random.default_rng(0)
    acc = rng.normal(0, 0.5, (600, 3))
    gyr = np.zeros((600, 3))
    assert constant_force(gyr, acc, 60.0) < 0.3
    assert constant_force(gyr, np.add(acc, [0, 1.0, 0]), 60.0) == pytest.approx(1.0, abs=0.1)


def spiked(raw: RawRecording, what: str, value: float, at: int = 800) -> RawRecording:
    """One sample of the left shank is `value` on its y axis, behind frame `at`."""
    at += int(np.argmax(raw.valid[at:, 2]))
    values = getattr(raw, what).copy()
    values[at, 2, 1] = value
    return replace(raw, **{what: values})


@pytest.mark.parametrize(
    ("what", "value"), [("acc", 1e6), ("acc", -2000.0), ("gyr", 3000.0), ("gyr", -90.0)]
)
@pytest.mark.parametrize("with_R", [True, False])
def test_a_sample_beyond_any_range_is_missing(
    raw: RawRecording, what: str, value: float, with_R: bool
) -> None:
    seen = raw if with_R else replace(raw, R_world_sensor=None)
    bad = spiked(seen, what, value)
    clean, _ = without_spikes(bad)
    (finding,) = spikes.check(gather(bad))
    (at,) = np.flatnonzero(seen.valid[:, 2] & ~clean.valid[:, 2])
    assert np.isnan(clean.acc[at, 2]).all() and np.isnan(clean.gyr[at, 2]).all()
    assert (finding.severity, finding.sensor) == ("warning", SENSORS[2])
    assert finding.code == "impossible-sample" and finding.value == value
    assert (
        f"1 sample beyond what sensors can measure, taken for missing; the first at {at / 60:.2f} s: {what}"
        in sentence(finding)
    )
    # Nothing else is said because of it, and it is said once.
    assert codes(bad) == {(SENSORS[2], "impossible-sample")}
    assert without_spikes(clean)[1] == []


def test_a_spike_does_not_touch_the_result(raw: RawRecording) -> None:
    seen = replace(raw, R_world_sensor=None)
    want, _ = calibrate(seen, at=1.0, facing=0.0, strict=False)
    clean, _ = without_spikes(spiked(seen, "acc", 1e6))
    have, _ = calibrate(clean, at=1.0, facing=0.0, strict=False)
    both = have.ori_valid & want.ori_valid
    off = ori.angle_between(have.R_world_bone[both], want.R_world_bone[both])
    assert np.rad2deg(off).max() < 1


@pytest.mark.parametrize(
    ("what", "factor"), [("gyr", 180 / np.pi), ("acc", 1000 / ori.GRAVITY), ("acc", 100.0)]
)
def test_a_wrong_unit_has_no_spikes(raw: RawRecording, what: str, factor: float) -> None:
    for seen in (raw, replace(raw, R_world_sensor=None)):
        wrong = replace(seen, **{what: factor * getattr(seen, what)})
        assert without_spikes(wrong)[1] == []


def test_one_swing_in_degrees_is_no_spike() -> None:
    """A swing of 0.4 s in 3 min of rest is rare, but it rises over several samples."""
    t = np.arange(10800) / 60
    swing = 500 * np.sin(np.pi * (t - 60) / 0.4) * ((t > 60) & (t < 60.4))
    gyr, acc = np.zeros((len(t), 1, 3)), np.zeros((len(t), 1, 3))
    gyr[:, 0, 0], acc[:, 0, 1] = swing, ori.GRAVITY
    raw = RawRecording(60.0, ("pelvis",), gyr, acc)
    assert without_spikes(raw)[1] == []


@pytest.mark.parametrize("what", ["acc", "gyr"])
def test_a_quantity_without_samples_is_named(raw: RawRecording, what: str) -> None:
    values = getattr(raw, what).copy()
    values[:, 1] = np.nan
    (finding,) = [f for f in check_sensors(replace(raw, **{what: values})) if f.severity == "error"]
    assert (finding.sensor, finding.code) == (SENSORS[1], "no-data")
    assert f"no sample of {what}, both acc and gyr are needed" in sentence(finding)
    assert "--sensors" in sentence(finding)


def test_too_few_samples_say_how_many_are_needed(raw: RawRecording) -> None:
    short = replace(raw, R_world_sensor=None, reference=None).slice(0, 50)
    sentences = [sentence(f) for f in check_sensors(short)]
    assert len(sentences) == 4
    assert all("valid samples, 60 (1 s) are needed" in s and "--sensors" in s for s in sentences)


def test_a_sensor_with_few_samples_in_the_pose_is_told_of_and_nothing_fails(
    raw: RawRecording,
) -> None:
    """12 samples are too few to be parted into a before and an after."""
    valid = np.zeros_like(raw.valid)
    valid[:, [0, 2, 3]] = raw.valid[:, [0, 2, 3]]
    valid[40:52, 1] = True
    cut = replace(raw, valid=valid & np.isfinite(raw.gyr).all(-1))
    _, cal = calibrate(cut, at=0.8, facing=0.0, strict=False)
    assert (SENSORS[1], "no-data") in {(f.sensor, f.code) for f in cal.diagnostics}


def test_usual_force_is_gravity_in_motion(raw: RawRecording) -> None:
    usual, sample = usual_force(raw.acc, raw.rate_hz)
    np.testing.assert_allclose(usual, ori.GRAVITY, rtol=0.15)
    assert (usual > 0.9 * sample).all()
    nothing = np.zeros((600, 1, 3))
    assert np.isnan(usual_force(nothing, 60.0)).all()
    assert np.isnan(usual_force(nothing[:60] + 1.0, 60.0)).all()
