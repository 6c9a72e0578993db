"""Where a motion stands, and what it starts from: the floor, and a still pose before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import grey_opening, uniform_filter1d

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import TOES
from mocap.stances import ARM_ANGLE_DEG, pose_bones
from mocap.synthesis.posing import step

BLEND_S = 1.0  # from the still pose to the motion's first frame
STRIDE_S = 1.0  # longer than a flight, and than any foot of a walk stays off the floor


def on_the_floor(motion: Motion) -> Motion:
    """The motion moved vertically so that the lower foot of its first frame stands on y = 0.

    Sensors do not tell how high a body is; a solver leaves the first pelvis at the origin.
    """
    p = motion.p_world_root - [0.0, floor_of(motion), 0.0]
    return replace(motion, p_world_root=p)


def floor_of(motion: Motion, frame: int = 0) -> float:
    """Height in m of the floor under the lower foot of a frame."""
    toes = motion.p_world_joint[frame, list(TOES), 1]
    return float(toes.min() - motion.skeleton.sole)


def floors_of(motion: Motion) -> Array:
    """(T,) m: the height of the floor under the body at each frame, where it may drift or climb.

    The height of the lower sole, or of a joint below it, without the bumps that are shorter than `STRIDE_S`
    (a grey opening), smoothed: a jump leaves the floor where it is, a steady climb takes it along.
    """
    p = motion.p_world_joint[..., 1]
    # Upside down or on the back another joint is the lowest.
    feet = np.minimum(p[:, list(TOES)].min(axis=1) - motion.skeleton.sole, p.min(axis=1))
    frames = max(1, round(STRIDE_S * motion.rate_hz))
    more = min(2 * frames, len(feet) - 1)  # beyond its ends a climb goes on
    long = np.pad(feet, more, mode="reflect", reflect_type="odd")
    smooth: Array = uniform_filter1d(grey_opening(long, frames), frames)
    return smooth[more : more + len(feet)]


def with_static_pose(motion: Motion, pose: str, seconds: float) -> Motion:
    """`motion` after standing still in the N- or T-pose for `seconds` s.

    The wearer stands where the motion begins, with its heading, and moves into its first frame within
    `BLEND_S`: geodesic from pose to frame, at rest at its start.
    """
    rate = motion.rate_hz
    R, p = _standing(motion, pose)
    still, blend = max(1, round(seconds * rate)), max(1, round(BLEND_S * rate))
    share = step(np.arange(1, blend + 1) / (blend + 1))
    turn = ori.log(np.swapaxes(R, -1, -2) @ motion.R_parent_joint[0])
    R_blend = R @ ori.exp(share[:, None, None] * turn)
    p_blend = p + share[:, None] * (motion.p_world_root[0] - p)
    return Motion(
        rate,
        np.concatenate([np.tile(R, (still, 1, 1, 1)), R_blend, motion.R_parent_joint]),
        np.concatenate([np.tile(p, (still, 1)), p_blend, motion.p_world_root]),
        motion.skeleton,
    )


def _standing(motion: Motion, pose: str) -> tuple[Array, Array]:
    """Local rotations (24,3,3) and pelvis (3,) m of the pose at the motion's first place and heading."""
    body = motion.skeleton
    bones = pose_bones(np.arange(24), pose, ARM_ANGLE_DEG)
    R = body.local_rotations(bones)
    R[0] = ori.rot_y(float(ori.heading(motion.R_parent_joint[0, 0])))
    p = np.array(motion.p_world_root[0])
    p[1] = floor_of(motion) + body.standing_height
    return R, p
