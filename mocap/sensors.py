"""Sensor places: names, the joint whose rotation a sensor follows, its seat on the bone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap.errors import SensorError

if TYPE_CHECKING:
    import numpy as np

    from mocap.orientation import Array


@dataclass(frozen=True)
class Place:
    """Where a sensor sits: `joint` it rotates with, `position` (x,y,z) m in that bone's rest frame."""

    name: str
    joint: int
    position: tuple[float, float, float]


# Left side or centre; the right side has x negated.
_CENTRE = (
    ("pelvis", 0, (0.0, 0.02, -0.12)),
    ("head", 15, (0.07, 0.08, 0.0)),
    ("lower_back", 3, (0.0, 0.0, -0.10)),
    ("upper_back", 9, (0.0, 0.10, -0.13)),
    ("sternum", 9, (0.0, 0.08, 0.10)),
)
_LEFT = (
    ("shoulder_blade", 13, (0.05, 0.0, -0.08)),
    ("upper_arm", 16, (0.12, 0.0, -0.04)),
    ("forearm", 18, (0.20, 0.02, 0.02)),
    ("hand", 20, (0.05, 0.02, 0.0)),
    ("wrist", 18, (0.22, 0.03, 0.0)),
    ("thigh", 1, (0.02, -0.15, 0.08)),
    ("pocket", 1, (0.04, -0.08, 0.09)),
    ("shank", 4, (0.02, -0.12, 0.05)),
    ("foot", 7, (0.0, -0.02, 0.08)),
)


def _places() -> dict[str, Place]:
    table = {name: Place(name, joint, xyz) for name, joint, xyz in _CENTRE}
    for name, joint, (x, y, z) in _LEFT:
        table[f"left_{name}"] = Place(f"left_{name}", joint, (x, y, z))
        # In the SMPL numbering the right joint follows the left one.
        table[f"right_{name}"] = Place(f"right_{name}", joint + 1, (-x, y, z))
    return table


PLACES: dict[str, Place] = _places()
SIX = ("left_forearm", "right_forearm", "left_shank", "right_shank", "head", "pelvis")
FIVE = ("left_wrist", "right_wrist", "left_pocket", "right_pocket", "head")
SUIT = (
    "pelvis", "sternum", "head", "left_shoulder_blade", "right_shoulder_blade", "left_upper_arm",
    "right_upper_arm", "left_forearm", "right_forearm", "left_hand", "right_hand", "left_thigh",
    "right_thigh", "left_shank", "right_shank", "left_foot", "right_foot",
)  # fmt: skip
"""The 17 of a full suit: what `all` means to `synthesize`."""
SETS: dict[str, tuple[str, ...]] = {"six": SIX, "five": FIVE, "all": SUIT}


def parse(spec: str, available: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Sensor names of a command-line spec: `six`, `five`, `all`, or names separated by commas.

    With `available` (what a recording has), `all` means exactly those, and every name must be among
    them. Raises SensorError naming what is unknown, doubled or absent.
    """
    spec = spec.strip()
    if spec == "all" and available is not None:
        return tuple(available)
    names = SETS.get(spec) or tuple(n.strip() for n in spec.split(",") if n.strip())
    if not names:
        raise SensorError(f"sensor list {spec!r} names no sensor")
    doubled = sorted({n for n in names if names.count(n) > 1})
    if doubled:
        raise SensorError(f"sensor list names {', '.join(doubled)} twice")
    known = available if available is not None else tuple(PLACES)
    missing = [n for n in names if n not in known]
    if missing:
        what = "not in the recording" if available is not None else "unknown"
        raise SensorError(
            f"sensor {', '.join(missing)} {what}; there is: {', '.join(known)} "
            f"(or the sets six, five, all)"
        )
    return names


def lookup(name: str) -> Place:
    """The table's place of that name; raises SensorError listing the known names."""
    if name not in PLACES:
        raise SensorError(f"sensor place {name!r} unknown; known: {', '.join(PLACES)}")
    return PLACES[name]


def joints_and_seats(names: tuple[str, ...]) -> tuple[np.ndarray, Array]:
    """Joint indices (S,) int and seats (S,3) m of table places."""
    places = [lookup(n) for n in names]
    import numpy as np  # names of places alone, as a parser lists them, need it not

    joints = np.array([p.joint for p in places], dtype=np.int64)
    return joints, np.array([p.position for p in places], float).reshape(-1, 3)


def describe(name: str, joint: int) -> str:
    """`left_forearm (left_elbow)`: the sensor and the joint whose rotation it follows."""
    from mocap.tree import JOINTS

    return f"{name} ({JOINTS[joint]})"
