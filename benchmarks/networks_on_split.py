"""Networks on the fixed split: recordings of its clips, what a network makes of them, and the figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
import torch

from learned.dip.network import Gaussian
from learned.models import Dip, Imuposer, Model
from learned.training import validation
from mocap import Motion, Recording, dataset
from mocap import orientation as ori
from mocap.evaluation import metrics
from mocap.synthesis import Noise

MOST_CLIPS: int | None = None  # of a split: for trying things out
FIGURES = ("sip_deg", "angular_deg", "local_angular_deg", "position_cm", "jitter")
# Joints of a region, the device on it (index into FIVE) and the one on its other side.
REGIONS: dict[str, tuple[tuple[int, ...], int, int | None]] = {
    "left arm": ((16, 18, 20, 22), 0, 1),
    "right arm": ((17, 19, 21, 23), 1, 0),
    "left leg": ((1, 4, 7, 10), 2, 3),
    "right leg": ((2, 5, 8, 11), 3, 2),
    "head and neck": ((12, 15), 4, None),
}


@cache
def recorded(split: dataset.Split, network: str, noise: Noise) -> tuple[Recording, ...]:
    """Virtual sensors on the CMU clips of a split, 2 s or longer, cut to 15 s."""
    clips = ((c.name, c.motion(None)) for c in dataset.select(split, ("cmu",)))
    found = [r for r in validation.recordings(network, clips, noise) if r.seconds >= 2]
    return tuple(found[:MOST_CLIPS])


def dip_motions(
    model: Model, recordings: Sequence[Recording], window: tuple[int, int] | None, stride: int = 1
) -> list[Motion]:
    """DIP's motion of each recording: the whole at once (window None), or (past, future) frames each."""
    assert isinstance(model, Dip)
    if window is not None:
        windows = validation.cut(recordings, *window, stride)
        poses, _ = validation.predict(model, windows)
        return [
            _motion(r, poses[torch.as_tensor(windows.clip == i)], stride)
            for i, r in enumerate(recordings)
        ]
    out = []
    with torch.inference_mode():
        for r in recordings:
            R, acc = (torch.as_tensor(x, dtype=torch.float32)[None] for x in validation.held(r))
            found: Gaussian = model(model.inputs(R, acc)[0])
            out.append(_motion(r, model.pose(found, R[:, :, 5])[0]))
    return out


def imuposer_motions(
    model: Model, recordings: Sequence[Recording], combination: Sequence[int], stride: int = 1
) -> list[Motion]:
    """IMUPoser's motion of each recording, online: each frame the last of its 125."""
    assert isinstance(model, Imuposer)
    out = []
    with torch.inference_mode():
        for r in recordings:
            windows = validation.cut([r], *validation.SEEN["imuposer"], stride)
            out.append(_motion(r, validation.imuposer_poses(model, windows, combination), stride))
    return out


def _motion(recording: Recording, poses: torch.Tensor, stride: int = 1) -> Motion:
    assert recording.reference is not None
    R = ori.project(poses.double().numpy())
    p = recording.reference.p_world_root[::stride]
    return Motion(recording.rate_hz / stride, R, p, recording.reference.skeleton)


def _pairs(
    motions: Sequence[Motion], recordings: Sequence[Recording], stride: int = 1
) -> Iterator[tuple[Motion, Motion]]:
    for motion, recording in zip(motions, recordings, strict=True):
        true = recording.reference
        assert true is not None
        yield (
            motion,
            Motion(
                motion.rate_hz,
                true.R_parent_joint[::stride],
                true.p_world_root[::stride],
                true.skeleton,
                trusted=None if true.trusted is None else true.trusted[::stride],
            ),
        )


def measured(
    motions: Sequence[Motion], recordings: Sequence[Recording], stride: int = 1
) -> dict[str, float]:
    """Means over clips of per-clip means; jitter only where no frame is left out."""
    each = [metrics.evaluate(m, true) for m, true in _pairs(motions, recordings, stride)]
    found = metrics.mean_over(each)
    names = FIGURES if stride == 1 else FIGURES[:-1]
    return {name: float(getattr(found, name)) for name in names}


def local_angles(motions: Sequence[Motion], recordings: Sequence[Recording]) -> np.ndarray:
    """Local angles in deg of DIP's 15 joints, all frames of all clips."""
    joints = list(metrics.DIP_JOINTS)
    return np.concatenate([
        np.rad2deg(ori.angle_between(m.R_parent_joint[:, joints], t.R_parent_joint[:, joints])).ravel()
        for m, t in _pairs(motions, recordings)
    ])  # fmt: skip


def joint_cm(
    motions: Sequence[Motion], recordings: Sequence[Recording], stride: int = 1
) -> np.ndarray:
    """Mean distance (24,) in cm, pelvis positions aligned, nothing masked: IMUPoser shows hands, feet."""
    out = []
    for m, true in _pairs(motions, recordings, stride):
        a, b = (x.p_world_joint - x.p_world_joint[:, :1] for x in (m, true))
        out.append(100 * np.linalg.norm(a - b, axis=-1).mean(axis=0))
    return np.mean(out, axis=0)
