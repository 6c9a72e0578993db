"""Was the pose the other one: a T-pose called N, or an N-pose called T?

The pose itself cannot tell, as nobody knows how a sensor sits on its arm. What the arms do otherwise can:
they hang for most of the time that people stand. With d the arm's direction in the body's frame during the
pose, +-e_x in a T-pose and (+-cos a, -sin a, 0) in an N-pose, and v = C_s R_ws^T e_y the up vector carried
to the pose (`mocap.calibration.facing`), turned so that the wearer faces +z, the arm points downward by

    down = -d . v,    1 hanging, 0 horizontal, -1 up.

The right name of the pose is the one by which the arms hang. An N-pose called T has arms that never hang, but
stay as they were in the pose; a T-pose called N has left arms that carry up to the right by some 80 deg,
right arms to the left, as no arm does for long after an N-pose.
"""

from __future__ import annotations

import numpy as np

from mocap.calibration import facing as face
from mocap.calibration.static_pose import Pose, Window
from mocap.calibration.stillness import still_runs
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording

PAIRS = ("upper_arm", "forearm", "wrist")
BODY = ("pelvis", "sternum", "lower_back", "upper_back", "left_thigh", "right_thigh", "left_pocket",
        "right_pocket", "left_shank", "right_shank")  # fmt: skip
UPRIGHT_DEG = 25.0  # mean tilt since the pose of trunk and legs
STILL_S, UPRIGHT_S = 1.0, 5.0  # standing still, or upright at all, for that long: enough to tell by
CERTAIN_S = 10.0  # upright: a short recording may hold nothing but both poses
APART = 0.2  # by how much more downward the arms must point by one name than by the other, median
HANGING = 0.5  # down from which an arm hangs
HELD_DEG = 35.0  # tilt since the pose up to which arms are as in the pose
BROKEN_S = 0.5  # stances less apart than that are one
OFF_DEG = (60.0, 100.0)  # tilt since the pose of arms that hang after a T-pose
SELDOM = 0.03  # of the upright time: whoever did stand in a T-pose has the arms down for longer
SIGMA_DEG = 45.0  # of the facing, from which left and right are not known


def check_pose_name(
    raw: RawRecording,
    window: Window,
    pose: Pose,
    facing: Array,
    sigma: Array,
    name: str,
    arm_angle_deg: float = 80.0,
) -> list[Finding]:
    """Does the rest of the recording say that the pose was T where `name` is "n", or N where it is "t"?

    facing (S,) rad: the wearer's forward in each sensor's world, sigma (S,) its uncertainty. Judged over the
    frames in which the wearer stands still and upright outside the window, else over all upright ones. An
    error where a pair of upper arms and one of forearms say T both then and over 10 s of upright frames. Of
    several pairs the one nearest to the trunk counts; forearms alone say T only of a later stance.

    Not seen: a pose without a pair of sensors on the arms, or with too little upright time after it; arms
    that never hang after a T-pose called N, or that are held across the body's side after an N-pose called
    T; other angles of the arms; and where the facing is not known and headings are the sensors' own.
    """
    upright = _upright(raw, window, pose)
    still = upright & _still(raw, window)
    pairs = _pairs(raw, window, pose, facing, sigma, upright)
    for chosen, seconds, when in (
        (still, STILL_S, "whenever the body stands still"),
        (upright, UPRIGHT_S, "for most of the time that the body is upright"),
    ):
        if not pairs or chosen.sum() < seconds * raw.rate_hz:
            continue
        if (
            name == "n"
            and chosen is upright
            and not {"left_upper_arm", "right_upper_arm"} <= set(raw.sensors)
        ):
            continue  # forearms are held in front of the body for minutes
        said = [_say(ups, phi, chosen, upright, name, arm_angle_deg) for ups, phi in pairs]
        if said[0]:
            sure = (
                chosen is still
                and upright.sum() >= CERTAIN_S * raw.rate_hz
                and len(said) > 1
                and all(x is not None and x[1] for x in said)
            )
            return [_finding(name, said[0][0], when, sure)]
    return []


def _finding(name: str, degrees: float, when: str, sure: bool) -> Finding:
    if name == "n":
        text = f"the arms are about {degrees:.0f} deg from the N-pose {when}: was it a T-pose (--pose t)?"
        return Finding("error" if sure else "warning", None, "other-pose", text, degrees)
    text = (
        f"the arms are where they were in the pose {when}, to {degrees:.0f} deg, and never hang as they "
        f"would after a T-pose: was it an N-pose (--pose n)?"
    )
    return Finding("warning", None, "other-pose", text, degrees)


def _pairs(
    raw: RawRecording, window: Window, pose: Pose, facing: Array, sigma: Array, upright: Bool
) -> list[tuple[list[Array], Array]]:
    """Of each pair of arm sensors whose facing is known: v (T,3) of the left and the right, facing (2,)."""
    pairs = []
    for kind in PAIRS:
        sides = [f"left_{kind}", f"right_{kind}"]
        if set(sides) <= set(raw.sensors):
            worn = [raw.sensors.index(n) for n in sides]
            ups = [_up(raw, pose, s) for s in worn]
            phi = _facing(raw, window, pose, facing, sigma, worn, ups, upright)
            if phi is not None:
                pairs.append((ups, phi))
    return pairs


def _say(
    ups: list[Array], phi: Array, chosen: Bool, upright: Bool, name: str, angle: float
) -> tuple[float, bool] | None:
    """Median tilt of the arms in deg and whether all upright frames agree; None where the name fits."""
    a = np.radians(angle)
    tilts, sure = [], True
    for up, heading, sign in zip(ups, phi, (1.0, -1.0), strict=True):
        left = np.imag(face.complex_heading(up) * np.exp(-1j * heading))
        by_t = -sign * left
        by_n = np.sin(a) * up[:, 1] - np.cos(a) * sign * left
        t, n, all_t, all_n = (_median(x, c) for c in (chosen, upright) for x in (by_t, by_n))
        if name == "n":
            if not (t > HANGING and t - n > APART):
                return None
            sure &= all_t > HANGING and all_t - all_n > APART
        else:
            hangs = by_t[upright] > HANGING
            if not (
                n > HANGING and n - t > APART and all_n - all_t > APART and hangs.mean() < SELDOM
            ):
                return None
        tilts.append(float(np.degrees(np.arccos(np.clip(_median(up[:, 1], chosen), -1, 1)))))
    degrees = float(np.mean(tilts))
    low, high = OFF_DEG if name == "n" else (0.0, HELD_DEG)
    return (degrees, sure) if low <= degrees <= high else None


def _median(x: Array, which: Bool) -> float:
    x = x[which]
    x = x[np.isfinite(x)]
    return float(np.median(x)) if len(x) else np.nan


def _up(raw: RawRecording, pose: Pose, s: int) -> Array:
    """v (T,3) of one sensor, NaN where it is invalid."""
    assert raw.R_world_sensor is not None
    v = raw.R_world_sensor[:, s, 1, :] @ pose.R_world_sensor[s].T
    return np.where(raw.valid[:, s, None], v, np.nan)


def _outside(raw: RawRecording, window: Window) -> Bool:
    frames = np.arange(len(raw))
    return (frames < window.start) | (frames >= window.stop)


def _upright(raw: RawRecording, window: Window, pose: Pose) -> Bool:
    """Frames (T,) outside the window in which trunk and legs tilt by less than UPRIGHT_DEG, mean."""
    worn = [s for s, n in enumerate(raw.sensors) if n in BODY]
    outside = _outside(raw, window)
    if not worn:
        return outside
    ups = np.stack([_up(raw, pose, s)[:, 1] for s in worn])
    seen = np.isfinite(ups)
    tilt = np.degrees(np.arccos(np.clip(np.where(seen, ups, 1.0), -1, 1)))
    return outside & (tilt.sum(axis=0) < UPRIGHT_DEG * np.maximum(seen.sum(axis=0), 1))


def _still(raw: RawRecording, window: Window) -> Bool:
    """Frames (T,) of still runs other than the stance of the pose, which noise may have broken up."""
    runs = still_runs(raw)
    start, stop = window.start, window.stop
    near = BROKEN_S * raw.rate_hz
    for a, b in runs:
        if a < stop + near:
            stop = max(stop, b)
    for a, b in reversed(runs):
        if b > start - near:
            start = min(start, a)
    still = np.zeros(len(raw), bool)
    for a, b in runs:
        still[a:b] = True
    still[start:stop] = False
    return still


def _facing(
    raw: RawRecording,
    window: Window,
    pose: Pose,
    facing: Array,
    sigma: Array,
    worn: list[int],
    ups: list[Array],
    upright: Bool,
) -> Array | None:
    """Facing (2,) rad for a pair of arms, or None.

    With a common heading what legs and trunk say goes first: arms after a wrong T-pose say the opposite.
    Where nobody says, that of arms which carry up in opposite directions, the left one to the right.
    """
    if raw.common_heading:
        cues = face.from_motion(raw, pose, window)
        if len(cues) > 1:
            phi, spread, kept = face.combine(cues)
            if spread < np.radians(SIGMA_DEG) and not face.ambiguous(cues, phi, kept):
                return np.full(2, phi)
    if (sigma[worn] < np.radians(SIGMA_DEG)).all():
        return facing[worn]
    if not raw.common_heading:
        return None
    left, right = (np.nanmean(face.complex_heading(up[upright])) for up in ups)
    if abs(left - right) < 1.7 * max(abs(left), abs(right)):
        return None
    return np.full(2, np.angle((right - left) / 1j))
