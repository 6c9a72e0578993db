"""What is shown of a window that moves: its poses, without the tremble that successive windows differ by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from sip.horizon import Horizon, HorizonState


@dataclass(frozen=True, eq=False)
class Shown:
    """The last poses that were shown, oldest first, two at most.

    R_parent_joint (k,24,3,3), p_world_root (k,3) m.
    """

    R_parent_joint: Array
    p_world_root: Array


def shown(
    horizon: Horizon,
    state: HorizonState,
    lag: int = 0,
    before: Shown | None = None,
    memory_s: float = 0.05,
) -> Shown:
    """The pose of the frame `lag` frames before the newest, to follow those of `before`, its last.

    Every new window thinks a little differently of all its frames. How what was shown differs from the
    newest window's own poses of the same frames, o = Log(R_window^T R_shown) per joint and likewise the
    root's place, dies away as a critically damped spring, both its poles at
    theta = exp(-1 / (memory_s rate)):
        o_t = 2 theta o_{t-1} - theta^2 o_{t-2},    R_shown = R_window Exp(o_t).
    So motion comes from the newest window, without lag; only what windows disagree about is low-passed.
    """
    last = max(len(state) - 1 - lag, 0)
    count = 0 if before is None else min(len(before.p_world_root), last)
    poses = [horizon.pose(state, len(state) - 1 - t) for t in range(last - count, last + 1)]
    R, p = np.stack([q.R_parent_joint for q in poses]), np.stack([q.p_world_root for q in poses])
    if before is None or not count:
        return Shown(R[-1:], p[-1:])
    R_before, p_before = before.R_parent_joint[-count:], before.p_world_root[-count:]
    turned, moved = ori.log(np.swapaxes(R[:-1], -1, -2) @ R_before), p_before - p[:-1]
    theta = math.exp(-1 / (memory_s * horizon.model.rate_hz))
    share = np.array([-(theta**2), 2 * theta] if count == 2 else [theta])
    R_now = R[-1] @ ori.exp(np.tensordot(share, turned, 1))
    p_now = p[-1] + share @ moved
    return Shown(
        np.concatenate([R_before[-1:], R_now[None]]), np.concatenate([p_before[-1:], p_now[None]])
    )
