"""Where a solve starts: the prior's mean under the measured pelvis, and coarser grids in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip.kinematics import BODY, ROOT_P
from sip.model import Evidence
from sip.prior import Conditioned, Prior
from sip.problem import reference_root


def root_guess(recording: Recording, skeleton: Skeleton, prior: Prior) -> Array:
    """R_ref (T,3,3): the pelvis measurement; without one, what the other sensors say of the root.

    Each sensor's bone, had the body the prior's mean pose, would put the root at R_meas R_root_bone^T;
    their chordal mean, slerped over frames without any sensor.
    """
    R_ref = reference_root(recording)
    if R_ref is not None:
        return R_ref
    return root_of_sensors(Evidence.of(recording), recording.joint, skeleton, prior)


def root_of_sensors(
    evidence: Evidence, joint: NDArray[np.int64], skeleton: Skeleton, prior: Prior
) -> Array:
    """R_ref (T,3,3): the chordal mean of what each sensor says of the root, as in `root_guess`."""
    local = np.broadcast_to(np.eye(3), (24, 3, 3)).copy()
    local[1:] = ori.exp(prior.mean.reshape(23, 3))
    R_root_bone = skeleton.rotations(local)[joint]
    votes = evidence.R @ np.swapaxes(R_root_bone, -1, -2)
    # Sensors near the trunk say more about the root than those at the ends of limbs.
    depth = np.array([len(skeleton.ancestors(int(j))) for j in joint], float)
    weight = evidence.ori_valid / depth
    has = weight.sum(axis=1) > 0
    if not has.any():
        return np.tile(np.eye(3), (len(evidence), 1, 1))
    summed = np.einsum("ts,tsij->tij", weight, votes)
    frames = np.arange(len(evidence), dtype=float)
    return ori.interpolate(frames[has], ori.project(summed[has]), frames)


def from_prior(
    recording: Recording, skeleton: Skeleton, prior: Conditioned, start: int, stop: int
) -> tuple[Array, Array]:
    """x (T,n) and R_ref (T,3,3) of frames start to stop-1: the prior's mean pose under `root_guess`.

    Frames of a window without any orientation lie between those before and after it.
    """
    x = np.zeros((stop - start, 6 + len(prior.active)))
    x[:, BODY] = prior.mean
    piece = recording.slice(start, stop)
    if piece.ori_valid.any():
        return x, root_guess(piece, skeleton, prior.prior)
    return x, root_guess(recording, skeleton, prior.prior)[start:stop]


def unwrapped(w: Array) -> Array:
    """Rotation vectors (T,J,3), principal chart in, each joint continuous in time out.

    A joint that turns past 180 degrees jumps from w to (1 - 2 pi/|w|) w, the same rotation the other way
    round, by 2 pi: smoothness would see that as a motion. Of the two charts a joint starts in the one that
    keeps most of its frames principal.
    """
    apart = np.linalg.norm(np.diff(w, axis=0), axis=-1)
    other = np.zeros(w.shape[:2], bool)
    other[1:] = np.cumsum(apart > np.pi, axis=0) % 2 == 1
    other ^= other.mean(axis=0) > 0.5
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    turned = w * (1 - 2 * np.pi / np.maximum(angle, 1e-9))
    return np.where(other[..., None], turned, w)


def from_motion(motion: Motion, prior: Conditioned) -> tuple[Array, Array]:
    """x (T,n) and R_ref (T,3,3) of a motion: its own root, body angles without jumps (`unwrapped`).

    A joint whose jump is a fault of the motion (a rig that flips) would be carried round past its limits,
    from where no solve brings it back: it keeps its principal chart.
    """
    T = len(motion)
    x = np.zeros((T, 6 + len(prior.active)))
    x[:, ROOT_P] = motion.p_world_root - motion.p_world_root[0]
    principal = ori.log(motion.R_parent_joint[:, 1:])
    smooth = unwrapped(principal)
    lower, upper = (b.reshape(23, 3) for b in (prior.prior.lower, prior.prior.upper))
    past = [np.abs(w - np.clip(w, lower, upper)).sum(axis=(0, 2)) for w in (principal, smooth)]
    angles = np.where((past[1] <= past[0])[:, None], smooth, principal)
    x[:, BODY] = angles.reshape(T, 69)[:, prior.active]
    return x, np.array(motion.R_parent_joint[:, 0])


def coarsened(recording: Recording, factor: int) -> Recording:
    """Every `factor`-th frame, with the accelerations that a second difference at that step means.

    p_{t-k} - 2 p_t + p_{t+k} = sum_{|j|<k} (k - |j|) a_{t+j} dt^2 exactly, for a the second difference
    at the fine step; so the coarse acceleration is the mean of the fine ones with triangular weights. It
    is valid where three quarters of the weight are.
    """
    if factor == 1:
        return recording
    k, T = factor, len(recording)
    weights = (k - np.abs(np.arange(-k + 1, k))) / k**2
    ok = recording.acc_valid
    acc = np.where(ok[..., None], recording.acc_world, 0.0)
    centres = np.arange(0, T, k)
    total = np.zeros((len(centres), acc.shape[1], 3))
    mass = np.zeros((len(centres), acc.shape[1]))
    for w, j in zip(weights, range(-k + 1, k), strict=True):
        at = centres + j
        inside = (at >= 0) & (at < T)
        total[inside] += w * acc[at[inside]]
        mass[inside] += w * ok[at[inside]]
    enough = mass >= 0.75
    mean = np.where(enough[..., None], total / np.maximum(mass, 1e-9)[..., None], np.nan)
    return Recording(
        recording.rate_hz / k,
        recording.sensors,
        # An orientation that may not be used must not come back with the acceleration's validity.
        np.where(recording.ori_valid[::k, :, None, None], recording.R_world_bone[::k], np.nan),
        mean,
        valid=recording.ori_valid[::k] | enough,
        joint=recording.joint,
        placement=recording.placement,
        start_s=recording.start_s,
    )


def refined(
    x: Array, R_ref: Array, factor: int, T: int, R_ref_fine: Array | None
) -> tuple[Array, Array]:
    """x and R_ref on the fine grid of T frames, from every `factor`-th frame, by cubic splines.

    With R_ref_fine (the pelvis measurement) the root's correction to it is splined rather than the root.
    """
    if factor == 1:
        return x, R_ref
    coarse, fine = np.arange(len(x)) * factor, np.arange(T)
    if R_ref_fine is None:
        R_fine = ori.interpolate(coarse, R_ref, np.minimum(fine, coarse[-1]))
        w = np.zeros((len(x), 3))
    else:
        R_fine = R_ref_fine
        w = ori.log(np.swapaxes(R_ref_fine[coarse], -1, -2) @ R_ref)
    y = x.copy()
    y[:, 3:6] += w
    if len(x) < 4:
        out = np.stack([np.interp(fine, coarse, y[:, c]) for c in range(y.shape[1])], axis=1)
    else:
        out = CubicSpline(coarse, y, axis=0, bc_type="natural")(np.minimum(fine, coarse[-1]))
    return out, R_fine
