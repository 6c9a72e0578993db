"""Ranges of the joints' rotation vectors, from anatomy.

Source: the ranges of motion of clinical goniometry (American Academy of Orthopaedic Surgeons, 1965; the
same figures stand in every textbook of physiotherapy), put on the axes of the rest pose: y up, the body
faces +z, its left is +x, arms to the sides. For the left side and the middle:

    flexion of hip, neck, trunk about x (hip: thigh forward is -x, knee: heel back is +x)
    turning about y, except for the hanging leg's twist, also y; the arm's twist is x
    left arm up +z, down -z; left arm or elbow forward -y; left leg outward +z

The right side is the mirror image: (x, y, z) -> (x, -y, -z). One joint here stands for several of
anatomy: the trunk's range is shared among spine1 to spine3, the neck's among neck and head, the
shoulder girdle's between collar and shoulder; pronation, which anatomy puts into the forearm, may sit in
elbow or wrist. The components of a rotation vector are clinical angles only where one of them moves, so
MARGIN_DEG is added on both ends.
"""

from __future__ import annotations

import numpy as np

from mocap.orientation import Array
from mocap.skeleton import JOINTS

MARGIN_DEG = 20.0
# (lower, upper) about x, y, z, in degrees, left side.
_MIDDLE = {
    "spine1": ((-15, 40), (-20, 20), (-20, 20)),
    "spine2": ((-15, 30), (-20, 20), (-20, 20)),
    "spine3": ((-15, 30), (-20, 20), (-20, 20)),
    "neck": ((-40, 40), (-50, 50), (-30, 30)),
    "head": ((-40, 40), (-50, 50), (-30, 30)),
}
_LEFT = {
    "hip": ((-125, 30), (-45, 45), (-30, 60)),
    "knee": ((0, 145), (-20, 20), (-10, 10)),
    "ankle": ((-20, 50), (-30, 30), (-30, 30)),
    "foot": ((-60, 30), (-10, 10), (-10, 10)),
    "collar": ((-20, 20), (-30, 30), (-20, 45)),
    "shoulder": ((-90, 90), (-130, 45), (-90, 110)),
    "elbow": ((-90, 90), (-150, 0), (-60, 60)),
    "wrist": ((-90, 90), (-30, 30), (-80, 80)),
    "hand": ((-20, 20), (-20, 20), (-90, 20)),
}


def ranges() -> tuple[Array, Array]:
    """lower, upper (24,3) rad of Log(R_parent_joint), margin included; the root's are infinite."""
    lower, upper = np.full((24, 3), -np.inf), np.full((24, 3), np.inf)
    for j, name in enumerate(JOINTS[1:], start=1):
        side, _, part = name.partition("_")
        table = np.array(_MIDDLE[name] if name in _MIDDLE else _LEFT[part], float)
        if side == "right":
            table[1:] = -table[1:, ::-1]
        lower[j] = np.deg2rad(table[:, 0] - MARGIN_DEG)
        upper[j] = np.deg2rad(table[:, 1] + MARGIN_DEG)
    return lower, upper
