"""Windows of virtual sensors for training, made in batches as they are needed.

The same model as `mocap.synthesis` (DIP eq. 3 and the design's realistic noise) over a whole batch at
once in torch, on motion that is augmented first. Tests compare the two on clean windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from learned import kinematics as kin
from learned.augmentation import Augmentation
from learned.corpus import RATE_HZ, Corpus
from mocap import sensors as places
from mocap.errors import PoserError
from mocap.skeleton import MIRROR, Skeleton

# Joints that go with the legs when the halves of two clips are spliced; the pelvis is the legs'.
LEGS = (0, 1, 2, 4, 5, 7, 8, 10, 11)
_TRIES = 20  # draws of a window free of flipped frames before one with them is taken


@dataclass(frozen=True)
class Batch:
    """B windows of T frames: sensors as measured and the motion they were put on.

    R_world_bone (B,T,S,3,3), acc_world (B,T,S,3) m/s^2: lost samples hold the last value, as the online
    runner does. R_parent_joint (B,T,24,3,3): the truth.
    """

    R_world_bone: Tensor
    acc_world: Tensor
    R_parent_joint: Tensor


def slerp(q0: Tensor, q1: Tensor, part: Tensor) -> Tensor:
    """Geodesic between unit quaternions (...,4) on one hemisphere: q0 at part (...) 0, q1 at 1.

    sin((1 - s) a) q0 + sin(s a) q1, not normalised, a = 2 asin(|q1 - q0| / 2) the angle between them.
    """
    half = ((q1 - q0).norm(dim=-1) / 2).clamp(1e-6, 1.0)
    a = 2 * torch.asin(half)
    w0, w1 = torch.sin((1 - part) * a), torch.sin(part * a)
    return w0.unsqueeze(-1) * q0 + w1.unsqueeze(-1) * q1


class Windows:
    """Draws batches from a corpus. The generator is a numpy one: its state resumes a run."""

    def __init__(
        self,
        corpus: Corpus,
        sensors: tuple[str, ...],
        rate_hz: float,
        frames: int,
        augmentation: Augmentation,
        device: torch.device | str = "cpu",
    ) -> None:
        self.corpus, self.rate_hz, self.frames = corpus, rate_hz, frames
        self.augmentation, self.device = augmentation, torch.device(device)
        joint, seat = places.joints_and_seats(sensors)
        self._joint = [int(j) for j in joint]
        self._seat = torch.as_tensor(seat, dtype=torch.float32, device=self.device)
        self._offsets = torch.as_tensor(
            np.array(Skeleton.default().offsets), dtype=torch.float32, device=self.device
        )
        self._bad = np.concatenate([[0], np.cumsum(~corpus.sound)])
        needed = self._span(np.exp(augmentation.warp))
        if not (corpus.length >= 8).any():
            raise PoserError(f"no clip of 8 frames or more to cut windows of {needed} from")

    def _span(self, speed: float | np.ndarray) -> np.ndarray:
        """Corpus frames that a window covers: T frames and one more at each end, at `speed`."""
        return np.ceil((self.frames + 1) * speed * RATE_HZ / self.rate_hz).astype(int) + 1

    def draw(self, rng: np.random.Generator, count: int) -> Batch:
        """`count` windows."""
        a = self.augmentation
        R, p = self._motion(rng, count)
        if a.splice > 0:
            R_other, _ = self._motion(rng, count)
            use = self._where(rng.uniform(size=count) < a.splice)
            legs = torch.zeros(24, dtype=torch.bool, device=self.device)
            legs[list(LEGS)] = True
            take = use[:, None] & ~legs
            R = torch.where(take[:, None, :, None, None], R_other, R)
        R = self._bent(rng, R)
        if a.heading:
            Ry = kin.rot_y(self._t(rng.uniform(-np.pi, np.pi, size=(count, 1))))
            R = torch.cat([(Ry @ R[:, :, 0]).unsqueeze(2), R[:, :, 1:]], 2)
            p = (Ry @ p.unsqueeze(-1)).squeeze(-1)
        return self._measured(rng, R, p)

    # -- motion -----------------------------------------------------------------------------------

    def _motion(self, rng: np.random.Generator, count: int) -> tuple[Tensor, Tensor]:
        """R_parent_joint (B,T+2,24,3,3) and p (B,T+2,3) of windows, warped and mirrored."""
        a, c = self.augmentation, self.corpus
        speed = np.exp(rng.uniform(-a.warp, a.warp, size=count))
        span = self._span(speed)
        which, first = self._places(rng, span)
        steps = np.arange(self.frames + 2) * (RATE_HZ / self.rate_hz)
        at = first[:, None] + np.minimum(
            steps * speed[:, None], (c.length[which] - 1 - first)[:, None]
        )
        low = np.minimum(np.floor(at).astype(int), (c.length[which] - 2)[:, None])
        part = self._t(at - low)
        low = low + c.start[which][:, None]
        q = slerp(self._t(c.q[low]), self._t(c.q[low + 1]), part[..., None])
        p0, p1 = self._t(c.p[low]), self._t(c.p[low + 1])
        p = p0 + part[..., None] * (p1 - p0)
        R = kin.from_quat(q)
        flip = self._where(rng.uniform(size=count) < a.mirror)
        M = torch.diag(torch.tensor([-1.0, 1, 1], device=self.device))
        R = torch.where(flip[:, None, None, None, None], M @ R[:, :, list(MIRROR)] @ M, R)
        p = torch.where(flip[:, None, None], p @ M, p)
        return R, p

    def _places(self, rng: np.random.Generator, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Clip and first frame of windows of `span` frames; a short clip holds its last frame."""
        c = self.corpus
        which, first = np.zeros(len(span), int), np.zeros(len(span), int)
        drawn = np.arange(len(span))
        for _ in range(_TRIES):
            clip = rng.choice(len(c.names), size=len(drawn), p=c.weight)
            room = np.maximum(c.length[clip] - span[drawn], 0)
            at = (rng.uniform(size=len(drawn)) * (room + 1)).astype(int)
            which[drawn], first[drawn] = clip, at
            begin = c.start[clip] + at
            end = np.minimum(begin + span[drawn], c.start[clip] + c.length[clip])
            drawn = drawn[self._bad[end] > self._bad[begin]]
            if not len(drawn):
                break
        return which, first

    def _bent(self, rng: np.random.Generator, R: Tensor) -> Tensor:
        """R Exp(delta(t)): a smooth random bending of every joint, constant part and slow sine."""
        a = self.augmentation
        if a.bend_deg == 0 and a.tilt_deg == 0:
            return R
        B, T = R.shape[:2]
        sigma = np.full((24, 1), np.deg2rad(a.bend_deg) / np.sqrt(2))
        sigma[0] = np.deg2rad(a.tilt_deg) / np.sqrt(2)
        constant = self._t(sigma * rng.normal(size=(B, 1, 24, 3)))
        wave = self._t(sigma * np.sqrt(2) * rng.normal(size=(B, 1, 24, 3)))
        hz = rng.uniform(0.05, 0.7, size=(B, 1, 24, 1))
        phase = rng.uniform(0, 2 * np.pi, size=(B, 1, 24, 1))
        t = np.arange(T).reshape(1, T, 1, 1) / self.rate_hz
        sine = self._t(np.sin(2 * np.pi * hz * t + phase))
        return R @ kin.exp(constant + wave * sine)

    # -- sensors ----------------------------------------------------------------------------------

    def _measured(self, rng: np.random.Generator, R_local: Tensor, p_root: Tensor) -> Batch:
        a = self.augmentation
        B, T, S = R_local.shape[0], self.frames, len(self._joint)
        n, dt = a.noise, 1.0 / self.rate_hz
        k = (
            rng.uniform(*a.noise_scale, size=(B, 1, 1))
            if a.noise_scale[1] > 0
            else np.zeros((B, 1, 1))
        )
        R = kin.rotations(R_local)
        factor = (1 + n.bone * k * rng.normal(size=(B, 24, 1))) * np.exp(
            a.scale * rng.normal(size=(B, 1, 1))
        )
        factor = factor[:, np.minimum(np.arange(24), np.array(MIRROR))]  # both sides alike
        offsets = self._offsets * self._t(factor)
        seat = self._seat + self._t((n.seat_m * k + a.seat_m) * rng.normal(size=(B, S, 3)))
        p = kin.positions(R, p_root, offsets[:, None])[:, :, self._joint]
        R = R[:, :, self._joint]
        p = p + (R @ seat[:, None, :, :, None]).squeeze(-1)
        acc = (p[:, :-2] - 2 * p[:, 1:-1] + p[:, 2:]) * self.rate_hz**2
        R = R[:, 1:-1]
        if n != n.none():
            rotvec = np.deg2rad(n.mounting_deg) * k * rng.normal(size=(B, S, 3))
            R = R @ kin.exp(
                self._t(np.deg2rad(n.tissue_deg) * k[..., None] * self._wobble(rng, B, S))
            )
            R = R @ kin.exp(self._t(rotvec))[:, None]
            acc = acc + (
                R @ self._t(n.acc_bias * k * rng.normal(size=(B, S, 3)))[:, None, :, :, None]
            ).squeeze(-1)
            white = n.acc_white * np.sqrt(self.rate_hz / 60) * k[..., None]
            acc = acc + self._t(white) * torch.as_tensor(
                rng.standard_normal((B, T, S, 3), dtype=np.float32), device=self.device
            )
            walk = np.cumsum(n.heading_walk_deg * np.sqrt(dt) * rng.normal(size=(B, T, S)), axis=1)
            heading = np.deg2rad(k * (n.heading_deg * rng.normal(size=(B, 1, S)) + walk))
            Ry = kin.rot_y(self._t(heading))
            R, acc = Ry @ R, (Ry @ acc.unsqueeze(-1)).squeeze(-1)
            held = self._held(rng, B, S)
            R = R.gather(1, held[..., None, None].expand(R.shape))
            acc = acc.gather(1, held[..., None].expand(acc.shape))
        return Batch(R, acc, R_local[:, 1:-1])

    @cached_property
    def _covariance_root(self) -> np.ndarray:
        """Lower Cholesky factor (T,T) of exp(-|s-t|/tau): the stationary first-order process."""
        t = np.arange(self.frames) / self.rate_hz
        tau = self.augmentation.noise.tissue_s
        return np.linalg.cholesky(np.exp(-np.abs(t[:, None] - t) / tau)).astype(np.float32)

    def _wobble(self, rng: np.random.Generator, B: int, S: int) -> np.ndarray:
        """(B,T,S,3): unit variance, exponential correlation (soft tissue)."""
        white = rng.standard_normal((self.frames, B * S * 3), dtype=np.float32)
        path = (self._covariance_root @ white).reshape(self.frames, B, S, 3)
        return np.moveaxis(path, 0, 1)

    def _held(self, rng: np.random.Generator, B: int, S: int) -> Tensor:
        """(B,T,S): the frame whose sample each frame shows: itself, or the last one before a loss."""
        n = self.augmentation.noise
        T = self.frames
        index = np.tile(np.arange(T).reshape(1, T, 1), (B, 1, S))
        if n.loss > 0:
            mean = max(1.0, n.loss_s * self.rate_hz)
            begins = rng.uniform(size=(B, T, S)) < n.loss / mean
            length = rng.geometric(1 / mean, size=(B, T, S))
            until = np.maximum.accumulate(np.where(begins, index + length, 0), axis=1)
            lost = index < until
            index = np.maximum.accumulate(np.where(lost, 0, index), axis=1)
        return torch.as_tensor(index, device=self.device)

    def _t(self, x: np.ndarray) -> Tensor:
        return torch.as_tensor(np.asarray(x, np.float32), device=self.device)

    def _where(self, x: np.ndarray) -> Tensor:
        return torch.as_tensor(x, device=self.device)
