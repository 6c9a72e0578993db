"""Callers in Python: what is no number, or none that can be, is refused with the field's name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import learned
import sip
from hybrid import Tracker
from hybrid.motion_filter import FilterNoise
from hybrid.settings import TrackerSettings
from learned.training.settings import TrainSettings
from mocap import calibration, synthesis
from mocap.errors import PoserError
from mocap.evaluation import metrics
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from sip.horizon import HorizonSettings
from sip.settings import Settings

BAD = (float("nan"), -1.0, "1", 1j, None, True, [1.0])
FIELDS: list[tuple[Callable[..., Any], str]] = [
    (synthesis.Noise, "acc_white"), (synthesis.Noise, "tissue_s"), (FilterNoise, "bias"),
    (TrackerSettings, "step_sigma_deg"), (TrackerSettings, "network_sigma_deg"),
    (HorizonSettings, "walk_bias"), (HorizonSettings, "steps"), (Settings, "sigma_mounting"),
    (Settings, "prior_weight"), (Settings, "window"), (TrainSettings, "learning_rate"),
    (TrainSettings, "batch"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "name"), FIELDS)
@pytest.mark.parametrize("value", [*BAD, float("inf")])
def test_settings(kind: Callable[..., Any], name: str, value: Any) -> None:
    with pytest.raises(PoserError, match=name):
        kind(**{name: value})


@pytest.mark.parametrize(
    ("kind", "name"),
    [(Settings, "uncertainty"), (TrackerSettings, "spine"), (TrainSettings, "bfloat16")],
)
def test_truth_values(kind: Callable[..., Any], name: str) -> None:
    with pytest.raises(PoserError, match=name):
        kind(**{name: "no"})


def test_wrong_classes() -> None:
    for name in ("start", "prior"):
        with pytest.raises(PoserError, match=name):
            Settings(**{name: 3})  # type: ignore[arg-type]
    motion = motions.builtin(seconds=1.0)
    with pytest.raises(PoserError, match="skeleton"):
        replace(motion, skeleton=None)  # type: ignore[arg-type]
    for other in (None, "walk.npz"):
        with pytest.raises(PoserError, match="prediction"):
            metrics.evaluate(other, motion)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [None, 3, "walk.npz"])
def test_entrances_name_what_they_were_given(value: Any) -> None:
    motion = motions.builtin(seconds=1.0)
    recording = synthesis.recording(motion)
    calls: dict[str, Callable[[], Any]] = {
        "solve: recording": lambda: sip.solve(value),
        "evaluate: recording": lambda: metrics.evaluate(motion, motion, recording=value or 3),
        "Tracker: network": lambda: Tracker(value),
        "stream: model": lambda: learned.stream(value, 60.0),
        "sensors": lambda: replace(recording, sensors=value),
        "valid": lambda: replace(recording, valid=value or 3),
        "trusted": lambda: replace(motion, trusted=value or 3),
    }
    for name, call in calls.items():
        with pytest.raises(PoserError, match=name):
            call()


@pytest.mark.parametrize(
    "value", ["x", 1j, np.nan, [[1.0], [1.0, 2.0]], 10**400, torch.zeros(2, device="meta")]
)
def test_operations_name_what_they_were_given(value: Any) -> None:
    motion = motions.builtin(seconds=1.0)
    recording, raw = synthesis.recording(motion), synthesis.raw_recording(motion)
    rest, body = np.zeros((1, 72)), motion.skeleton
    calls: dict[str, Callable[[], Any]] = {
        "poses": lambda: Motion.from_smpl(60.0, value, np.zeros((1, 3)), body),
        "trans": lambda: Motion.from_smpl(60.0, rest, value, body),
        "from_smpl: skeleton": lambda: Motion.from_smpl(60.0, rest, np.zeros((1, 3)), value),
        "cutoff_hz": lambda: motion.lowpassed(value),
        "Motion.turned: yaw": lambda: motion.turned(value),
        "Recording.turned: yaw": lambda: recording.turned(value),
        "renamed: mapping": lambda: raw.renamed(value),
        "facing_rad": lambda: replace(raw, facing_rad=value),
        "common_heading": lambda: replace(raw, common_heading=value),
        "truth": lambda: replace(raw, truth=value),
        "noise": lambda: replace(recording, noise=value),
        "calibrate: raw": lambda: calibration.calibrate(value),
        "calibrate: at": lambda: calibration.calibrate(raw, at=value),
        "calibrate: facing": lambda: calibration.calibrate(raw, facing=value),
        "virtual sensors: motion": lambda: synthesis.recording(value),
        "virtual sensors: noise": lambda: synthesis.recording(motion, noise=value),
    }
    for name, call in calls.items():
        with pytest.raises(PoserError, match=name):
            call()


@pytest.mark.parametrize("value", [None, 3, "head"])
def test_sensors_are_several_names(value: Any) -> None:
    motion = motions.builtin(seconds=1.0)
    for call in (synthesis.recording(motion).select, lambda v: synthesis.recording(motion, v)):
        with pytest.raises(PoserError, match="must be several names"):
            call(value)


def test_a_slice_from_the_end_keeps_its_time() -> None:
    motion = motions.builtin(seconds=1.0)
    recording, raw = synthesis.recording(motion), synthesis.raw_recording(motion)
    for whole in (motion, recording, raw):
        for start, stop in ((-10, len(whole)), (-10_000, 5), (len(whole) - 10, len(whole))):
            first = max(0, start % len(whole) if start > -len(whole) else 0)
            assert whole.slice(start, stop).start_s == pytest.approx(first / whole.rate_hz)


def test_tensors_without_numbers() -> None:
    """Torch's device meta has shapes alone, and a tensor that needs gradients gives its numbers to none."""
    recording = synthesis.recording(motions.builtin(seconds=1.0))
    for name in ("R_world_bone", "acc_world", "valid", "joint", "placement"):
        shape = getattr(recording, name).shape
        with pytest.raises(PoserError, match=rf"{name} must be .*meta"):
            replace(recording, **{name: torch.zeros(shape, device="meta")})
    with pytest.raises(PoserError, match=r"acc_world must be .*grad"):
        replace(recording, acc_world=torch.zeros(recording.acc_world.shape, requires_grad=True))
    with torch.device("meta"):
        model = learned.build(learned.for_network("imuposer"))
    with pytest.raises(PoserError, match="meta"):
        learned.stream(model, 60.0)


def test_spoiled_rotations_are_counted_and_invalid() -> None:
    recording = synthesis.recording(motions.builtin(seconds=1.0))
    R = np.array(recording.R_world_bone)
    R[3, 0], R[5:7, 2] = 0.0, 2 * np.eye(3)
    found = replace(recording, R_world_bone=R)
    assert found.no_rotation.tolist() == [1, 0, 2, 0, 0, 0]
    assert (recording.valid & ~found.valid).sum() == 3
    assert np.isnan(found.R_world_bone[3, 0]).all() and np.isnan(found.acc_world[5, 2]).all()
    assert replace(found, valid=None).no_rotation.sum() == 0
    with pytest.raises(PoserError, match=r"left-handed .* as are 58 of 58"):
        replace(recording, R_world_bone=np.swapaxes(R, -1, -2) @ np.diag([1.0, 1.0, -1.0]))


@pytest.mark.parametrize("value", [None, "abc", [[1.0], [1.0, 2.0]]])
def test_arrays(value: Any) -> None:
    with pytest.raises(PoserError, match="R_parent_joint"):
        Motion(60.0, value, np.zeros((1, 3)), Skeleton.default())
    with pytest.raises(PoserError, match="R_world_bone"):
        Recording(60.0, ("head",), value, np.zeros((1, 1, 3)))
    with pytest.raises(PoserError, match="acc"):
        RawRecording(60.0, ("head",), np.zeros((1, 1, 3)), value)


def test_complex_arrays() -> None:
    with pytest.raises(PoserError, match=r"R_world_bone .*complex"):
        Recording(60.0, ("head",), np.eye(3)[None, None] + 0j, np.zeros((1, 1, 3)))


@pytest.mark.parametrize("value", [np.nan, np.inf, "0", None, 1j])
def test_times(value: Any) -> None:
    with pytest.raises(PoserError, match="start_s"):
        Recording(60.0, ("head",), np.eye(3)[None, None], np.zeros((1, 1, 3)), start_s=value)
    with pytest.raises(PoserError, match="rate_hz"):
        Recording(value, ("head",), np.eye(3)[None, None], np.zeros((1, 1, 3)))


def test_motions_of_other_times_are_not_compared() -> None:
    motion = motions.builtin(seconds=1.0)
    later = replace(motion, start_s=5.0)
    with pytest.raises(PoserError, match=r"starts at 5 s.* 7 s"):
        metrics.evaluate(later, replace(motion, start_s=7.0))
    assert metrics.evaluate(later, replace(motion, start_s=5.01)).sip_deg == 0
    assert metrics.evaluate(later, motion).sip_deg == 0  # nobody says when it was
    recording = replace(synthesis.recording(motion), start_s=9.0, reference=None)
    with pytest.raises(PoserError, match=r"recording at 9 s"):
        metrics.evaluate(later, None, recording=recording, seen=("head",))
