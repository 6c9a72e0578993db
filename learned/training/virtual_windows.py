"""Windows of virtual sensors for training, made in batches as they are needed.

The same model as `mocap.synthesis` (DIP eq. 3 and the design's realistic noise) over a whole batch at
once in torch, on motion that is augmented first. Tests compare the two on clean windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.ndimage import spline_filter1d
from torch import Tensor

from learned import tree as kin
from learned.training.augmentation import Augmentation
from learned.training.corpus import RATE_HZ, Corpus
from mocap import sensors as places
from mocap.errors import PoserError
from mocap.skeleton import MIRROR, Skeleton

# Joints that go with the legs when the halves of two clips are spliced; the pelvis is the legs'.
LEGS = (0, 1, 2, 4, 5, 7, 8, 10, 11)
_TAIL = (
    12  # frames that a path is continued by before its spline is taken: 0.27^12 is left of its end
)
_TRIES = 20  # draws of a window free of flipped frames before one with them is taken


@dataclass(frozen=True)
class Batch:
    """B windows of T frames: sensors as measured and the motion they were put on.

    R_world_bone (B,T,S,3,3), acc_world (B,T,S,3) m/s^2: lost samples hold the last value, as the online
    runner does, and what lies before a clip's beginning is its first sample. R_parent_joint (B,T,24,3,3): the
    truth. there (B,S): the sensors that are worn at each window's end; of these alone IMUPoser's combinations
    are drawn.
    """

    R_world_bone: Tensor
    acc_world: Tensor
    R_parent_joint: Tensor
    there: Tensor


def cubic_weights(part: np.ndarray) -> np.ndarray:
    """Weights (...,4) of the coefficients -1, 0, 1, 2 around a place `part` (...) in [0, 1] between 0 and 1.

    The uniform cubic B-spline: ((1-s)^3, 3s^3 - 6s^2 + 4, -3s^3 + 3s^2 + 3s + 1, s^3) / 6.
    """
    s = np.asarray(part)
    return (
        np.stack(
            [(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3], axis=-1
        )
        / 6
    )


def spline_coefficients(x: np.ndarray) -> np.ndarray:
    """Coefficients (N+2,K) of the cubic spline through the rows of x (N,K), one beyond each end.

    Beyond its ends the path goes on as its point reflection, so that its speed there is its own.
    """
    more = min(_TAIL, len(x) - 1)
    before = 2 * x[:1] - x[more:0:-1]
    after = 2 * x[-1:] - x[-2 : -2 - more : -1]
    long = np.concatenate([before, x, after]).astype(np.float64)
    c: np.ndarray = spline_filter1d(long, order=3, axis=0, mode="mirror")
    return c[more - 1 : more + 1 + len(x)]


class Windows:
    """Draws batches from a corpus. The generator is a numpy one: its state resumes a run.

    It keeps 88 MB per hour of motion, splines and what frames may train. The corpus's own rotations and
    positions, as much again, it does not keep.

    Between the corpus's frames motion runs on cubic splines (of the quaternions' components, normalised):
    second differences of a path that is straight between frames jump at every frame, and where a window is
    slowed down those jumps would be what the virtual accelerometers measure.
    """

    def __init__(
        self,
        corpus: Corpus,
        sensors: tuple[str, ...],
        rate_hz: float,
        frames: int,
        augmentation: Augmentation,
        device: torch.device | str = "cpu",
    ) -> None:
        self.rate_hz, self.frames = rate_hz, frames
        self.augmentation, self.device = augmentation, torch.device(device)
        joint, seat = places.joints_and_seats(sensors)
        self._joint = [int(j) for j in joint]
        self._seat = torch.as_tensor(seat, dtype=torch.float32, device=self.device)
        self._offsets = torch.as_tensor(
            np.array(Skeleton.default().offsets), dtype=torch.float32, device=self.device
        )
        self._start, self._length, self._weight = corpus.start, corpus.length, corpus.weight
        self._q, self._p, self._first = self._splines(corpus)
        self._bad = np.concatenate([[0], np.cumsum(~corpus.sound)])
        needed = self._span(np.exp(augmentation.warp))
        if not (corpus.length >= 8).any():
            raise PoserError(f"no clip of 8 frames or more to cut windows of {needed} from")

    @staticmethod
    def _splines(c: Corpus) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coefficients of rotations (M,24,4) and positions (M,3); where each clip's begin (its frame -1)."""
        first = np.concatenate([[0], np.cumsum(c.length + 2)[:-1]])
        q = np.empty((int((c.length + 2).sum()), 24, 4), np.float32)
        p = np.empty((len(q), 3), np.float32)
        for at, start, length in zip(first, c.start, c.length, strict=True):
            frames, to = slice(start, start + length), slice(at, at + length + 2)
            q[to] = spline_coefficients(c.q[frames].reshape(length, -1)).reshape(-1, 24, 4)
            p[to] = spline_coefficients(c.p[frames])
        return q, p, first

    def _span(self, speed: float | np.ndarray) -> np.ndarray:
        """Corpus frames that a window covers: T frames and one more at each end, at `speed`."""
        return np.ceil((self.frames + 1) * speed * RATE_HZ / self.rate_hz).astype(int) + 1

    def draw(self, rng: np.random.Generator, count: int) -> Batch:
        """`count` windows."""
        a = self.augmentation
        R, p, missing = self._motion(rng, count)
        if a.splice > 0:
            R_other, _, missing_other = self._motion(rng, count)
            use = rng.uniform(size=count) < a.splice
            missing = np.where(use, np.maximum(missing, missing_other), missing)
            legs = torch.zeros(24, dtype=torch.bool, device=self.device)
            legs[list(LEGS)] = True
            take = self._where(use)[:, None] & ~legs
            R = torch.where(take[:, None, :, None, None], R_other, R)
        R = self._bent(rng, R)
        if a.heading:
            Ry = kin.rot_y(self._t(rng.uniform(-np.pi, np.pi, size=(count, 1))))
            R = torch.cat([(Ry @ R[:, :, 0]).unsqueeze(2), R[:, :, 1:]], 2)
            p = (Ry @ p.unsqueeze(-1)).squeeze(-1)
        return self._measured(rng, R, p, missing)

    # -- motion -----------------------------------------------------------------------------------

    def _motion(self, rng: np.random.Generator, count: int) -> tuple[Tensor, Tensor, np.ndarray]:
        """R_parent_joint (B,T+2,24,3,3) and p (B,T+2,3) of windows, warped and mirrored.

        The third (B,): how many of the T inner frames lie before the clip's beginning.
        """
        a = self.augmentation
        speed = np.exp(rng.uniform(-a.warp, a.warp, size=count))
        span = self._span(speed)
        which, first = self._places(rng, span)
        steps = np.arange(self.frames + 2) * (RATE_HZ / self.rate_hz)
        at = first[:, None] + steps * speed[:, None]
        missing = np.minimum((at < 0).sum(axis=1), self.frames - 1)
        length = self._length[which][:, None]
        at = np.clip(at, 0, length - 1)
        low = np.minimum(np.floor(at).astype(int), length - 2)
        weights = cubic_weights(at - low)
        low += self._first[which][:, None]  # of the coefficient one before the frame
        taps, weights = low[..., None] + np.arange(4), weights.astype(np.float32)
        q = self._t(np.einsum("btk,btkjc->btjc", weights, self._q[taps]))
        p = self._t(np.einsum("btk,btkc->btc", weights, self._p[taps]))
        R = kin.from_quat(q / q.norm(dim=-1, keepdim=True))
        flip = self._where(rng.uniform(size=count) < a.mirror)
        M = torch.diag(torch.tensor([-1.0, 1, 1], device=self.device))
        R = torch.where(flip[:, None, None, None, None], M @ R[:, :, list(MIRROR)] @ M, R)
        p = torch.where(flip[:, None, None], p @ M, p)
        return R, p, missing

    def _places(self, rng: np.random.Generator, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Clip and first frame of windows of `span` frames.

        A clip that is too short ends the window, as a recording that has just begun: its first frame is
        negative.
        """
        which, first = np.zeros(len(span), int), np.zeros(len(span), int)
        drawn = np.arange(len(span))
        for _ in range(_TRIES):
            clip = rng.choice(len(self._weight), size=len(drawn), p=self._weight)
            room = self._length[clip] - span[drawn]
            at = (rng.uniform(size=len(drawn)) * (np.maximum(room, 0) + 1)).astype(int)
            at += np.minimum(room, 0)
            which[drawn], first[drawn] = clip, at
            begin = self._start[clip] + np.maximum(at, 0)
            end = self._start[clip] + np.minimum(at + span[drawn], self._length[clip])
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

    def _measured(
        self, rng: np.random.Generator, R_local: Tensor, p_root: Tensor, missing: np.ndarray
    ) -> Batch:
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
        R_local = R_local[:, 1:-1]
        if missing.any():
            shown = torch.as_tensor(
                np.maximum(np.arange(T), missing[:, None])[..., None], device=self.device
            )
            R = R.gather(1, shown[..., None, None].expand(R.shape))
            acc = acc.gather(1, shown[..., None].expand(acc.shape))
            R_local = R_local.gather(1, shown[..., None, None].expand(R_local.shape))
        everywhere = torch.ones(B, S, dtype=torch.bool, device=self.device)
        return Batch(R, acc, R_local, everywhere)

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
