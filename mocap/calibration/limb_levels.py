"""The levels of a limb: do its left and right sensors move like those next to them on the same side?

While one leg swings, its thigh, shank and foot are all busier than those of the other leg. A level that is
busy when the others of its side are not has left and right exchanged. And a sensor that turns with the
levels of another limb rather than with those of its own is on that limb.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from mocap.calibration import facing as face
from mocap.calibration import headings as heads
from mocap.orientation import Array
from mocap.recording import RawRecording

AGREEING = 0.4  # correlation of the sides' activity along a limb above which two levels are on the same sides
TELLING = 0.3  # standard deviation of the difference of the sides from which its course tells


def activity(raw: RawRecording) -> Array:
    """(T,S): log of the squared rate of rotation, rad^2/s^2, averaged over 0.3 s.

    Independent of mounting and heading; invalid samples count as rest.
    """
    gyr = np.where(raw.valid[..., None], np.nan_to_num(raw.gyr), 0.0)
    n = max(1, round(0.3 * raw.rate_hz))
    return np.asarray(np.log(uniform_filter1d((gyr**2).sum(-1), n, axis=0) + 0.05))


def busier(raw: RawRecording, pairs: dict[str, tuple[int, int]]) -> dict[str, Array]:
    """d_x (T,) of each level where one side is now and then busier: elsewhere nothing tells sides."""
    act = activity(raw)
    d = {x: act[:, left] - act[:, right] for x, (left, right) in pairs.items()}
    return {x: v for x, v in d.items() if v.std() > TELLING}


def levels(sensors: tuple[str, ...], joints: np.ndarray, part: str) -> dict[str, tuple[int, int]]:
    """Levels of the arms or legs that have a sensor on both sides: {"shank": (left, right), ...}."""
    found = {}
    for s, name in enumerate(sensors):
        kind = face.kind(name)
        other = f"right_{kind}"
        on_left = name == f"left_{kind}" and heads.limb(int(joints[s])) == f"left_{part}"
        if on_left and other in sensors:
            found[kind] = (s, sensors.index(other))
    return found


def agrees(raw: RawRecording, joints: np.ndarray, kind: str) -> bool:
    """Does another level of the limb of `kind` ("forearm") have its left and right where that has them?

    joints (S,): of the sensors. False for a pair that is alone on its limbs.
    """
    for part in ("arm", "leg"):
        pairs = levels(raw.sensors, joints, part)
        if kind not in pairs:
            continue
        d = busier(raw, pairs)
        own = d.pop(kind, None)
        return own is not None and any(np.corrcoef(own, v)[0, 1] > AGREEING for v in d.values())
    return False
