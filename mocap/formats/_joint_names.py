"""Which joint of a foreign skeleton is which of ours, by name and by structure.

Tools disagree about names ("LeftShoulder" is a collar bone to Mixamo and an upper arm to Xsens), so a
name that two of our joints could have goes to the one that no clearer name claims.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from mocap.skeleton import JOINTS

# For one side, clearest name first; the joints claim in this order.
_LIMBS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("hip", ("upleg", "upperleg", "thigh", "femur", "hip")),
    ("knee", ("knee", "lowerleg", "lowleg", "shin", "calf", "tibia", "leg")),
    ("ankle", ("ankle", "foot")),
    ("foot", ("toebase", "toe", "toes", "toe0", "ball", "foot")),
    ("shoulder", ("upperarm", "uparm", "humerus", "shldr", "arm", "shoulder")),
    ("collar", ("collar", "clavicle", "shoulder")),
    ("elbow", ("elbow", "forearm", "lowerarm", "lowarm", "radius")),
    ("wrist", ("wrist", "hand")),
    ("hand", ("handmiddle1", "middle1", "mid1", "fingers", "fingerbase", "handindex1", "index1", "hand")),
)  # fmt: skip
_CENTRE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("neck", ("neck", "neck1", "lowerneck", "upperneck")),
    ("head", ("head",)),
)
REQUIRED = tuple(f"{s}_{j}" for j in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
                 for s in ("left", "right"))  # fmt: skip
_STEMS = frozenset(stem for _, stems in _LIMBS for stem in stems)
# Prefixes that tools put before every name: "mixamorig:", "Bip01 ", "Character1_", "b_".
_PREFIX = re.compile(r"^(?:.*[:|]|mixamorig\d*|bip0*1[ _]|character\d+_|j?bip_c_|b_|def-)", re.I)


def split_side(name: str) -> tuple[str, str]:
    """`("left" | "right" | "", stem)` of a joint name, the stem lower case without punctuation.

    Understands LeftArm, left_arm, lShldr, L_Thigh, Thigh.L, UpperArm_R, "Bip01 L Calf", lfemur.
    """
    name = _PREFIX.sub("", name.strip())
    flat = re.sub(r"[^a-z0-9]", "", name.lower())
    for side in ("left", "right"):
        if flat.startswith(side):
            return side, flat.removeprefix(side)
        if flat.endswith(side):
            return side, flat.removesuffix(side)
    for letter, side in (("l", "left"), ("r", "right")):
        if re.match(rf"{letter}(?:[ _.\-]|(?=[A-Z]))", name, re.I) and re.match(
            rf"[{letter}{letter.upper()}](?:[ _.\-]|[A-Z])", name
        ):
            return side, flat[1:]
        if re.search(rf"[ _.\-]{letter}$", name, re.I):
            return side, flat[:-1]
        if flat.startswith(letter) and flat[1:] in _STEMS:
            return side, flat[1:]
    return "", flat


def match(names: Sequence[str], given: dict[str, str] | None = None) -> dict[str, int]:
    """Index of the source joint for each of our joints whose name was recognised.

    names: the source's joint names, "" for those that cannot be matched. given: source name to our
    name, which overrides. The pelvis and the spine are found by structure, not here.
    """
    ours: dict[str, int] = {}
    for source, joint in (given or {}).items():
        if source in names and joint in JOINTS:
            ours[joint] = names.index(source)
    by_name: dict[tuple[str, str], int] = {}
    for i, name in enumerate(names):
        if name:
            by_name.setdefault(split_side(name), i)
    wanted = [(f"{side}_{j}", (side, s)) for side in ("left", "right") for j, s in _LIMBS]
    wanted += [(j, ("", s)) for j, s in _CENTRE]
    for joint, (side, stems) in wanted:
        for stem in stems:
            found = by_name.get((side, stem))
            if joint not in ours and found is not None and found not in ours.values():
                ours[joint] = found
    return ours
