"""Two predictions that need no skill, the rows that every table is read against.

The mean pose of the training motion, and the training pose whose sensors are oriented to each other most
nearly as those measured. A method that does not clearly beat both has not worked. Neither says anything
about where the body is: the pelvis stays at its rest place.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap import orientation as ori
from mocap.errors import ShapeError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton

CHUNK = 512  # frames compared with the bank at a time


def both(
    recording: Recording, mean: ArrayLike, poses: ArrayLike, skeleton: Skeleton | None = None
) -> dict[str, Motion]:
    """The two rows under their names in every table: "mean-pose" and "nearest-pose"."""
    return {
        "mean-pose": mean_pose(recording, mean, skeleton),
        "nearest-pose": nearest_pose(recording, poses, skeleton),
    }


def mean_pose(recording: Recording, mean: ArrayLike, skeleton: Skeleton | None = None) -> Motion:
    """Every frame in the pose `mean`: 69 axis-angle numbers, rad, of joints 1 to 23.

    The root's orientation is measured (see `_root`). Raises ShapeError where `mean` is not (69,).
    """
    bank = _bank(np.asarray(mean, float)[None], "mean")
    return _posed(recording, bank, np.zeros(len(recording), np.int64), skeleton)


def nearest_pose(
    recording: Recording, poses: ArrayLike, skeleton: Skeleton | None = None
) -> Motion:
    """Each frame in the pose of the bank `poses` (N,69) rad that fits its sensors best.

    The fit is over all pairs of valid sensors: sum |R_a^T R_b - B_a^T B_b|^2 (Frobenius), which no turn
    of the whole body changes. A frame with fewer than two valid sensors keeps the choice before it.
    """
    bank = _bank(np.asarray(poses, float), "poses")
    joint = recording.joint
    pairs = list(combinations(range(len(recording.sensors)), 2))
    choice = np.zeros(len(recording), np.int64)
    if not pairs:
        return _posed(recording, bank, choice, skeleton)
    a, b = np.array(pairs).T
    G = _rotations(bank, skeleton)
    features = _relative(G[:, joint[a]], G[:, joint[b]])
    valid = recording.ori_valid
    both = valid[:, a] & valid[:, b]
    for start in range(0, len(recording), CHUNK):
        cut = slice(start, start + CHUNK)
        R = np.where(valid[cut, :, None, None], recording.R_world_bone[cut], 0.0)
        measured = _relative(R[:, a], R[:, b])
        # Rotations have constant norm, so the least distance over the valid pairs is the largest inner
        # product over them; the zeros of invalid samples drop out of it.
        choice[cut] = np.argmax(measured @ features.T, axis=1)
    return _posed(recording, bank, _held(choice, both.any(axis=1)), skeleton)


def _bank(poses: Array, what: str) -> Array:
    """Local rotations (N,24,3,3), root identity, of axis-angle poses (N,69) rad."""
    if poses.ndim != 2 or poses.shape[1] != 69 or len(poses) == 0 or not np.isfinite(poses).all():
        raise ShapeError(f"{what} must hold finite poses of 69 numbers, got shape {poses.shape}")
    R = np.tile(np.eye(3), (len(poses), 24, 1, 1))
    R[:, 1:] = ori.exp(poses.reshape(-1, 23, 3))
    return R


def _rotations(bank: Array, skeleton: Skeleton | None) -> Array:
    return (skeleton or Skeleton.default()).rotations(bank)


def _relative(A: Array, B: Array) -> Array:
    """A^T B of (...,P,3,3), flattened to (...,9P)."""
    R = np.swapaxes(A, -1, -2) @ B
    return R.reshape(len(R), -1)


def _held(x: NDArray[np.int64], known: Any) -> NDArray[np.int64]:
    """x with unknown entries taken from the last known one before them (the first known at the start)."""
    at = np.flatnonzero(known)
    if not len(at):
        return x
    before = np.clip(np.searchsorted(at, np.arange(len(x)), side="right") - 1, 0, None)
    return x[at[before]]


def _posed(
    recording: Recording, bank: Array, choice: NDArray[np.int64], skeleton: Skeleton | None
) -> Motion:
    body = skeleton or Skeleton.default()
    R = bank[choice]
    R[:, 0] = _root(recording, body.rotations(R))
    p = np.tile(body.offsets[0], (len(recording), 1))
    return Motion(recording.rate_hz, R, p, body, recording.start_s)


def _root(recording: Recording, rotations: Array) -> Array:
    """R_world_root (T,3,3): what the pelvis sensor measured, else the rotation that best turns the pose
    onto all valid sensors, project(sum_s R_s B_s^T). A frame without any keeps its neighbour's."""
    T = len(recording)
    valid = recording.ori_valid
    R = np.tile(np.eye(3), (T, 1, 1))
    use = [s for s in range(len(recording.sensors)) if recording.joint[s] == 0]
    if not valid[:, use].any():
        use = list(range(len(recording.sensors)))
    B = rotations[:, recording.joint[use]]
    measured = np.where(valid[:, use, None, None], recording.R_world_bone[:, use], 0.0)
    known: Any = valid[:, use].any(axis=1)
    total = np.einsum("tsij,tskj->tik", measured, B)
    R[known] = ori.project(total[known])
    return R[_held(np.arange(T), known)]
