"""Where sensors go: in words, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap import sensors as places
from mocap.formats._files import write_aside
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, Skeleton

ARMS_DEG = 40.0  # below the horizontal, so that nothing hides anything
THICK = {"thigh": 17.0, "shank": 13.0, "trunk": 36.0, "arm": 11.0, "head": 24.0, "foot": 9.0}
_WORDS = {
    "pelvis": "at the back, on the sacrum, under the belt",
    "head": "on a headband or cap, at the side",
    "lower_back": "at the back, above the belt",
    "upper_back": "at the back, between the shoulder blades",
    "sternum": "on the breastbone",
    "shoulder_blade": "on the shoulder blade",
    "upper_arm": "outside of the upper arm, halfway",
    "forearm": "back of the forearm, just above the wrist",
    "hand": "back of the hand",
    "wrist": "on the wrist, like a watch",
    "thigh": "front of the thigh, halfway",
    "pocket": "in the front trouser pocket",
    "shank": "front of the shank, below the knee, on the bone",
    "foot": "on the instep of the shoe",
}


def words(place: str) -> str:
    """Where a sensor goes: `left forearm: back of the forearm, just above the wrist`."""
    kind = place.removeprefix("left_").removeprefix("right_")
    return f"{place.replace('_', ' ')}: {_WORDS.get(kind, 'on this bone')}"


def draw(path: Path, sensors: Sequence[str], skeleton: Skeleton | None = None) -> None:
    """Write a picture of a body from the front and from behind with a dot for every sensor.

    The file appears whole or not at all.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    body = skeleton or Skeleton.default()
    R, p = _stance(body)
    figure = Figure(figsize=(9.0, 5.6), dpi=110)
    FigureCanvasAgg(figure)
    for k, title in enumerate(("front", "back")):
        axes = figure.add_axes((0.02 + 0.49 * k, 0.02, 0.47, 0.9))
        # From the front the wearer's left is on the right of the picture.
        _view(axes, R, p, sensors, 1.0 if k == 0 else -1.0)
        axes.set_title(title)
    figure.text(
        0.5, 0.02, "an empty circle is on the other side of the body", ha="center", fontsize=9
    )
    with write_aside(path) as aside:
        figure.savefig(aside)


def _stance(body: Skeleton) -> tuple[Array, Array]:
    R = np.tile(np.eye(3), (24, 1, 1))
    down = np.deg2rad(ARMS_DEG)
    R[JOINTS.index("left_shoulder")] = ori.rot_z(-down)
    R[JOINTS.index("right_shoulder")] = ori.rot_z(down)
    return body.forward(R, np.array([0.0, 0.95, 0.0]))


def _view(axes: Any, R: Array, p: Array, sensors: Sequence[str], side: float) -> None:
    """One view. side: 1 from the front, -1 from behind."""
    for j, parent in enumerate(PARENTS):
        if parent >= 0:
            x, y = side * p[[parent, j], 0], p[[parent, j], 1]
            axes.plot(x, y, color="#c9ced6", lw=_width(JOINTS[j]), solid_capstyle="round", zorder=1)
    head = p[JOINTS.index("head")]
    axes.plot(side * head[0], head[1] + 0.06, "o", ms=30, color="#c9ced6", zorder=1)
    for name in sensors:
        place = places.lookup(name)
        at = p[place.joint] + R[place.joint] @ np.array(place.position)
        # A seat behind the bone is seen from behind.
        seen = abs(place.position[2]) < 0.03 or np.sign(place.position[2]) == side
        axes.plot(
            side * at[0], at[1], "o", ms=9, zorder=3, color="#d9480f" if seen else "none",
            markeredgecolor="#d9480f", markeredgewidth=1.5,
        )  # fmt: skip
        if seen:
            _label(axes, name, side * at[0], at[1])
    axes.set_xlim(-0.95, 0.95)
    axes.set_ylim(-0.08, 1.72)
    axes.set_aspect("equal")
    axes.axis("off")


def _label(axes: Any, name: str, x: float, y: float) -> None:
    right = x > 0.02 or (abs(x) <= 0.02 and name != "pelvis")
    axes.annotate(
        name.replace("_", " "), (x, y), xytext=(14 if right else -14, 0), textcoords="offset points",
        ha="left" if right else "right", va="center", fontsize=9, zorder=4,
    )  # fmt: skip


def _width(joint: str) -> float:
    kinds = (
        ("knee", "thigh"), ("ankle", "shank"), ("foot", "foot"), ("elbow", "arm"), ("wrist", "arm"),
        ("hand", "arm"), ("head", "head"), ("neck", "head"),
    )  # fmt: skip
    return next((THICK[kind] for part, kind in kinds if joint.endswith(part)), THICK["trunk"])
