"""Windows from real recordings with a reference: what a network is fine-tuned on.

DIP 5.1.2 fine-tunes on DIP-IMU so. A recording is brought to the network's rate first; windows are then
drawn from all recordings by length, turned about the vertical at random. IMUPoser's places that a recording
has no device at are never worn in its windows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from learned import tree as kin
from learned.online import holding
from learned.training.validation import held
from learned.training.virtual_windows import Batch
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.orientation import Array
from mocap.recording import Recording


def placed(recording: Recording, found: Mapping[str, str], wanted: tuple[str, ...]) -> Recording:
    """A recording of the places `wanted`, in this order. found: the sensor at each place that has one; the
    others are never valid."""
    T, S = len(recording), len(wanted)
    R, acc = np.full((T, S, 3, 3), np.nan), np.full((T, S, 3), np.nan)
    valid = np.zeros((T, S), bool)
    to = [wanted.index(place) for place in found]
    chosen = recording.select(tuple(found.values()))
    R[:, to], acc[:, to], valid[:, to] = chosen.R_world_bone, chosen.acc_world, chosen.valid
    return Recording(
        recording.rate_hz, wanted, R, acc, valid,
        reference=recording.reference, start_s=recording.start_s,
    )  # fmt: skip


def at_rate(recording: Recording, rate_hz: float) -> Recording:
    """The recording at another rate, its reference too; lost samples hold the last value, and are not valid.

    Orientations are interpolated geodesically. Training accelerations are second differences of positions
    at the network's rate, which is the true acceleration averaged with a triangle of half-width
    1 / rate_hz: so are these.
    """
    if recording.rate_hz == rate_hz or recording.reference is None:
        return recording
    reference = recording.reference.resampled(rate_hz)
    R, acc = held(recording)
    t = np.arange(len(recording)) / recording.rate_hz
    at = np.arange(len(reference)) / rate_hz
    nearest = np.rint(at * recording.rate_hz).astype(int).clip(0, len(recording) - 1)
    return replace(
        recording,
        rate_hz=rate_hz,
        R_world_bone=ori.interpolate(t, R, at),
        acc_world=_averaged(1.0 / recording.rate_hz, acc, at, 1.0 / rate_hz),
        valid=recording.ori_valid[nearest],
        reference=reference,
    )


def _averaged(dt: float, acc: Array, at: Array, width: float) -> Array:
    """Means (M,S,3) of acc (N,S,3), sampled every `dt` s, at times `at`, weighted with triangles of
    half-width `width` s.

    Where the samples lie further apart than the triangle reaches, it is widened to reach two of them.
    """
    width = max(width, dt)
    reach = int(np.ceil(width / dt))
    near = np.rint(at / dt).astype(int)[:, None] + np.arange(-reach, reach + 1)
    inside = (near >= 0) & (near < len(acc))
    weight = np.where(inside, np.maximum(0.0, 1 - np.abs(at[:, None] - near * dt) / width), 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.einsum("mk,mksc->msc", weight, acc[near.clip(0, len(acc) - 1)])


class Recorded:
    """Draws batches of windows from recordings that have a reference and run at the network's rate.

    A window ends where something is worn, as the online runner answers for no other frame.
    """

    def __init__(
        self, recordings: Sequence[Recording], frames: int, device: torch.device | str = "cpu"
    ) -> None:
        long = [r for r in recordings if len(r) >= frames and r.reference is not None]
        if not long:
            raise PoserError(
                f"no recording with a reference of {frames} frames or more to train on"
            )
        worn = [holding.there(r)[frames - 1 :] for r in long]  # at the end of each window
        long = [r for r, w in zip(long, worn, strict=True) if w.any()]
        if not long:
            raise PoserError(
                f"no recording to train on has a sensor that measured anything where a window of {frames} "
                "frames ends"
            )
        self.frames, self.device = frames, torch.device(device)
        self._there = [w for w in worn if w.any()]
        self._first = [np.flatnonzero(w.any(1)) for w in self._there]
        self._sensors = [held(r) for r in long]
        self._truth = [np.array(r.reference.R_parent_joint) for r in long if r.reference]
        length = np.array([len(r) for r in long], float)
        self._weight = length / length.sum()

    def draw(self, rng: np.random.Generator, count: int) -> Batch:
        """`count` windows."""
        R, acc, truth, there = [], [], [], []
        for k in rng.choice(len(self._weight), size=count, p=self._weight):
            first = int(self._first[k][rng.integers(len(self._first[k]))])
            part = slice(first, first + self.frames)
            there.append(self._there[k][first])
            R.append(self._sensors[k][0][part])
            acc.append(self._sensors[k][1][part])
            truth.append(self._truth[k][part])
        Ry = kin.rot_y(self._t(rng.uniform(-np.pi, np.pi, size=(count, 1, 1))))
        true = self._t(np.stack(truth))
        root = Ry @ true[:, :, :1]
        return Batch(
            Ry @ self._t(np.stack(R)),
            (Ry @ self._t(np.stack(acc)).unsqueeze(-1)).squeeze(-1),
            torch.cat([root, true[:, :, 1:]], 2),
            torch.as_tensor(np.stack(there), device=self.device),
        )

    def _t(self, x: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.asarray(x, np.float32), device=self.device)
