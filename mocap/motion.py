"""A body in motion: one rotation per joint and frame, and where the pelvis is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap import checked
from mocap import orientation as ori
from mocap.errors import ShapeError
from mocap.orientation import Array
from mocap.skeleton import MIRROR, Skeleton


def check_rate(rate_hz: float, what: str) -> float:
    """`rate_hz` as a float, or ShapeError: finite and between 1 and 10,000 Hz."""
    rate = checked.number(rate_hz, f"{what}: rate_hz")
    if not (np.isfinite(rate) and 1.0 <= rate <= 10_000.0):
        raise ShapeError(f"{what}: rate_hz must lie between 1 and 10000, got {rate_hz!r}")
    return rate


@dataclass(frozen=True, eq=False)
class Motion:
    """T poses at `rate_hz`.

    R_parent_joint: (T,24,3,3), entry 0 is the root's R_world_root. p_world_root: (T,3) m, the pelvis
    joint. skeleton: the body. start_s: time of the first frame on the recording's clock in s (0 also where
    nobody says). trusted: (T,) bool, the frames whose pose is known to be right, None for all; evaluation and
    training leave the others out (`mocap.faults` finds them). Checked once here: shapes, finite, orthonormal
    to 1e-3 (and then projected onto SO(3), so that rounding in a file does not grow along the chain).
    """

    rate_hz: float
    R_parent_joint: Array
    p_world_root: Array
    skeleton: Skeleton
    start_s: float = 0.0
    trusted: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        checked.instance(self.skeleton, Skeleton, "Motion: skeleton")
        R = checked.array(self.R_parent_joint, "Motion: R_parent_joint")
        p = checked.array(self.p_world_root, "Motion: p_world_root")
        J = len(self.skeleton.names)
        if R.ndim != 4 or R.shape[1:] != (J, 3, 3) or len(R) == 0:
            raise ShapeError(f"Motion: R_parent_joint must be (T,{J},3,3), T > 0, got {R.shape}")
        if p.shape != (len(R), 3):
            raise ShapeError(f"Motion: p_world_root must be ({len(R)},3), got {p.shape}")
        bad = ~ori.is_rotation(R)
        if bad.any():
            t, j = np.argwhere(bad)[0]
            raise ShapeError(
                f"Motion: frame {t}, joint {self.skeleton.names[j]}: not a rotation matrix"
            )
        if not np.isfinite(p).all():
            t = np.argwhere(~np.isfinite(p))[0][0]
            raise ShapeError(f"Motion: frame {t}: p_world_root is not finite")
        if np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max() > 1e-9:
            R = ori.project(R)
        checked.number(self.start_s, "Motion: start_s")
        if self.trusted is not None:
            trusted = checked.truths(self.trusted, (len(R),), "Motion: trusted")
            trusted.setflags(write=False)
            object.__setattr__(self, "trusted", trusted)
        object.__setattr__(self, "rate_hz", check_rate(self.rate_hz, "Motion"))
        object.__setattr__(self, "start_s", float(self.start_s))
        for name, value in (("R_parent_joint", R), ("p_world_root", p)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.R_parent_joint)

    @property
    def seconds(self) -> float:
        """Length in s: frames / rate."""
        return len(self) / self.rate_hz

    @cached_property
    def _global(self) -> tuple[Array, Array]:
        return self.skeleton.forward(self.R_parent_joint, self.p_world_root)

    @property
    def R_world_joint(self) -> Array:
        """Global rotations (T,24,3,3)."""
        return self._global[0]

    @property
    def p_world_joint(self) -> Array:
        """Joint positions (T,24,3) m."""
        return self._global[1]

    @property
    def poses(self) -> Array:
        """SMPL axis-angle (T,72) rad, in our y-up world."""
        return ori.log(self.R_parent_joint).reshape(len(self), -1)

    @property
    def trans(self) -> Array:
        """SMPL's translation (T,3) m in our world: p_world_root = J0 + trans."""
        return self.p_world_root - self.skeleton.offsets[0]

    @classmethod
    def from_smpl(
        cls, rate_hz: float, poses: ArrayLike, trans: ArrayLike, skeleton: Skeleton
    ) -> Motion:
        """From axis-angle (T,72) rad and trans (T,3) m, both in our y-up world."""
        checked.instance(skeleton, Skeleton, "Motion.from_smpl: skeleton")
        poses = checked.array(poses, "Motion.from_smpl: poses")
        if poses.ndim != 2 or poses.shape[1] != 72:
            raise ShapeError(f"poses must be (T,72), got {poses.shape}")
        trans = checked.array(trans, "Motion.from_smpl: trans")
        if trans.shape != (len(poses), 3):
            raise ShapeError(f"trans must be ({len(poses)},3), got {trans.shape}")
        if not np.isfinite(poses).all():
            t = int(np.argwhere(~np.isfinite(poses))[0][0])
            raise ShapeError(f"poses: frame {t} is not finite")
        R = ori.exp(poses.reshape(-1, 24, 3))
        return cls(rate_hz, R, trans + skeleton.offsets[0], skeleton)

    def slice(self, start: int, stop: int) -> Motion:
        """Frames start to stop-1, at the time they have here."""
        return replace(
            self,
            R_parent_joint=self.R_parent_joint[start:stop],
            p_world_root=self.p_world_root[start:stop],
            start_s=self.start_s + slice(start, stop).indices(len(self))[0] / self.rate_hz,
            trusted=None if self.trusted is None else self.trusted[start:stop],
        )

    def on(self, skeleton: Skeleton) -> Motion:
        """The same rotations and pelvis path on another body."""
        return replace(self, skeleton=skeleton)

    def resampled(self, rate_hz: float) -> Motion:
        """At another rate, on the manifold: geodesic for rotations, linear for the root's position.

        Frame k of the result is time start_s + k / rate_hz; the last one lies at or before the last frame.
        """
        rate = check_rate(rate_hz, "Motion.resampled")
        if rate == self.rate_hz:
            return self
        last = (len(self) - 1) / self.rate_hz
        return self.sampled(np.arange(int(np.floor(last * rate + 1e-9)) + 1) / rate, rate)

    def sampled(self, at_s: Array, rate_hz: float) -> Motion:
        """At times (N,) s after its first frame, 1 / rate_hz apart: geodesic for rotations, linear for the
        root's position; the ends hold. start_s becomes that of the first of them. A frame is trusted where
        both that it lies between are.
        """
        t = np.arange(len(self)) / self.rate_hz
        p = np.stack([np.interp(at_s, t, self.p_world_root[:, i]) for i in range(3)], axis=1)
        R = ori.interpolate(t, self.R_parent_joint, at_s)
        start_s = self.start_s + float(at_s[0])
        trusted = self.trusted
        if trusted is not None:
            trusted = np.interp(at_s, t, trusted.astype(float)) > 1 - 1e-6
        return replace(
            self,
            rate_hz=rate_hz,
            R_parent_joint=R,
            p_world_root=p,
            start_s=start_s,
            trusted=trusted,
        )

    def lowpassed(self, cutoff_hz: float) -> Motion:
        """Zero-phase Butterworth low-pass (4th order in effect: 2nd order run both ways).

        Rotations are filtered as sign-continuous quaternions and normalised, which is invariant to the
        choice of world frame. Motions at or below twice the cut-off, or shorter than the filter's
        transient, come back as they are.
        """
        # Here, because scipy.signal takes half a second to import.
        from scipy.signal import butter, sosfiltfilt

        checked.number(cutoff_hz, "Motion.lowpassed: cutoff_hz", above=0.0, infinite=True)
        if cutoff_hz >= self.rate_hz / 2 or len(self) < 8:
            return self
        sos = butter(2, cutoff_hz / (self.rate_hz / 2), output="sos")
        pad = min(len(self) - 1, int(3 * self.rate_hz / cutoff_hz))
        q = ori.to_quat(self.R_parent_joint)
        # Neighbouring quaternions on one hemisphere: q and -q are the same rotation.
        sign = np.cumprod(np.sign(np.sum(q[1:] * q[:-1], axis=-1) + 1e-300), axis=0)
        q[1:] *= sign[..., None]
        q = sosfiltfilt(sos, q, axis=0, padlen=pad)
        p = sosfiltfilt(sos, self.p_world_root, axis=0, padlen=pad)
        return replace(self, R_parent_joint=ori.from_quat(q), p_world_root=p)

    def turned(self, yaw: float) -> Motion:
        """The whole motion turned about the vertical through the origin by `yaw` rad."""
        Ry = ori.rot_y(checked.number(yaw, "Motion.turned: yaw"))
        R = np.array(self.R_parent_joint)
        R[:, 0] = Ry @ R[:, 0]
        return replace(self, R_parent_joint=R, p_world_root=self.p_world_root @ Ry.T)

    def mirrored(self) -> Motion:
        """Left and right exchanged (reflection in the plane x = 0)."""
        M = np.diag([-1.0, 1.0, 1.0])
        R = M @ self.R_parent_joint[:, list(MIRROR)] @ M
        return replace(self, R_parent_joint=R, p_world_root=self.p_world_root @ M)
