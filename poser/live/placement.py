"""Where sensors go: in words, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap import sensors as places
from mocap.body import mesh_skin
from mocap.formats._files import write_aside
from mocap.orientation import Array
from mocap.skeleton import JOINTS, Skeleton

ARMS_DEG = 40.0  # below the horizontal, so that nothing hides anything
SKIN = np.array([0.84, 0.86, 0.89])
LIGHT = np.array([0.3, 0.4, 0.87])  # towards it, from where the body is seen
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
        _view(axes, body, R, p, sensors, 1.0 if k == 0 else -1.0)
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


def _view(
    axes: Any, body: Skeleton, R: Array, p: Array, sensors: Sequence[str], side: float
) -> None:
    """One view. side: 1 from the front, -1 from behind."""
    from matplotlib.collections import PolyCollection

    look = mesh_skin(body)
    # A turn about the vertical: as seen from behind.
    corners = (look.posed(R, p) * [side, 1, side])[look.faces]
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    near = np.flatnonzero(n[:, 2] > 0)
    near = near[np.argsort(corners[near, :, 2].mean(axis=1))]
    shade = SKIN * (0.62 + 0.38 * np.clip(n[near] @ LIGHT, 0, 1))[:, None]
    axes.add_collection(
        PolyCollection(
            list(corners[near, :, :2]), facecolors=shade, edgecolors=shade, linewidths=0.3
        )
    )
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
    apart = 14 if abs(x) > 0.02 else 80  # beside the trunk, not on it
    axes.annotate(
        name.replace("_", " "), (x, y), xytext=(apart if right else -apart, 0), textcoords="offset points",
        ha="left" if right else "right", va="center", fontsize=9, zorder=4,
        arrowprops={"arrowstyle": "-", "lw": 0.7, "color": "#d9480f"},
    )  # fmt: skip
