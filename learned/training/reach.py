"""How many frames of layer 2 an emitted frame needs: a property of the weights, measured once they are there.

`learned.runtime` may begin layer 2 some frames before the emitted one. What that changes depends on what the
network has learnt: of two trainings of IMUPoser, 40 frames cost one 0.35 degrees and the other 2.3. The
number is therefore measured on validation windows when weights are exported, and stands in their description.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from learned import devices, runtime
from learned import kinematics as kin
from learned.features import dip_pose, imuposer_input, imuposer_pose
from learned.models import Dip, Model
from learned.training.validation import Windowed

NEARLY_DEG = 0.5  # of the worst joint, mean over windows: what "nearly exact" means here
REACHES = (20, 40, 60, 80)
MOST_WINDOWS = 60


def inputs(model: Model, windows: Windowed, most: int = MOST_WINDOWS) -> Tensor:
    """Inputs (N,T,D) of at most so many windows, evenly over all of them."""
    pick = np.unique(
        np.linspace(0, len(windows.clip) - 1, min(most, len(windows.clip))).astype(int)
    )
    R, acc = windows.R_world_bone[pick], windows.acc_world[pick]
    if isinstance(model, Dip):
        return model.inputs(R, acc)[0]
    return imuposer_input(R, acc, devices.in_turn(0, windows.there[pick]))


def pose_of(model: Model, way: runtime.Runtime, features: Tensor) -> Tensor:
    """Global rotations (24,3,3), the pelvis of DIP upright."""
    if isinstance(model, Dip):
        out = runtime.gaussian(model, way, features).pose
        return kin.rotations(dip_pose(model.output_scaler.unscale(out), torch.eye(3)))
    return kin.rotations(imuposer_pose(runtime.pose_numbers(model, way, features)))


@torch.inference_mode()
def differences(
    model: Model, x: Tensor, emit: int, reaches: Sequence[int]
) -> dict[int, tuple[float, float]]:
    """By reach: mean and worst over windows of the worst joint's angle, deg, against the whole window."""
    ways = {n: runtime.prepare(model, reach=n) for n in reaches}
    plain = runtime.Plain(model)
    off: dict[int, list[float]] = {n: [] for n in reaches}
    for window in x:
        whole = pose_of(model, plain, plain.features(plain.rows(window), emit))
        for n, way in ways.items():
            found = pose_of(model, way, way.features(way.rows(window), emit))
            off[n].append(float(torch.rad2deg(kin.angle_between(found, whole)).max()))
    return {n: (float(np.mean(v)), max(v)) for n, v in off.items()}


def measured(model: Model, windows: Windowed) -> dict[str, float | int]:
    """For the description: `reach_frames`, the least that is nearly exact, and its `reach_mean_deg` and
    `reach_worst_deg`; empty where none is, or where the window is shorter anyway.
    """
    frames = windows.R_world_bone.shape[1]
    longest = max(windows.emit, frames - 1 - windows.emit)
    reaches = [n for n in REACHES if n < longest]
    if not reaches or isinstance(runtime.prepare(model), runtime.Plain):
        return {}
    found = differences(model, inputs(model, windows), windows.emit, reaches)
    for n, (mean, worst) in found.items():
        if mean <= NEARLY_DEG:
            return {"reach_frames": n, "reach_mean_deg": mean, "reach_worst_deg": worst}
    return {}
