"""Where the wearer faces in the static pose, in the world of the sensors: absolute cues.

Why it is needed. Let phi_s be the heading of the wearer's forward in the pose, in the world of sensor s
(forward = R_y(phi_s) e_z). The calibration defines bones by a pose in which the wearer faces +z, so

    R_world_bone(t) = R_y(-phi_s) [R_ws(t) R_ws(pose)^T] R_y(phi_s) B_s,    B_s the bone in the pose.

A wrong phi_s conjugates every rotation since the pose by the error: a knee that bends about the
left-right axis seems to bend about an axis turned by the error, and accelerations are turned likewise.
One static pose shows gravity only, and says nothing of phi_s. With a common heading there is one phi;
with 6-axis orientation each sensor has its own. What tells it:

* a known axis of a sensor (mounted with x forward, say);
* a second static pose: from N to T the arms turn about the forward axis;
* motion: legs turn about the left-right axis in walking, squats, kicks, and knees flex backward; the
  trunk leans forward further than backward; in a gait each arm swings with the other side's leg.

The motion cues use only what is independent of heading: in the sensor's own frame carried to the pose
by C_s = R_ws(pose), the rate u = C_s gyr and the up vector v = C_s R_ws^T e_y. Turning about while
walking changes neither. Horizontal vectors are complex numbers h(d) = d_z + i d_x, whose argument is
the heading of d: forward has e^(i phi), left i e^(i phi), and R_y(a) multiplies by e^(i a).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.calibration.static_pose import StaticPose, StillWindow
from mocap.errors import CalibrationError, SensorError
from mocap.orientation import Array
from mocap.recording import RawRecording

Index = NDArray[np.int64]
DIRECTIONS = {"forward": 0.0, "left": np.pi / 2, "back": np.pi, "right": -np.pi / 2}
# Floors of the uncertainty, deg: how far the axis of that segment's motion is from left-right in people
# who walk or squat (feet point outward, arms swing inward), beyond what averaging can tell.
HINGE_FLOOR = {"thigh": 8.0, "pocket": 8.0, "shank": 7.0, "foot": 12.0}
NOT_PLANAR_DEG = 30.0  # added to the floor in proportion to 1 - planarity
HINGE_SIGN = {"thigh": 1.0, "pocket": 1.0, "shank": -1.0, "foot": -1.0}
# Not the pelvis: it tips backward in sitting and leg raising as far as forward in bending.
LEAN = {"lower_back": 10.0, "upper_back": 10.0, "sternum": 10.0, "head": 20.0}
SWING = {"upper_arm": 15.0, "forearm": 20.0, "wrist": 20.0}  # arms swing a little inward
HANGING_FLOOR_DEG = 12.0  # arms come down a little forward, and forearms bend
POSE_FLOOR_DEG = 6.0  # how exactly people raise their arms to the side
LONE = np.radians(30.0)
AGREEING = 0.75  # share of the weight that must agree, or the answer is doubtful
OPPOSITE = 0.2  # share of the weight near the opposite heading from which that is possible, too
SHARP_DEG = 15.0  # sigma below which a cue that all others contradict is a wrong heading
FROM_MOTION = ("hinge", "leaning", "arm swing", "hanging")  # beginnings of the methods of such cues
KNOWN_FLOOR_DEG = 5.0  # how exactly a sensor is strapped on


@dataclass(frozen=True)
class Cue:
    """One estimate of the facing in one sensor's world: heading and 1-sigma in rad, and its source."""

    sensor: str
    heading: float
    sigma: float
    method: str


def complex_heading(d: Array) -> Array:
    """h(d) = d_z + i d_x of vectors (...,3): its argument is their heading."""
    return d[..., 2] + 1j * d[..., 0]


def wrap(a: Array | float) -> Array:
    """Angles in (-pi, pi]."""
    return np.asarray(np.angle(np.exp(1j * np.asarray(a))))


def kind(sensor: str) -> str:
    """`left_shank` -> `shank`."""
    return sensor.removeprefix("left_").removeprefix("right_")


def carried(raw: RawRecording, pose: StaticPose, s: int) -> tuple[Array, Array, Index]:
    """u (N,3) rad/s low-passed at 5 Hz, v (N,3), and the frames (N,) they belong to, of sensor s.

    Frames that are invalid are left out.
    """
    assert raw.R_world_sensor is not None
    R = raw.R_world_sensor[:, s]
    frames = np.flatnonzero(raw.valid[:, s] & np.isfinite(R).all((-1, -2))).astype(np.int64)
    C = pose.R_world_sensor[s]
    gyr = lowpass(raw.gyr[frames, s], 5.0, raw.rate_hz)
    return gyr @ C.T, R[frames, 1, :] @ C.T, frames


def lowpass(x: Array, cutoff_hz: float, rate_hz: float) -> Array:
    """Zero-phase 2nd-order low-pass along axis 0; unchanged where it is too short or slow for it."""
    if cutoff_hz >= rate_hz / 2 or len(x) < 16:
        return x
    from scipy.signal import butter, sosfiltfilt  # slow to import, and readers filter nothing

    sos = butter(2, cutoff_hz / (rate_hz / 2), output="sos")
    return np.asarray(sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, int(rate_hz / cutoff_hz))))


def known_axes(axes: Mapping[str, str], raw: RawRecording, pose: StaticPose) -> list[Cue]:
    """Cues from declared mountings such as {"pelvis": "x forward", "head": "-z left"}.

    The sensor's axis points in that direction of the body in the pose. Raises CalibrationError where
    the text is not an axis and a direction, or the axis is within 30 deg of the vertical then.
    """
    return [_known_axis(name, text, raw, pose) for name, text in axes.items()]


def parsed_axis(text: str) -> tuple[float, int, str]:
    """Sign, axis (0: x) and direction of text such as "-z left"; raises CalibrationError for other text."""
    words = text.lower().split()
    axis = words[0].lstrip("+-") if words else ""
    if len(words) != 2 or axis not in ("x", "y", "z") or words[1] not in DIRECTIONS:
        raise CalibrationError(
            f"{text!r} is not an axis and a direction like 'x forward' or '-z left' "
            f"(directions: {', '.join(DIRECTIONS)})"
        )
    return -1.0 if words[0].startswith("-") else 1.0, "xyz".index(axis), words[1]


def _known_axis(name: str, text: str, raw: RawRecording, pose: StaticPose) -> Cue:
    if name not in raw.sensors:
        raise SensorError(
            f"axis of {name}: no such sensor in the recording; it has: {', '.join(raw.sensors)}"
        )
    try:
        sign, axis, direction = parsed_axis(text)
    except CalibrationError as e:
        raise CalibrationError(f"axis of {name}: {e}") from e
    d = sign * pose.R_world_sensor[raw.sensors.index(name)][:, axis]
    if np.hypot(d[0], d[2]) < 0.5:
        raise CalibrationError(
            f"axis of {name}: its {'xyz'[axis]} axis is {np.degrees(np.arcsin(abs(d[1]))):.0f} deg from "
            f"the horizontal in the pose, so it cannot point {direction}"
        )
    heading = float(wrap(np.angle(complex_heading(d)) - DIRECTIONS[direction]))
    return Cue(name, heading, np.radians(KNOWN_FLOOR_DEG), f"axis {text} of {name}")


def second_pose(
    raw: RawRecording, first: StaticPose, second: StaticPose, B_first: Array, B_second: Array
) -> list[Cue]:
    """Cues from two static poses whose bones B (S,3,3) are known, such as N and T.

    Up in the frame carried to the first pose is v = C_s R_ws(second)^T e_y; it should be
    B_first B_second^T e_y in the body, whatever the heading of either. Only bones that tilt by more
    than 30 deg between the poses tell.
    """
    cues = []
    for s, name in enumerate(raw.sensors):
        expected = B_first[s] @ B_second[s].T @ [0, 1.0, 0]
        seen = first.R_world_sensor[s] @ second.R_world_sensor[s].T @ [0, 1.0, 0]
        if np.hypot(expected[0], expected[2]) < 0.5 or np.hypot(seen[0], seen[2]) < 0.35:
            continue
        phi = np.angle(complex_heading(seen) * np.conj(complex_heading(expected)))
        cues.append(Cue(name, float(phi), np.radians(POSE_FLOOR_DEG), "second pose"))
    return cues


def hanging_arm(name: str, v: Array, rate_hz: float) -> Cue | None:
    """A cue from an arm that hangs down at times, after a T-pose.

    Lowered sideways from the T-pose, a left arm carries up to the right in its own frame, a right arm
    to the left. Counted: frames in which it hangs within 45 deg; None for less than 1 s of them, or
    where they point in several directions.
    """
    h = complex_heading(v) * (1.0 if name.startswith("right") else -1.0)
    down = h[np.abs(h) > np.sin(np.radians(45))]
    if len(down) < rate_hz or abs(down.sum()) < 0.8 * np.abs(down).sum():
        return None
    sigma = np.hypot(_jackknife(down, np.abs(down)), np.radians(HANGING_FLOOR_DEG))
    phi = float(wrap(np.angle(down.sum()) - np.pi / 2))
    return Cue(name, phi, float(sigma), "hanging arms")


def arm_swing(raw: RawRecording, pose: StaticPose, legs: list[Cue]) -> list[Cue]:
    """Cues for the arms from a gait: each arm swings with the leg of the other side.

    With r the difference of the forward rates of the two legs (thighs, else shanks; zero in squats and
    jumps) below 2 Hz and u the arm's rate, h(u) = c r i e^(i phi) with c > 0 for the right arm and
    c < 0 for the left, so phi = arg(+-sum h(u) r) - pi/2. It has a sign, unlike a principal axis, and
    arms that rise sideways meanwhile do not count. None where the coherence is below 0.5.
    """
    known = {c.sensor: c for c in legs}
    for part in ("thigh", "pocket", "shank"):
        if f"left_{part}" in known and f"right_{part}" in known:
            pair = known[f"left_{part}"], known[f"right_{part}"]
            break
    else:
        return []
    rate = [
        np.real(_rate(raw, pose, c.sensor) * np.conj(1j * np.exp(1j * c.heading))) for c in pair
    ]
    r = rate[0] - rate[1]
    if np.sqrt(np.mean(r**2)) < 0.3:
        return []
    walking = np.abs(r) > 0.5 * np.sqrt(np.mean(r**2))
    cues = []
    for name in raw.sensors:
        if kind(name) not in SWING:
            continue
        h = _rate(raw, pose, name) * (1.0 if name.startswith("right") else -1.0)
        z, weight = (h * r)[walking], np.abs(h * r)[walking]
        power = (np.abs(h[walking]) ** 2).sum() * (r[walking] ** 2).sum()
        if power == 0 or abs(z.sum()) < 0.5 * np.sqrt(power):
            continue
        sigma = np.hypot(_jackknife(z, weight), np.radians(SWING[kind(name)]))
        phi = float(wrap(np.angle(z.sum()) - np.pi / 2))
        cues.append(Cue(name, phi, float(sigma), "arm swing"))
    return cues


def _rate(raw: RawRecording, pose: StaticPose, sensor: str) -> Array:
    """h(u) (T,) of one sensor below 2 Hz, zero where it is invalid."""
    s = raw.sensors.index(sensor)
    u, _, frames = carried(raw, pose, s)
    full = np.zeros((len(raw), 3))
    full[frames] = u
    return complex_heading(lowpass(full, 2.0, raw.rate_hz))


def from_motion(
    raw: RawRecording, pose: StaticPose, window: StillWindow, arms_hang: bool = True
) -> list[Cue]:
    """Cues from whatever legs, trunk and arms do. arms_hang: the pose is an N-pose, not a T-pose."""
    cues = []
    for s, name in enumerate(raw.sensors):
        u, v, frames = carried(raw, pose, s)
        outside = (frames < window.start) | (frames >= window.stop)
        u, v = u[outside], v[outside]
        if len(u) < 2 * raw.rate_hz:
            continue
        k = kind(name)
        if k in HINGE_FLOOR:
            cue = hinge(name, u, v, HINGE_FLOOR[k], HINGE_SIGN[k])
        elif k in LEAN:
            cue = lean(name, v, LEAN[k], -1.0, raw.rate_hz)
        elif k in SWING and not arms_hang:
            cue = hanging_arm(name, v, raw.rate_hz)
        else:
            cue = None
        if cue is not None:
            cues.append(cue)
    if len(cues) == 1:
        # Nothing confirms it; in dancing a single leg may be off by 70 deg.
        cues = [replace(cues[0], sigma=float(np.hypot(cues[0].sigma, LONE)))]
    if arms_hang and not raw.common_heading:
        # With a common heading the legs, which this rests on, have said it already; and arms on the
        # wrong side would say the opposite.
        cues += arm_swing(raw, pose, cues)
    return cues


def hinge(name: str, u: Array, v: Array, floor_deg: float, sign: float) -> Cue | None:
    """A cue from a segment that turns mostly about the left-right axis.

    Axis: u = +-|u| left, so -h(u)^2 = |u|^2 e^(2 i phi); phi = arg(-sum h(u)^2)/2, up to pi. Direction:
    up leans in the frame of a bone opposite to the bone; a shank flexes (leans back: v forward negative,
    sign -1) further than it extends, a thigh lifts forward (sign +1) further than back. None where
    the motion is too small, not planar, or equal both ways.
    """
    h = complex_heading(u)
    power = np.abs(h) ** 2
    if np.sqrt(power.mean()) < 0.15 or np.percentile(np.hypot(v[:, 0], v[:, 2]), 95) < 0.2:
        return None
    z = -(h**2)
    quality = abs(z.sum()) / power.sum()
    if quality < 0.35:
        return None
    phi = 0.5 * np.angle(z.sum())
    forward = np.real(complex_heading(v) * np.exp(-1j * phi)) * sign
    low, high = np.percentile(forward, [1, 99])
    asymmetry = (high + low) / max(high - low, 1e-9)
    if abs(asymmetry) < 0.12:
        return None
    if asymmetry < 0:
        phi += np.pi
    # Dancing turns legs about all axes: the less planar, the less is it a hinge.
    doubt = np.radians(floor_deg + NOT_PLANAR_DEG * (1 - quality))
    sigma = np.hypot(_jackknife(z, power) / 2, doubt)
    return Cue(name, float(wrap(phi)), float(sigma), f"hinge of the {kind(name)}")


def lean(name: str, v: Array, floor_deg: float, sign: float, rate_hz: float) -> Cue | None:
    """A cue from a segment that leans far in one direction only: the trunk.

    A trunk that bends forward carries up backward in its own frame (sign -1). None where it leans
    over 20 deg for less than 0.5 s, or in several directions.
    """
    h = sign * complex_heading(v)
    far = h[np.abs(h) > np.sin(np.radians(20))]
    if len(far) < 0.5 * rate_hz:
        return None
    total, size = far.sum(), np.abs(far).sum()
    if abs(total) < 0.8 * size:
        return None
    sigma = np.hypot(_jackknife(far, np.abs(far)), np.radians(floor_deg))
    return Cue(name, float(np.angle(total)), float(sigma), f"leaning of the {kind(name)}")


def _jackknife(z: Array, weight: Array, blocks: int = 8) -> float:
    """Standard error in rad of arg(sum z), from leaving out one of `blocks` equal shares of weight."""
    share = np.minimum((np.cumsum(weight) / weight.sum() * blocks).astype(int), blocks - 1)
    parts = np.array([z[share == b].sum() for b in range(blocks)])
    left_out = wrap(np.angle((parts.sum() - parts) / (parts.sum() + 1e-30)))
    return float(np.sqrt((blocks - 1) / blocks * np.sum(left_out**2)))


def combine(cues: list[Cue]) -> tuple[float, float, list[Cue]]:
    """One facing (rad), its 1-sigma and the cues it rests on, for sensors with a common heading.

    Robust weighted circular mean: start from the heading with most weight within 45 deg, drop cues
    further away than that. The sigma is the larger of what the cues claim and how they scatter.
    """
    if not cues:
        raise CalibrationError("no cue for the facing")
    a = np.array([c.heading for c in cues])
    w = np.array([c.sigma for c in cues]) ** -2
    near = np.abs(wrap(a[:, None] - a[None, :])) < np.pi / 4
    keep = near[int(np.argmax(near @ w))]
    kept = [c for c, k in zip(cues, keep, strict=True) if k]
    total = w.sum()
    a, w = a[keep], w[keep]
    mean = float(np.angle(np.sum(w * np.exp(1j * a))))
    scatter = np.sum(w * wrap(a - mean) ** 2) / max(len(a) - 1, 1)
    sigma = np.sqrt(max(1.0, scatter) / w.sum())
    if w.sum() < AGREEING * total:
        sigma = np.hypot(sigma, np.pi / 4)  # too many say something else
    return mean, float(sigma), kept


def ambiguous(cues: list[Cue], heading: float, kept: list[Cue]) -> bool:
    """Could the wearer as well face the opposite of `heading` (rad), which `combine` found with `kept`?

    A cue from motion tells an axis well and its sign less so. It is so where the sign rests on one such cue,
    or where OPPOSITE of the weight lies within 60 deg of the opposite heading. Never where a fact was given.
    """
    if not all(c.method.startswith(FROM_MOTION) for c in kept):
        return False
    if len(kept) == 1:
        return True
    weight = np.array([c.sigma for c in cues]) ** -2
    off = np.abs(wrap(np.array([c.heading for c in cues]) - heading))
    return bool(weight[off > np.radians(120)].sum() > OPPOSITE * weight.sum())


def heading_off(cues: list[Cue], heading: float, kept: list[Cue]) -> list[tuple[Cue, float]]:
    """Sharp cues that contradict all others by 50 to 130 deg, with that angle in rad: wrong headings.

    Only where at least three sensors and AGREEING of the weight agree with each other, and the cue is
    sharper than SHARP_DEG: dancing legs turn about any axis, but bluntly. An angle near 180 deg is a sign
    that is wrong, or sides that are exchanged.
    """
    weight = {c: c.sigma**-2 for c in cues}
    out = []
    for c in cues:
        off = float(wrap(c.heading - heading))
        if c in kept or c.sigma > np.radians(SHARP_DEG) or not 50 <= abs(np.degrees(off)) <= 130:
            continue
        others = sum(w for x, w in weight.items() if x is not c)
        agreeing = sum(weight[x] for x in kept)
        if len({x.sensor for x in kept}) >= 3 and agreeing > AGREEING * others:
            out.append((c, off))
    return out


def pelvis_first(sensors: tuple[str, ...]) -> str:
    """The sensor whose world a facing given as a number refers to where headings differ."""
    for name in ("pelvis", "lower_back", "sternum", "upper_back", "head"):
        if name in sensors:
            return name
    return sensors[0]
