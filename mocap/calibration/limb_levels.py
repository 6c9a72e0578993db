"""The levels of a limb: do its left and right sensors move like those next to them on the same side?

While one leg swings, its thigh, shank and foot are all busier than those of the other leg. A level that is
busy when the others of its side are not has left and right exchanged. And a sensor that turns with the
levels of another limb rather than with those of its own is on that limb.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter1d

from mocap.calibration import facing as face
from mocap.calibration import headings as heads
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import RawRecording

SWAPPED = -0.3  # correlation of the sides' activity along a limb below which names are exchanged
AGREEING = 0.4  # ... above which two levels are on the same sides
MISPLACED = 0.5  # how much more two sensors must turn with each other's limbs than with their own
TELLING = 0.3  # standard deviation of the difference of the sides from which its course tells


def activity(raw: RawRecording) -> Array:
    """(T,S): log of the squared rate of rotation, rad^2/s^2, averaged over 0.3 s.

    Independent of mounting and heading; invalid samples count as rest.
    """
    gyr = np.where(raw.valid[..., None], np.nan_to_num(raw.gyr), 0.0)
    n = max(1, round(0.3 * raw.rate_hz))
    return np.asarray(np.log(uniform_filter1d((gyr**2).sum(-1), n, axis=0) + 0.05))


def check_swapped(
    raw: RawRecording, joints: np.ndarray, R_world_sensor: Array | None = None
) -> list[Finding]:
    """Are left and right exchanged on one level of a limb?

    d_x = (activity of the left sensor) - (that of the right one) on level x, say the shanks. While
    one leg swings, its thigh, shank and foot are all the busier ones: d_x and d_y correlate. A pair
    of levels with a clearly negative correlation has one of the two exchanged. That alone errs in a
    fast walk, where the thighs of both legs are always busy; with R_world_sensor (T,S,3,3) in one
    world, the rates of rotation as vectors must be more alike across than along the limbs, too; and
    there an arm's sensor that is exchanged with a leg's is named.
    """
    alike = None if R_world_sensor is None else _alike(raw, R_world_sensor)
    if alike is not None and raw.common_heading:
        # In worlds of their own, what turns alike may seem to turn oppositely. And the sides of a level
        # tell nothing while a sensor of another limb is in it.
        misplaced = _misplaced(raw.sensors, joints, alike)
        if misplaced:
            return misplaced
    found: list[Finding] = []
    for part in ("arm", "leg"):
        pairs = levels(raw.sensors, joints, part)
        d = _busier(raw, pairs)
        if len(d) < 2:
            continue
        if alike is None or _crossed([pairs[x] for x in d], alike):
            found += _exchanged(d)
    return found


def _busier(raw: RawRecording, pairs: dict[str, tuple[int, int]]) -> dict[str, Array]:
    """d_x (T,) of each level where one side is now and then busier: elsewhere nothing tells sides."""
    act = activity(raw)
    d = {x: act[:, left] - act[:, right] for x, (left, right) in pairs.items()}
    return {x: v for x, v in d.items() if v.std() > TELLING}


def _alike(raw: RawRecording, R_world_sensor: Array) -> Array:
    """Correlations (S,S) of the rates of rotation in the world, as vectors, below 3 Hz."""
    w = np.einsum("tsij,tsj->tsi", R_world_sensor, raw.gyr)
    w[~(raw.valid & np.isfinite(w).all(-1))] = 0.0
    w = face.lowpass(w, 3.0, raw.rate_hz)
    C = np.einsum("tai,tbi->ab", w, w)
    size = np.sqrt(np.maximum(np.diag(C), 1e-12))
    return np.asarray(C / np.outer(size, size))


def _misplaced(sensors: tuple[str, ...], joints: np.ndarray, C: Array) -> list[Finding]:
    """Is a sensor of an arm exchanged with one of a leg, such as a hand with a foot?

    C (S,S): how alike they turn. The gain of exchanging i and j is the mean of C[i, k] - C[j, k] over the
    others k of the limb of j, plus the same the other way round: arm with leg in 178 right suits of other
    people at most 0.28, in eleven of their sensors 0.36. Where left with right of a limb gains more, it is
    for the levels to say. Where limbs have two sensors each, their other two may as well be exchanged.
    """
    limb = [heads.limb(int(j)) for j in joints]
    gains: dict[tuple[int, int], float] = {}
    for i, j in combinations(range(len(sensors)), 2):
        if limb[i] == limb[j] or "trunk" in (limb[i], limb[j]):
            continue
        with_i, with_j = (
            [k for k, x in enumerate(limb) if x == limb[a] and k != a] for a in (i, j)
        )
        if with_i and with_j:
            apart = C[i] - C[j]
            gains[i, j] = float(apart[with_j].mean() - apart[with_i].mean())
    most = max(gains.values(), default=0.0)
    named = [pair for pair, gain in gains.items() if gain > most - 1e-9]
    across = all({face.kind(limb[i]), face.kind(limb[j])} == {"arm", "leg"} for i, j in named)
    if most < MISPLACED or not across:
        return []
    options = " (or else ".join(f"{sensors[i]} and {sensors[j]}" for i, j in named)
    text = (
        f"{options}{')' * (len(named) - 1)} are probably exchanged: each turns with the other sensors of the "
        f"other's limb (by {most:.2f} of a correlation more than with those of its own)"
    )
    return [Finding("warning", sensors[s], "swapped", text, most) for pair in named for s in pair]


def _crossed(levels: list[tuple[int, int]], C: Array) -> bool:
    """Is there a pair of levels whose sensors are more alike across the sides than along them?"""
    return any(
        C[left, right_2] + C[right, left_2] > C[left, left_2] + C[right, right_2]
        for (left, right), (left_2, right_2) in combinations(levels, 2)
    )


def _exchanged(d: dict[str, Array]) -> list[Finding]:
    """The levels whose exchange makes the side differences agree; few exchanges before many."""
    names = list(d)
    if len(names) < 2:
        return []
    C = np.corrcoef(np.array([d[n] for n in names]))
    pairs = list(combinations(range(len(names)), 2))
    if all(C[i, j] > SWAPPED for i, j in pairs):
        return []
    best, best_score = [names], [-np.inf]
    for count in range(len(names) // 2 + 1):
        for flipped in combinations(range(len(names)), count):
            sign = np.array([-1.0 if i in flipped else 1.0 for i in range(len(names))])
            score = sum(sign[i] * sign[j] * C[i, j] for i, j in pairs)
            group = [names[i] for i in flipped]
            if score > best_score[0] + 1e-9:
                best, best_score = [group], [score]
            elif abs(score - best_score[0]) <= 1e-9:
                best.append(group)
    worst = float(min(C[i, j] for i, j in pairs))
    options = [" and ".join(f"left_{x} and right_{x}" for x in group) for group in best if group]
    if not options:
        return []
    text = (
        f"{' (or else '.join(options)}{')' * (len(options) - 1)} are probably exchanged: when the left "
        f"one of one level of the limb moves, the right one of the next does (correlation {worst:.2f})"
    )
    return [
        Finding("warning", f"{side}_{x}", "swapped", text, worst)
        for group in best
        for x in group
        for side in ("left", "right")
    ]


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
        d = _busier(raw, pairs)
        own = d.pop(kind, None)
        return own is not None and any(np.corrcoef(own, v)[0, 1] > AGREEING for v in d.values())
    return False
