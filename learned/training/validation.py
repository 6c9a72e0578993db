"""How good a network is on recordings it was not trained on, as it will be used online.

Every emitted frame sees the window that the online runner would show it; figures are those of
`mocap.evaluation.metrics` on those frames, in torch so that a whole set takes seconds.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from learned import devices
from learned import kinematics as kin
from learned.features import dip_target, imuposer_input, imuposer_pose
from learned.models import RATES, Dip, Model
from learned.training import losses
from learned.training.corpus import prepared
from mocap import sensors as places
from mocap import synthesis
from mocap.errors import PoserError
from mocap.evaluation.metrics import MASKED, SIP_JOINTS
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.synthesis import Noise

SEEN = {"dip": (20, 5), "imuposer": (124, 0)}  # past and future frames that the online runner shows
MOST_WINDOWS = {"dip": 1500, "imuposer": 360}  # of a validation set: seconds of work on a CPU
LONGEST_S = 15.0
CHUNK = 256  # windows at a time


@dataclass(frozen=True)
class Windowed:
    """N windows cut from recordings: (N,T,S,...) sensors, and the truth (N,T,24,3,3) of every frame.

    emit: the frame of each window that the network answers for. clip (N,): where it was cut from. there
    (N,S): the sensors that are worn at that frame (`learned.devices.there`).
    """

    R_world_bone: Tensor
    acc_world: Tensor
    R_parent_joint: Tensor
    emit: int
    clip: np.ndarray
    there: Tensor

    def only(self, which: Tensor) -> Windowed:
        """Those of the windows where `which` (N,) is true."""
        if which.all():
            return self
        return Windowed(
            self.R_world_bone[which], self.acc_world[which], self.R_parent_joint[which], self.emit,
            self.clip[which.numpy()], self.there[which],
        )  # fmt: skip


def held(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """R_world_bone and acc_world with invalid samples replaced by the last valid ones.

    Before a sensor's first valid sample: that one; identity and zero for a sensor that has none.
    """
    T, S = recording.valid.shape
    R = np.array(recording.R_world_bone)
    acc = np.array(recording.acc_world)
    for values, ok, empty in (
        (R, recording.ori_valid, np.eye(3)),
        (acc, recording.acc_valid, np.zeros(3)),
    ):
        index = np.where(ok, np.arange(T)[:, None], -1)
        index = np.maximum.accumulate(index, axis=0)
        index = np.where((index < 0) & ok.any(axis=0), ok.argmax(axis=0), index)
        taken = values[np.maximum(index, 0), np.arange(S)]
        values[...] = np.where((index < 0).reshape(T, S, *[1] * (values.ndim - 2)), empty, taken)
    return R, acc


def cut(recordings: Iterable[Recording], past: int, future: int, stride: int = 1) -> Windowed:
    """Windows of `past` + 1 + `future` frames around every `stride`-th frame; ends are repeated."""
    Rs, accs, truths, clips, worn = [], [], [], [], []
    for i, recording in enumerate(recordings):
        assert recording.reference is not None
        R, acc = held(recording)
        at = np.arange(0, len(recording), stride)[:, None] + np.arange(-past, future + 1)
        at = np.clip(at, 0, len(recording) - 1)
        Rs.append(R[at].astype(np.float32))
        accs.append(acc[at].astype(np.float32))
        truths.append(recording.reference.R_parent_joint[at].astype(np.float32))
        clips.append(np.full(len(at), i))
        worn.append(devices.there(recording)[::stride])
    return Windowed(
        torch.as_tensor(np.concatenate(Rs)),
        torch.as_tensor(np.concatenate(accs)),
        torch.as_tensor(np.concatenate(truths)),
        past,
        np.concatenate(clips),
        torch.as_tensor(np.concatenate(worn)),
    )


def recordings(
    network: str, clips: Iterable[tuple[str, Motion]], noise: Noise | None = None
) -> list[Recording]:
    """Virtual sensors on named motions at the network's rate; the noise depends on the name alone.

    Motions shorter than a second are left out, longer ones cut to `LONGEST_S`. noise: default realistic.
    """
    rate, out = RATES[network], []
    for name, motion in clips:
        motion = prepared(motion).resampled(rate)
        if motion.seconds >= 1:
            motion = motion.slice(0, int(LONGEST_S * rate))
            sensors = places.FIVE if network == "imuposer" else places.SIX
            seed = zlib.crc32(name.encode())
            out.append(synthesis.recording(motion, sensors, noise or Noise(), seed))
    return out


def cut_for(network: str, recordings: Sequence[Recording], most: int | None = None) -> Windowed:
    """Windows as the network sees them online, evenly over all recordings, about `most` in all; none for a
    frame at which nothing is worn, and none for one whose truth is not trusted.

    Raises PoserError where there is no recording, or no such frame.
    """
    if not recordings:
        raise PoserError("no motion of a second or more to validate on")
    past, future = SEEN[network]
    frames = sum(len(r) for r in recordings)
    stride = max(1, round(frames / (most or MOST_WINDOWS[network])))
    windows = cut(recordings, past, future, stride)
    worn = windows.there.any(1)
    if not worn.any():
        raise PoserError("no sensor measured anything in what is to validate")
    trusted = np.concatenate([_trusted(r)[::stride] for r in recordings])
    if not (worn.numpy() & trusted).any():
        raise PoserError("no pose of what is to validate is trusted")
    return windows.only(worn & torch.as_tensor(trusted))


def _trusted(recording: Recording) -> np.ndarray:
    """(T,): the frames whose reference pose is right."""
    known = None if recording.reference is None else recording.reference.trusted
    return np.ones(len(recording), bool) if known is None else known


def predict(model: Model, windows: Windowed, reconstruct_acc: bool = True) -> tuple[Tensor, float]:
    """Local rotations (N,24,3,3) of the emitted frames, and the loss, mean over windows.

    IMUPoser wears one of its 24 combinations in each window, in turn, of those whose devices are there.
    reconstruct_acc: whether DIP's loss counts the accelerations (it must not where it did not in training:
    nothing taught those heads).
    """
    poses: list[Tensor] = []
    total = 0.0
    offsets = torch.as_tensor(np.array(Skeleton.default().offsets), dtype=torch.float32)
    with torch.inference_mode():
        for i in range(0, len(windows.clip), CHUNK):
            part = slice(i, i + CHUNK)
            R, acc = windows.R_world_bone[part], windows.acc_world[part]
            truth, t = windows.R_parent_joint[part], windows.emit
            if isinstance(model, Dip):
                x, target_acc = model.inputs(R, acc)
                out = model(x)
                target = model.output_scaler.scale(dip_target(truth))
                total += len(R) * float(losses.dip(out, target, target_acc, reconstruct_acc))
                poses.append(model.pose(out.at(t), R[:, t, 5]))
            else:
                worn = devices.in_turn(i, windows.there[part])
                y = model(imuposer_input(R, acc, worn))
                total += len(R) * float(losses.imuposer(y, truth, offsets))
                poses.append(imuposer_pose(y[:, t]))
    return torch.cat(poses), total / len(windows.clip)


def figures(poses: Tensor, windows: Windowed) -> dict[str, float]:
    """sip_deg, angular_deg, position_cm as in `evaluation.metrics`: mean over frames, then over clips."""
    truth = windows.R_parent_joint[:, windows.emit]
    a, b = (_masked(R) for R in (poses, truth))
    Ra, Rb = kin.rotations(a), kin.rotations(b)
    angle = torch.rad2deg(kin.angle_between(Ra, Rb))
    offsets = torch.as_tensor(np.array(Skeleton.default().offsets), dtype=torch.float32)
    root = torch.zeros(3)
    gap = (kin.positions(Ra, root, offsets) - kin.positions(Rb, root, offsets)).norm(dim=-1)
    out = {
        "sip_deg": angle[:, list(SIP_JOINTS)].mean(-1),
        "angular_deg": angle.mean(-1),
        "position_cm": 100 * gap.mean(-1),
    }
    clip = torch.as_tensor(windows.clip)
    return {
        name: float(torch.stack([x[clip == c].mean() for c in clip.unique()]).mean())
        for name, x in out.items()
    }


def _masked(R: Tensor) -> Tensor:
    R = R.clone()
    R[:, list(MASKED)] = torch.eye(3)
    return R


def score(model: Model, windows: Windowed, reconstruct_acc: bool = True) -> dict[str, float]:
    """The figures and the loss of a model on a set."""
    was_training = model.training
    model.eval()
    poses, loss = predict(model, windows, reconstruct_acc)
    model.train(was_training)
    return figures(poses, windows) | {"loss": loss}


def imuposer_poses(model: Model, windows: Windowed, combination: Sequence[int]) -> Tensor:
    """Local rotations (N,24,3,3) of the emitted frames with these devices worn."""
    worn = torch.zeros(5, dtype=torch.bool)
    worn[list(combination)] = True
    poses = []
    for i in range(0, len(windows.clip), CHUNK):
        R, acc = windows.R_world_bone[i : i + CHUNK], windows.acc_world[i : i + CHUNK]
        x = imuposer_input(R, acc, worn.expand(len(R), 5))
        poses.append(imuposer_pose(model(x)[:, windows.emit]))
    return torch.cat(poses)
