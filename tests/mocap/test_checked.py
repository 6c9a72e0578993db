"""Callers in Python: what is no number, or none that can be, is refused with the field's name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hybrid.motion_filter import FilterNoise
from hybrid.settings import TrackerSettings
from learned.training.settings import TrainSettings
from mocap import synthesis
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
