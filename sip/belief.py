"""What a network says of the poses, and how far it can be trusted where the sensors contradict it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.errors import ShapeError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip.sensor_kinematics import SensorKinematics
from sip.settings import Settings


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """A Gaussian over the pose of each frame: what a network estimates, and the covariance of its errors.

    R_parent_joint (T,24,3,3), entry 0 the root's R_world_root. covariance (72,72), or (T,72,72) where frames
    differ, rad^2: of the vectors Log(R_estimated^T R_true) of all joints, joint by joint. valid (T,): frames
    that have one; default all. Raises ShapeError.
    """

    R_parent_joint: Array
    covariance: Array
    valid: NDArray[np.bool_] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        T = len(self.R_parent_joint)
        if np.shape(self.R_parent_joint) != (T, 24, 3, 3):
            found = np.shape(self.R_parent_joint)
            raise ShapeError(f"PoseBelief: R_parent_joint must be (T,24,3,3), got {found}")
        if np.shape(self.covariance) not in ((72, 72), (T, 72, 72)):
            raise ShapeError(
                f"PoseBelief: covariance must be (72,72) or ({T},72,72), got {np.shape(self.covariance)}"
            )
        valid = np.ones(T, bool) if self.valid is None else np.asarray(self.valid, bool)
        if valid.shape != (T,):
            raise ShapeError(f"PoseBelief: valid must be ({T},), got {valid.shape}")
        object.__setattr__(self, "valid", valid)

    def __len__(self) -> int:
        return len(self.R_parent_joint)

    def motion(self, rate_hz: float, skeleton: Skeleton, start_s: float = 0.0) -> Motion:
        """The poses on the spot, as a start for a solve."""
        place = np.zeros((len(self), 3))
        return Motion(rate_hz, self.R_parent_joint, place, skeleton, start_s)

    def slice(self, start: int, stop: int) -> Self:
        """Frames start to stop-1."""
        C = self.covariance if self.covariance.ndim == 2 else self.covariance[start:stop]
        return type(self)(self.R_parent_joint[start:stop], C, self.valid[start:stop])


@dataclass(frozen=True, eq=False)
class FrameBeliefs:
    """`PoseBelief` as the cost takes it: of the a joints that are unknowns, time first.

    R (T,a,3,3). root: whether the first of them is the root. scale (T,3a), zero where there is no belief, and
    L (3a,3a), or (T,3a,3a) where frames differ: residual L^T (scale * Log(R^T R(x))). H: L L^T.
    """

    R: Array
    scale: Array
    L: Array
    H: Array
    root: bool

    def __len__(self) -> int:
        return len(self.R)

    def slice(self, start: int, stop: int) -> Self:
        """Frames start to stop-1."""
        return self._at(slice(start, stop))

    def every(self, factor: int) -> Self:
        """Every `factor`-th frame."""
        return self._at(slice(None, None, factor))

    def _at(self, cut: Any) -> Self:
        L, H = (a if a.ndim == 2 else a[cut] for a in (self.L, self.H))
        return replace(self, R=self.R[cut], scale=self.scale[cut], L=L, H=H)

    def then(self, other: Self) -> Self:
        """These frames and those."""
        R, scale = np.concatenate([self.R, other.R]), np.concatenate([self.scale, other.scale])
        for kept, added in ((self, other), (other, self)):
            # Of frames without belief the weight is zero, whatever L is; after unpickling L is a copy.
            if kept.L is added.L or (
                kept.L.ndim == 2 and (not added.scale.any() or np.array_equal(kept.L, added.L))
            ):
                return replace(kept, R=R, scale=scale)
        L, H = (
            np.concatenate([np.broadcast_to(a, (len(b), *a.shape[-2:])) for a, b in pairs])
            for pairs in (
                ((self.L, self.R), (other.L, other.R)),
                ((self.H, self.R), (other.H, other.R)),
            )
        )
        return replace(self, R=R, scale=scale, L=L, H=H)


class Listener:
    """Makes `FrameBeliefs` of what a network says about a body with these sensors.

    Frames of one clip err alike, so the residual is weighted by `network_weight` (as the static prior is). A
    network that is off its ground is as sure as ever, but at the bones with sensors it can be caught:
    d_s = Log(R_meas^T R_network) should have the covariance P_s = J_s C J_s^T + 2 sigma_orientation^2 I, and
    d^T P^-1 d / 3 the mean 1. Where its mean over `network_memory_s`, over the sensors beyond a joint, is
    larger than that, the joint's deviation is multiplied by it.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        kinematics: SensorKinematics,
        joint: NDArray[np.int64],
        settings: Settings,
    ):
        self.skeleton, self.settings = skeleton, settings
        self.joint = np.asarray(joint, int)
        self.root = 0 not in self.joint
        self.joints = np.array([0, *kinematics.active] if self.root else kinematics.active, int)
        self.columns = (3 * self.joints[:, None] + np.arange(3)).ravel()
        self.chains = [list(skeleton.ancestors(int(j))) for j in self.joint]
        # (S,J): sensor s lies at or beyond joint j, and is no sensor of the root alone.
        # (S,J): the network's joint turns the sensor's bone; a measured root does not count.
        self.moving = np.array(
            [[j in c and (j > 0 or self.root) for j in range(24)] for c in self.chains]
        )
        self.beyond = np.array([[j in c and len(c) > 1 for j in range(24)] for c in self.chains])
        # The covariance seen last and what follows from it: a cache, nothing that a frame hands on.
        self._covariance: Array | None = None
        self._whitener: tuple[Array, Array] = (np.eye(len(self.columns)),) * 2

    def nothing(self, frames: int) -> FrameBeliefs:
        """Of frames that the network is silent about."""
        a = len(self.joints)
        R, scale = np.tile(np.eye(3), (frames, a, 1, 1)), np.zeros((frames, 3 * a))
        L, H = self._whitener
        return FrameBeliefs(R, scale, L, H, self.root)

    def of(self, belief: PoseBelief, inflation: Array) -> FrameBeliefs:
        """Beliefs as the cost takes them. inflation (T,24): factor on the deviation of each joint."""
        if belief.covariance is not self._covariance:
            self._covariance = belief.covariance
            C = belief.covariance[..., self.columns[:, None], self.columns]
            L = np.linalg.cholesky(np.linalg.inv(C))
            self._whitener = L, L @ np.swapaxes(L, -1, -2)
        grow = np.repeat(inflation[:, self.joints], 3, axis=1)
        scale = np.where(belief.valid[:, None], self.settings.network_weight / grow, 0.0)
        valid = belief.valid[:, None, None, None]
        R = np.where(valid, belief.R_parent_joint[:, self.joints], np.eye(3))
        return FrameBeliefs(R, scale, *self._whitener, self.root)

    def disagreement(
        self, belief: PoseBelief, R_meas: Array, valid: NDArray[np.bool_]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """d^T P^-1 d / 3 (T,S) of each sensor's bone, zero where nothing can be compared, and that (T,S)."""
        local = belief.R_parent_joint
        pelvis = np.flatnonzero(self.joint == 0)
        if len(pelvis):
            local = np.array(local)
            at = pelvis[0]
            local[:, 0] = np.where(valid[:, at, None, None], R_meas[:, at], local[:, 0])
        R = self.skeleton.rotations(local)
        C = belief.covariance if belief.covariance.ndim == 2 else belief.covariance[:, None]
        T = len(local)
        bone = R[:, self.joint]
        d = ori.log(np.swapaxes(R_meas, 2, 3) @ bone)
        side = R.swapaxes(1, 2).reshape(T, 3, 72)[:, None]  # the joints' rotations side by side
        J = (np.swapaxes(bone, 2, 3) @ side) * np.repeat(self.moving, 3, axis=1)[:, None]
        P = J @ C @ np.swapaxes(J, 2, 3) + 2 * self.settings.sigma_orientation**2 * np.eye(3)
        ratio = (d * np.linalg.solve(P, d[..., None])[..., 0]).sum(axis=-1) / 3
        may = valid & belief.valid[:, None] & self.beyond.any(1)
        return np.where(may, ratio, 0.0), may

    def inflation(self, ratio: Array, there: Array) -> Array:
        """Factor (...,24) on each joint's deviation of mean ratios (...,S) of the sensors that are there."""
        beyond = self.beyond.astype(float)
        mass = there @ beyond
        mean = ((ratio * there) @ beyond) / np.maximum(mass, 1e-9)
        return np.where(mass > 0, np.maximum(mean, 1.0), 1.0) ** self.settings.network_doubt

    def listen(self, recording: Recording, belief: PoseBelief) -> FrameBeliefs:
        """The beliefs about a whole recording, each frame judged by those around it."""
        ok = recording.ori_valid
        R = np.where(ok[..., None, None], recording.R_world_bone, np.eye(3))
        ratio, there = self.disagreement(belief, R, ok)
        frames = max(1, round(self.settings.network_memory_s * recording.rate_hz))
        mass, total = (moving_sum(a, frames) for a in (there.astype(float), ratio))
        mean = total / np.maximum(mass, 1e-9)
        return self.of(belief, self.inflation(mean, (mass > 0.5).astype(float)))


def moving_sum(a: Array, frames: int) -> Array:
    """Sums (T,...) over `frames` around each, the array's ends taken as they are."""
    total = np.concatenate([np.zeros((1, *a.shape[1:])), np.cumsum(a, axis=0)])
    t = np.arange(len(a))
    first, last = np.maximum(t - frames // 2, 0), np.minimum(t + (frames + 1) // 2, len(a))
    return np.asarray(total[last] - total[first])
