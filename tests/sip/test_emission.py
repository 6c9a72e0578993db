"""What is shown of a window: no tremble, no lag, no memory of what is long past."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import Skeleton, synthesis
from mocap import orientation as ori
from sip import Horizon, HorizonSettings, Settings, Shown, shown
from sip.horizon import HorizonState
from sip.model import Evidence
from tests.sip.conftest import wavy


@pytest.fixture(scope="module")
def window() -> tuple[Horizon, HorizonState]:
    recording = synthesis.recording(wavy(12), ("head", "pelvis"), synthesis.Noise(), 1)
    h = Horizon(
        Skeleton.default(), recording.joint, recording.placement, 60.0, Settings(),
        HorizonSettings(seconds=0.15, growing_steps=1),
    )  # fmt: skip
    state, evidence = h.init(), Evidence.of(recording)
    for t in range(12):
        state = h.step(state, evidence.slice(t, t + 1))
    return h, state


def test_windows_that_agree_are_shown_as_they_are(window: tuple[Horizon, HorizonState]) -> None:
    h, state = window
    before = None
    for lag in range(len(state) - 1, -1, -1):
        before = shown(h, state, lag, before)
        pose = h.pose(state, lag)
        assert np.allclose(before.R_parent_joint[-1], pose.R_parent_joint, atol=1e-12)
        assert np.allclose(before.p_world_root[-1], pose.p_world_root, atol=1e-12)


def test_a_disagreement_dies_away_as_a_critically_damped_spring(
    window: tuple[Horizon, HorizonState],
) -> None:
    h, state = window
    assert state.point is not None
    # A window that stands still, and two poses shown before it that are off by a turn and a shift.
    point = state.point
    frozen = replace(state, point=replace(point, x=np.repeat(point.x[:1], len(state), axis=0)))
    pose = h.pose(frozen, 0)
    turn, shift = np.array([0.0, 0.02, 0.0]), np.array([0.1, 0.0, 0.0])
    R = pose.R_parent_joint @ ori.exp(turn)
    fixed_root = replace(
        frozen, point=replace(frozen.point, R_ref=point.R_ref[:1].repeat(len(state), 0))
    )
    R[0] = h.pose(fixed_root, 0).R_parent_joint[0] @ ori.exp(turn)
    off = Shown(np.stack([R, R]), np.stack([pose.p_world_root + shift] * 2))
    theta, apart = np.exp(-1 / 3), []
    for _ in range(6):
        off = shown(h, fixed_root, 0, off, memory_s=3 / 60)
        apart.append(off.p_world_root[-1, 0] - pose.p_world_root[0])
        left = ori.log(h.pose(fixed_root, 0).R_parent_joint[5].T @ off.R_parent_joint[-1, 5])
        assert left == pytest.approx(turn * apart[-1] / shift[0], abs=1e-9)
    # Double pole: o_k = (1 + k (1 - theta)) theta^k o_0, for what stood still before.
    k = np.arange(1, 7)
    assert apart == pytest.approx(0.1 * (1 + k * (1 - theta)) * theta**k)
