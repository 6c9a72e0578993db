"""Rigs of the field whose T-pose their files do not show, or that carry constants of their own.

A rig is known by its joints' names and by where its bones lie at zero rotation. What is known about it
are neutral frames F_j (`_neutral`): our axes, in the T-pose, in the axes of the source joint. All were found
by `scripts/estimate_rigs.py` but CMU's, which is read off the T-pose frame that MotionBuilder's conversion
of the same skeletons begins with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap import orientation as ori
from mocap.formats._frames import T_POSE_FRAMES
from mocap.formats._source import INDEX, ForeignMotion
from mocap.orientation import Array

_NEAR_DEG = 1.0
_NEAR_LENGTH = 0.01


@dataclass(frozen=True)
class Rig:
    """One rig.

    code: of the finding that says so. bones: where joints lie in their parents at zero rotation, by name;
    lengths count only where `same_lengths`. F: rotation vectors (3,) deg of neutral frames, by our joint's
    name. own_limbs: whether limbs point as the file's bones do; else as the neutral frames say (arms along
    x, legs along -y).
    t_pose_frames: how many frames a T-pose put before the motion spoils.
    """

    code: str
    bones: Mapping[str, tuple[float, float, float]]
    F: Mapping[str, tuple[float, float, float]]
    same_lengths: bool = True
    own_limbs: bool = True
    t_pose_frames: int = T_POSE_FRAMES

    def fits(self, source: ForeignMotion) -> bool:
        """Whether the source is this rig, whatever its unit of length."""
        if not set(self.bones) <= set(source.names):
            return False
        at = [source.names.index(n) for n in self.bones]
        if any(source.parents[j] < 0 for j in at):
            return False
        theirs = source.rest[at] - source.rest[[source.parents[j] for j in at]]
        known = np.array(list(self.bones.values()))
        a, b = (np.linalg.norm(v, axis=1) for v in (theirs, known))
        if not a.all():
            return False
        cosine = np.sum(theirs * known, axis=1) / (a * b)
        ratio = a / b
        alike = np.ptp(ratio) < _NEAR_LENGTH * ratio.mean() or not self.same_lengths
        return bool(alike and cosine.min() > np.cos(np.radians(_NEAR_DEG)))

    def frames(self) -> dict[int, Array]:
        """F (3,3) by our joint index."""
        return {INDEX[n]: ori.exp(np.radians(v)) for n, v in self.F.items()}


def known(source: ForeignMotion) -> Rig | None:
    """The rig of a source, if it is one of `RIGS`."""
    return next((rig for rig in RIGS if rig.fits(source)), None)


# CMU's legs are spread by 20 deg at zero angles. Neck and head: in the T-pose frame they turn by -16 and +16
# deg about x, so at zero angles the neck bends back and the face looks up.
_CMU_F = {"neck": (16.0, 0.0, 0.0), "head": (-16.0, 0.0, 0.0)}
_SIN, _COS = 0.34202, 0.939693
RIGS = (
    Rig(
        "rig-cmu",
        {
            "ltibia": (_SIN, -_COS, 0.0), "rtibia": (-_SIN, -_COS, 0.0),
            "lradius": (1.0, 0.0, 0.0), "rradius": (-1.0, 0.0, 0.0),
        },
        _CMU_F,
        same_lengths=False,
    ),
    Rig(
        "rig-cmu",
        {
            "LeftLeg": (_SIN, -_COS, 0.0), "RightLeg": (-_SIN, -_COS, 0.0),
            "LeftForeArm": (1.0, 0.0, 0.0), "RightForeArm": (-1.0, 0.0, 0.0),
        },
        _CMU_F,
        same_lengths=False,
    ),
    Rig(
        "rig-daz",
        {
            "lShin": (0.0, -36.8199, 0.73152), "lFoot": (-0.73152, -45.1104, -5.12064),
            "lForeArm": (28.1742, -1.7115, 0.48768), "lHand": (22.5879, 0.773209, 7.07136),
            "chest": (0.0, 11.7043, -0.48768),
        },
        {
            "neck": (-0.1, 0.3, 0.7), "head": (0.0, 0.0, 0.8),
            "left_hip": (5.2, -0.4, -0.1), "right_hip": (4.6, -0.1, 0.9),
            "left_knee": (3.9, 0.0, 0.0), "right_knee": (4.7, 0.3, 1.0),
            "left_ankle": (0.0, 0.0, -0.6), "right_ankle": (0.0, 0.2, 1.4),
            "left_shoulder": (0.0, 0.0, -7.4), "right_shoulder": (0.0, 0.3, 8.5),
            "left_elbow": (0.4, -0.2, -7.6), "right_elbow": (-0.5, 0.1, 8.2),
            "left_wrist": (0.4, -0.2, -7.6), "right_wrist": (-0.5, 0.2, 8.2),
        },
        own_limbs=False,
        # The conversion's filter rings after its T-pose: arms are off by 15 deg in frame 3, by 6 in frame 6.
        t_pose_frames=8,
    ),
    Rig(
        "rig-bandai-namco",
        {
            "LowerLeg_L": (39.0811, 0.0, 0.0), "Foot_L": (40.9854, 0.0, 0.0),
            "LowerArm_L": (24.3286, 0.0, 0.0), "Hand_L": (22.2916, 0.0, 0.0),
            "Neck": (16.3773, 0.0, 0.0), "UpperArm_L": (5.34809, 0.0, 0.0),
        },
        {
            "neck": (-70.1, -67.7, -71.7), "head": (-69.6, -68.2, -72.6),
            "left_collar": (0.6, -18.1, 3.8), "right_collar": (-177.2, -10.7, -23.8),
            "left_ankle": (39.8, 40.7, 83.0), "right_ankle": (-97.7, -96.3, 48.4),
            "left_foot": (51.0, 51.9, 78.8), "right_foot": (-87.0, -86.3, 58.9),
        },
    ),
)  # fmt: skip
