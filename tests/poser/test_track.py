"""`poser track` with small untrained networks, and the estimators by name."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import learned
from hybrid import Tracker, TrackerSettings
from learned import checkpoint
from learned.config import for_network
from learned.imuposer.adam import AdamEstimator
from learned.model import build
from mocap import Skeleton, sensors, synthesis
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.estimator import replay, samples
from mocap.formats.native import FORMAT
from mocap.recording import Recording
from mocap.synthesis import motions
from poser import estimators, files, tracking
from poser.__main__ import main
from poser.commands import track
from tests.poser.handovers import all_five, handed_over


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """dip.safetensors, imuposer.safetensors; six.npz at 60 Hz, suit.npz at 50 Hz, five.npz at 25 Hz."""
    where = tmp_path_factory.mktemp("track")
    for network in ("dip", "imuposer"):
        torch.manual_seed(0)
        model = build(for_network(network, hidden=16))
        if network == "dip":
            model.out_mean.copy_(torch.eye(3).flatten().repeat(15))  # near the rest pose
            model.out_deviation.fill_(0.1)
        checkpoint.save(model, where / f"{network}.safetensors", {})
    sets = {"six": (60.0, sensors.SIX), "suit": (50.0, sensors.SUIT), "five": (25.0, sensors.FIVE)}
    for name, (rate_hz, names) in sets.items():
        made = synthesis.recording(
            motions.walk(3.0, rate_hz), names, synthesis.NOISES["realistic"], 3
        )
        assert FORMAT.write is not None
        FORMAT.write(where / f"{name}.npz", made.slice(60, 60 + round(rate_hz / 2)))
    return where


CASES = [
    ("six", "dip", [], "dip", 5, sensors.SIX),
    ("six", "dip", ["--window", "3,0"], "dip", 0, sensors.SIX),
    ("suit", "dip", [], "dip", 6, sensors.SIX),
    ("six", "imuposer", [], "imuposer", 5, ("left_forearm", "right_forearm", "head")),
    ("five", "imuposer", ["--sensors", "head,right_pocket"], "imuposer", 0, ("right_pocket", "head")),
    ("five", "imuposer", [], "imuposer", 0, ("left_wrist", "right_pocket", "head")),
    ("five", "imuposer-adam", ["--sensors", "left_wrist"], "imuposer", 0, ("left_wrist",)),
    ("six", "hybrid", [], "dip", 5, sensors.SIX),
    ("six", "hybrid", ["--network", "imuposer"], "imuposer", 5,
     ("left_forearm", "right_forearm", "head")),
]  # fmt: skip


@pytest.mark.parametrize(("name", "method", "words", "network", "late", "names"), CASES)
def test_the_motion_has_exactly_the_recordings_frames(
    name: str,
    method: str,
    words: list[str],
    network: str,
    late: int,
    names: tuple[str, ...],
    place: Path,
    tmp_path: Path,
    answer: Callable[..., Any],
) -> None:
    weights = place / f"{network}.safetensors"
    out = tmp_path / "out.npz"
    said = answer(
        "track", place / f"{name}.npz", "-o", out, "--method", method, "--weights", weights,
        "--height", 1.9, *words,
    )  # fmt: skip
    recording = files.recording(place / f"{name}.npz")
    motion = files.motion(out)
    assert len(motion) == len(recording) == said["frames"]
    assert motion.rate_hz == pytest.approx(recording.rate_hz)
    assert said["look_ahead_frames"] == late
    assert said["used_sensors"] == list(names)
    assert (said["method"], said["network"]) == (method, network)
    assert said["network_hz"] == {"dip": 60.0, "imuposer": 25.0}[network]
    assert 0 < said["frame_ms_p50"] <= said["frame_ms_p99"]
    assert said["fallbacks"] == sum(said["notes"].values()) < len(recording)
    if method == "dip":  # the pelvis is the sensor's, frame for frame
        R = recording.select(("pelvis",)).R_world_bone[:, 0]
        ok = recording.select(("pelvis",)).valid[:, 0]
        off = np.abs(motion.R_parent_joint[:, 0] - R)[ok].max()
        assert off < (1e-5 if recording.rate_hz == 60 else 0.05)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("six", r"ms per sample at 60 Hz \(99 %: [0-9.]+\), 5 frames"),
        ("suit", r"ms per sample at 50 Hz \(99 %: [0-9.]+; the network runs at 60 Hz\), 6 frames"),
    ],
)
def test_times_are_told_of_the_recordings_samples(
    name: str, said: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--method", "dip", "--weights", str(place / "dip.safetensors")]
    assert main(["track", str(place / f"{name}.npz"), "-o", str(tmp_path / "o.npz"), *words]) == 0
    assert re.search(said, capsys.readouterr().out)


def test_horizon_and_lag_are_the_hybrids(
    place: Path, tmp_path: Path, answer: Callable[..., Any]
) -> None:
    line = ("track", place / "six.npz", "--weights", place / "dip.safetensors", "--to", 2.0)
    hybrid = ("--method", "hybrid")
    said = answer(*line, "-o", tmp_path / "a.npz", *hybrid, "--horizon", 0.2, "--lag", 2)
    assert said["look_ahead_frames"] == said["lag_frames"] == 2
    assert said["window_frames_most"] == 12 and 1 <= said["steps_per_frame"] <= 2
    again = answer(*line, "-o", tmp_path / "b.npz", *hybrid, "--horizon", 0.2, "--lag", 2)
    assert said["window_events"] == again["window_events"]
    poses = [files.motion(tmp_path / f"{name}.npz").R_parent_joint for name in "ab"]
    assert np.abs(poses[0] - poses[1]).max() < 1e-6
    alone = answer(*line, "-o", tmp_path / "c.npz", *hybrid, "--horizon", 0)
    assert alone["look_ahead_frames"] == 5 and alone["window_frames"] == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--method", "dip", "--lag", "3"], "argument --lag: it is the hybrid's"),
        (["--method", "imuposer", "--horizon", "1"], "argument --horizon: it is the hybrid's"),
        (["--method", "hybrid", "--horizon", "-1"], "argument --horizon: 0 to 5 s, got -1"),
        (
            ["--method", "hybrid", "--horizon", "0", "--lag", "3"],
            "argument --lag: without a window",
        ),
        (["--method", "hybrid", "--lag", "half"], "'half' is not a number of frames"),
    ],
)
def test_a_horizon_or_lag_that_cannot_be_is_refused(
    words: list[str],
    said: str,
    place: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = ["track", str(place / "six.npz"), "-o", str(tmp_path / "o.npz"), *words]
    assert main(line) == 2
    assert said in capsys.readouterr().err


def test_fewer_frames_than_the_look_ahead_are_told(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["track", str(place / "six.npz"), "-o", str(tmp_path / "o.npz"), "--method", "dip"]
    for frames, told in ((6, False), (5, True), (1, True)):
        end = ["--weights", str(place / "dip.safetensors"), "--to", str(1 + frames / 60)]
        assert main([*words, *end]) == 0
        said = f"has {frames} frames, and dip looks 5 ahead" in capsys.readouterr().err
        assert said == told and len(files.motion(tmp_path / "o.npz")) == frames


@pytest.mark.parametrize("words", [(), ("--sensors", "all")])
@pytest.mark.parametrize("make", [handed_over, all_five])
@pytest.mark.parametrize("method", ["imuposer", "imuposer-adam", "hybrid"])
def test_devices_that_are_never_worn_together_are_all_tracked(
    method: str, make: Callable[[], Recording], words: tuple[str, ...], place: Path, tmp_path: Path,
    answer: Callable[..., Any], capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Chosen by default, not refused by name; and those of the second half do move the pose there."""
    recording = make()
    assert FORMAT.write is not None
    FORMAT.write(tmp_path / "rec.npz", recording)
    network = ("--network", "imuposer") if method == "hybrid" else ()
    given = ("--method", method, *network, "--weights", place / "imuposer.safetensors")
    rec, out = tmp_path / "rec.npz", tmp_path / "out.npz"
    said = answer("track", rec, "-o", out, *given, *words)
    assert said["used_sensors"] == [n for n in sensors.FIVE if n in recording.sensors]
    assert said["frames"] == len(recording)
    # Only while both of the phone's places count as worn, half a second, is one left out; nothing else is.
    left_out = {k: n for k, n in said["notes"].items() if "is used" in k}
    assert sum(left_out.values()) <= 13
    other = {k: n for k, n in said["notes"].items() if k not in left_out}
    assert set(other) <= {"no sensor measured"} and sum(other.values()) <= 2
    half = len(recording) // 2 + 15
    few = recording.sensors[:2]  # those of the first half alone
    assert main(["track", str(rec), "-o", str(tmp_path / "few.npz"), *map(str, given),
                 "--sensors", ",".join(few)]) == 0  # fmt: skip
    a, b = (files.motion(p).R_parent_joint for p in (out, tmp_path / "few.npz"))
    assert np.abs(a[half:] - b[half:]).max() > 1e-3


def test_devices_worn_together_are_chosen_from_as_ever(
    place: Path, tmp_path: Path, answer: Callable[..., Any], refusal: Callable[..., Any]
) -> None:
    """One frame in which four are valid is enough; in the part without it all are taken."""
    recording = handed_over()
    valid, half = np.array(recording.valid), len(recording) // 2
    valid[half - 1, 2] = True
    assert FORMAT.write is not None
    FORMAT.write(tmp_path / "rec.npz", replace(recording, valid=valid))
    pockets = handed_over().select(("left_pocket", "right_pocket", "head"))
    valid = np.array(pockets.valid)
    valid[0] = True
    FORMAT.write(tmp_path / "pockets.npz", replace(pockets, valid=valid))
    words = ("--method", "imuposer", "--weights", place / "imuposer.safetensors")
    out = ("-o", tmp_path / "out.npz")
    said = answer("track", tmp_path / "rec.npz", *out, *words)
    assert said["used_sensors"] == ["left_wrist", "right_pocket", "head"]
    later = recording.start_s + (half + 2) / 25
    said = answer("track", tmp_path / "rec.npz", *out, *words, "--from", later)
    assert len(said["used_sensors"]) == 4
    _, why = refusal("track", tmp_path / "rec.npz", *out, *words, "--sensors", "all")
    assert "one to three devices at a time, not on 4 devices: choose with --sensors" in why
    said = answer("track", tmp_path / "pockets.npz", *out, *words)
    assert said["used_sensors"] == ["left_pocket", "head"]
    _, why = refusal("track", tmp_path / "pockets.npz", *out, *words, "--sensors", "all")
    assert "not on left_pocket, right_pocket, head together" in why


@pytest.mark.parametrize(
    ("name", "spec", "names"),
    [
        ("six", "five", ("left_forearm", "right_forearm", "head")),
        ("suit", "left_wrist", ("left_forearm",)),
        ("suit", "right_pocket,left_wrist,left_forearm", ("left_forearm", "right_thigh")),
    ],
)
def test_a_named_place_is_served_by_another_sensor_on_its_bone(
    name: str, spec: str, names: tuple[str, ...], place: Path, tmp_path: Path,
    answer: Callable[..., Any], capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    words = ("--method", "imuposer", "--weights", place / "imuposer.safetensors", "--sensors", spec)
    out = tmp_path / "out.npz"
    line = ["track", str(place / f"{name}.npz"), "-o", str(out), *map(str, words)]
    assert answer(*line)["used_sensors"] == list(names)
    assert main(line) == 0
    said = capsys.readouterr().err
    assert said.count("left_forearm stands in for left_wrist, which is on the same bone") == 1
    # To other commands, which read seats as well, a name is a name.
    assert main(["solve", str(place / f"{name}.npz"), "-o", str(out), "--sensors", spec]) == 1


def test_a_place_that_the_network_does_not_need_is_told_too(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """DIP reads the forearm; the user named the wrist."""
    spec = ",".join(("left_wrist", *sensors.SIX[1:]))
    words = ["--method", "dip", "--weights", str(place / "dip.safetensors"), "--sensors", spec]
    assert main(["track", str(place / "six.npz"), "-o", str(tmp_path / "o.npz"), *words]) == 0
    assert "left_forearm stands in for left_wrist" in capsys.readouterr().err


def test_only_sets_that_are_there_are_recommended(
    place: Path, tmp_path: Path, refusal: Callable[..., Any]
) -> None:
    for name, words, sets in (
        (
            "six",
            ("track", "--method", "imuposer", "--sensors", "left_foot"),
            "(or the sets six, all)",
        ),
        ("five", ("track", "--method", "imuposer", "--sensors", "six"), "(or the sets five, all)"),
        ("suit", ("track", "--method", "dip", "--sensors", "foo"), "(or the sets six, five, all)"),
        ("suit", ("solve", "--sensors", "five"), "(or the sets six, all)"),
        ("five", ("solve", "--sensors", "left_wrist,pelvis"), "(or the sets five, all)"),
    ):
        command, *more = words
        status, said = refusal(command, place / f"{name}.npz", "-o", tmp_path / "o.npz", *more)
        assert status == 1 and "not in the recording; there is: " in said and sets in said


REFUSED = [
    (("five", "--method", "dip"), 1, "no left_shank, right_shank, pelvis"),
    (("five", "--method", "imuposer", "--sensors", "five"), 1, "choose with --sensors"),
    (("five", "--method", "imuposer", "--sensors", "left_pocket,right_pocket,head"), 1, "head together"),
    (("six", "--method", "imuposer", "--sensors", "pelvis"), 1, "one to three of"),
    (("six", "--method", "dip", "--network", "imuposer"), 2, "--network"),
    (("six", "--method", "imuposer", "--window", "20,5"), 2, "--window"),
    (("six", "--method", "dip", "--window", "20"), 2, "PAST,FUTURE"),
    (("six", "--method", "guess"), 2, "invalid choice"),
    (("six", "--method", "dip", "--from", "soon"), 2, "not a number"),
    (("six", "--method", "dip", "--weights", "none.safetensors"), 1, "track: none.safetensors: no such file"),
    (("six", "--method", "dip", "--weights", "fake.npz"), 2, "weights are NAME.safetensors with NAME.json"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "status", "why"), REFUSED)
def test_refusals(
    words: tuple[str, ...],
    status: int,
    why: str,
    place: Path,
    tmp_path: Path,
    refusal: Callable[..., Any],
) -> None:
    out = tmp_path / "out.npz"
    code, said = refusal("track", place / f"{words[0]}.npz", "-o", out, *words[1:])
    assert code == status and why in said
    assert list(tmp_path.iterdir()) == []


def test_a_window_is_that_of_the_recording_and_of_solve(
    place: Path, tmp_path: Path, answer: Callable[..., Any], refusal: Callable[..., Any]
) -> None:
    recording = replace(files.recording(place / "six.npz"), start_s=100.0)
    assert FORMAT.write is not None
    FORMAT.write(tmp_path / "rec.npz", recording)
    FORMAT.write(tmp_path / "cut.npz", recording.slice(6, 21))
    words = ("--method", "dip", "--weights", place / "dip.safetensors")
    for source, window in (("rec", ("--from", "100.1", "--to", "100.35")), ("cut", ())):
        out = ("-o", tmp_path / f"{source}-out.npz")
        said = answer("track", tmp_path / f"{source}.npz", *out, *words, *window)
        assert said["frames"] == 15
    a, b = (files.motion(tmp_path / f"{n}-out.npz") for n in ("rec", "cut"))
    np.testing.assert_allclose(a.R_parent_joint, b.R_parent_joint, atol=1e-12)
    assert a.start_s == b.start_s == pytest.approx(100.1)
    later = (*words, "--from", "100.5")
    code, said = refusal("track", tmp_path / "rec.npz", "-o", tmp_path / "o.npz", *later)
    assert code == 1 and "runs from 100 s to 100.5 s" in said


def test_weights_of_the_other_network_are_refused(
    place: Path, tmp_path: Path, refusal: Callable[..., Any]
) -> None:
    weights = place / "imuposer.safetensors"
    words = ("--method", "dip", "--weights", weights)
    code, said = refusal("track", place / "six.npz", "-o", tmp_path / "o.npz", *words)
    assert code == 1 and f"poser track: {weights}: weights of imuposer, expected dip" in said


def test_weights_without_their_description_are_named(
    place: Path, tmp_path: Path, refusal: Callable[..., Any]
) -> None:
    lone = tmp_path / "lone.safetensors"
    lone.write_bytes((place / "dip.safetensors").read_bytes())
    words = ("--method", "dip", "--weights", lone)
    code, said = refusal("track", place / "six.npz", "-o", tmp_path / "o.npz", *words)
    assert code == 1 and f"poser track: {lone}: its description lone.json is not beside it" in said


def test_interrupted_leaves_nothing(
    place: Path, tmp_path: Path, refusal: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mocap.estimator.replay", interrupt)
    words = ("--method", "dip", "--weights", place / "dip.safetensors")
    code, said = refusal("track", place / "six.npz", "-o", tmp_path / "o.npz", *words)
    assert code == 130 and "interrupted" in said
    assert list(tmp_path.iterdir()) == []


def test_every_stand_in_is_on_the_same_bone() -> None:
    assert estimators.stand_in("left_wrist", sensors.SIX) == "left_forearm"
    assert estimators.stand_in("right_forearm", sensors.FIVE) == "right_wrist"
    assert estimators.stand_in("left_pocket", sensors.SUIT) == "left_thigh"
    assert estimators.stand_in("left_wrist", sensors.SUIT) == "left_forearm"
    assert estimators.stand_in("pelvis", sensors.FIVE) is None
    assert estimators.stand_in("head", ("nose", "head")) == "head"
    assert estimators.used("dip", sensors.SUIT) == dict(zip(sensors.SIX, sensors.SIX, strict=True))
    for network in estimators.NETWORKS:
        for place, sensor in estimators.used(network, sensors.SUIT).items():
            assert sensors.lookup(place).joint == sensors.lookup(sensor).joint


def test_what_is_worn_at_once() -> None:
    recording = handed_over()
    found = estimators.used("imuposer", recording.sensors)
    three = set(estimators.at_once("imuposer", found, recording))
    assert len(found) == 4 and three in ({"left_wrist", "left_pocket", "head"},
                                         {"left_wrist", "right_pocket", "head"})  # fmt: skip
    # An orientation decides: a sample of acceleration alone says nothing of where a device is.
    R = np.array(recording.R_world_bone)
    valid = np.ones_like(recording.valid)
    R[~recording.valid] = np.nan
    half = replace(recording, R_world_bone=R, acc_world=np.ones(R.shape[:3]), valid=valid)
    assert half.valid.all() and len(estimators.at_once("imuposer", found, half)) == 3
    assert (
        estimators.at_once("imuposer", found, replace(recording, valid=np.zeros_like(valid))) == {}
    )
    # Of sets of three, the one that IMUPoser is not trained on is the one to be told.
    pockets = ("left_pocket", "right_pocket", "head")
    valid = np.zeros_like(valid)
    valid[:9, [0, 1, 3]], valid[9:, 1:] = True, True
    assert set(estimators.at_once("imuposer", found, replace(recording, valid=valid))) == set(
        pockets
    )
    # Samples that take turns: all five are worn, though no row has them all.
    turns = all_five()
    valid = np.zeros((len(turns), 5), bool)
    valid[::2, :3], valid[1::2, 3:] = True, True
    turns = replace(turns, valid=valid)
    assert (
        len(estimators.at_once("imuposer", estimators.used("imuposer", sensors.FIVE), turns)) == 5
    )
    assert estimators.everyday("imuposer", sensors.FIVE, turns) == (
        "left_wrist",
        "right_pocket",
        "head",
    )
    # A device that sends every two seconds is not there in between.
    valid[:] = False
    valid[:, :3], valid[::50, 3] = True, True
    rare = estimators.at_once(
        "imuposer", estimators.used("imuposer", sensors.FIVE), replace(turns, valid=valid)
    )
    assert len(rare) == 4  # but for the half second after each sample it is
    # Without a recording (of sensors from the network) all are taken for worn together.
    assert estimators.everyday("imuposer", sensors.FIVE) == ("left_wrist", "right_pocket", "head")
    assert estimators.everyday("imuposer", pockets) == pockets


def test_networks_of_methods() -> None:
    assert estimators.network_of("hybrid") == "dip"
    assert estimators.network_of("hybrid", "imuposer") == "imuposer"
    assert estimators.network_of("hybrid-imuposer") == "imuposer"
    assert estimators.network_of("imuposer-adam") == "imuposer"
    assert estimators.network_of("dip", "dip") == "dip"
    for wrong in (("dip", "imuposer"), ("hybrid-dip", "imuposer"), ("sip", None), ("dip", "lstm")):
        with pytest.raises(PoserError, match=r"unknown|runs the network"):
            estimators.network_of(*wrong)


def test_all_five_places_may_be_given_where_devices_come_and_go(place: Path) -> None:
    weights = place / "imuposer.safetensors"
    made = estimators.make(
        "imuposer", 30.0, sensors.FIVE, weights=weights, skeleton=Skeleton.default(1.5)
    )
    assert made.sensors == sensors.FIVE
    with pytest.raises(PoserError, match="window"):
        estimators.make("imuposer", 30.0, sensors.FIVE, weights=weights, window=(20, 5))


@pytest.mark.parametrize("rate_hz", [25.0, 60.0])
@pytest.mark.parametrize("method", ["imuposer", "imuposer-adam", "hybrid"])
def test_a_stream_before_its_first_device(method: str, rate_hz: float, place: Path) -> None:
    """Each sample has its pose; those that could not wait for a device say so, no other does."""
    made = estimators.make(
        method,
        rate_hz,
        ("left_wrist", "head"),
        network="imuposer",
        weights=place / "imuposer.safetensors",
    )
    late, ahead = 30, made.look_ahead_frames
    rec = synthesis.recording(motions.walk(3.0, rate_hz), made.sensors, synthesis.NOISES["none"], 0)
    rows = list(samples(rec.slice(1, 70)))
    state, poses = made.init(), []
    for k, row in enumerate(rows):
        state, pose = made.step(state, replace(row, valid=row.valid & (k >= late)))
        assert (pose is None) == (k < ahead)
        poses += [pose] if pose is not None else []
    unknown = ["no pose yet" in p.note for p in poses]
    first = unknown.index(False)
    assert late - ahead <= first <= late and not any(unknown[first:])
    for pose in poses:
        assert np.isfinite(pose.R_parent_joint).all()
    # Those that waited are the first answer's, not on a way to it from the T-pose. What refines a pose has no
    # measurement of their time.
    R = np.stack([p.R_parent_joint for p in poses])
    assert np.ptp(R[first:late], axis=0).max(initial=0) < 1e-3 if ahead else first == late
    if method == "imuposer":
        assert np.abs(R[first:late] - R[late]).max(initial=0) < 1e-5
    assert np.abs(R[0] - R[late]).max() > 0.3


def test_the_hybrid_and_adam_know_where_the_recordings_sensors_sit(place: Path) -> None:
    recording = files.recording(place / "five.npz")
    names = ("right_wrist", "head", "left_wrist")
    recording = replace(recording.select(names), joint=np.array([18, 15, 19]), placement=None)
    recording = replace(recording, placement=np.arange(9).reshape(3, 3) / 10)
    given = {"weights": place / "imuposer.safetensors", "network": "imuposer"}
    for joint, seat in ((recording.joint, recording.placement), (None, None)):
        hybrid = estimators.make("hybrid", 25.0, names, **given, joint=joint, seat=seat)  # type: ignore[arg-type]
        adam = estimators.make("imuposer-adam", 25.0, names, **given, joint=joint)  # type: ignore[arg-type]
        assert isinstance(hybrid, Tracker) and isinstance(adam, AdamEstimator)
        assert hybrid.sensors == adam.sensors == ("left_wrist", "right_wrist", "head")
        # In the network's order, which is not the recording's.
        own = [19, 18, 15] if joint is not None else [18, 19, 15]
        assert list(adam.joint) == list(hybrid.refinement.worn.joint) == own
        table = sensors.joints_and_seats(hybrid.sensors)[1]
        seats = recording.placement[[2, 0, 1]] if seat is not None else table
        np.testing.assert_array_equal(hybrid.refinement.kinematics.seat, seats)
    with pytest.raises(PoserError, match="no limb"):
        tracking.track(
            replace(recording, joint=np.array([9, 15, 19])), "imuposer-adam", "imuposer",
            weights=given["weights"],
        )  # fmt: skip
    moved = replace(recording, joint=np.array([19, 15, 18]))
    a, b = (
        tracking.track(r, "hybrid", "imuposer", weights=given["weights"]).run.motion
        for r in (recording, moved)
    )
    assert np.abs(a.R_parent_joint - b.R_parent_joint).max() > 0.1


def test_windows_as_words() -> None:
    assert track.window("50, 5") == (50, 5)


def test_the_command_line_is_light() -> None:
    heavy = "('torch', 'osqp', 'casadi')"
    code = f"import sys, poser.commands.track; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize(("name", "network"), [("six", "dip"), ("five", "imuposer")])
def test_a_tracker_from_python_is_the_command_lines(
    name: str, network: str, place: Path, tmp_path: Path
) -> None:
    weights, out = place / f"{network}.safetensors", tmp_path / "out.npz"
    line = ["--method", "hybrid", "--network", network, "--weights", str(weights)]
    assert main(["track", str(place / f"{name}.npz"), "-o", str(out), *line]) == 0
    recording = files.recording(place / f"{name}.npz")
    names = sensors.SIX if network == "dip" else ("left_wrist", "right_pocket", "head")
    own = Tracker(learned.estimator(network, recording.rate_hz, names, weights=weights))
    run = replay(own, recording)
    assert own.settings == TrackerSettings.around(own.network)
    assert (own.settings != TrackerSettings()) == (network == "imuposer")
    off = ori.angle_between(files.motion(out).R_parent_joint, run.motion.R_parent_joint)
    assert off.max() < 1e-6
