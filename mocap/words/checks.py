"""What the checks of calibration find."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mocap.findings import Words

Details = dict[str, Any]
AXES = "xyz"
UNITS = {"acc": "m/s^2", "gyr": "rad/s"}


def _impossible(d: Details) -> str:
    return (
        f"{d['count']} sample{'s' if d['count'] > 1 else ''} beyond what sensors can measure, taken for "
        f"missing; the first at {d['first_s']:.2f} s: {d['what']} {d['value']:.4g} {UNITS[d['what']]}"
    )


def _no_data(d: Details) -> str:
    leave = "leave the sensor out (--sensors)"
    if d["absent"]:
        return f"no sample of {' and '.join(d['absent'])}, both acc and gyr are needed: {leave}"
    return f"only {d['count']} valid samples, {d['least']} (1 s) are needed: {leave}"


def _clipping(d: Details) -> str:
    return (
        f"{d['what']} stays at its limit of {d['limit']:.4g} {UNITS[d['what']]} for {d['samples']} samples: "
        f"the sensor's range is too small for this motion"
    )


def _rate(d: Details) -> str:
    what = "their orientations turn" if d["by"] == "orientation" else "gravity turns in acc"
    return (
        f"the sampling rate is probably {d['given_hz'] * d['ratio']:.3g} Hz, not {d['given_hz']:.4g} (or "
        f"all gyr is scaled by {d['ratio']:.2f}): by this rate {what} {1 / d['ratio']:.2f} times as fast as "
        f"gyr says"
    )


def _scale(d: Details) -> str:
    rate = f", or the sampling rate is {d['or_rate_hz']:.3g} Hz" if "or_rate_hz" in d else ""
    return (
        f"gyr is {d['ratio']:.2f} times the rate at which its orientation turns: the scale of its gyroscope "
        f"is off{rate}"
    )


def _no_acc(d: Details) -> str:
    poses = (
        "poses rest on orientations alone (SOP)" if d["all"] else "its orientation alone is used"
    )
    return f"no acceleration: {poses}; its unit, axes and gravity cannot be checked"


_UNITS = {
    "mg": "acc is in mg or cm/s^2, divide by 1000/9.80665 or by 100",
    None: "its unit is unknown",
}
_MISTAKES = {
    "transposed": "orientation is given as sensor-from-world (transposed), world-from-sensor is expected",
    "wxyz-taken": "quaternions look like x, y, z, w where w, x, y, z was taken for granted",
    "xyzw-taken": "quaternions look like w, x, y, z that were taken for x, y, z, w",
    "world": "orientation is given in another world, its up is {up} here and must be y (--units y-up or "
    "z-up tells readers of text files)",
}


_SEEN: dict[str, Callable[[Details], str]] = {
    "speed": lambda d: f"turns at {d['fastest']:.0f} rad/s, faster than gyroscopes can measure",
    "rate": lambda d: f"gyr is not the rate of its orientation ({d['off']:.0%} off)",
    "gravity": lambda d: (
        f"carried along by gyr, gravity wanders by {d['before_deg']:.0f} deg in acc "
        f"({d['after_deg']:.0f} deg if corrected)"
    ),
    "upright": lambda d: (
        f"turned by its orientation, acc is {d['before_deg']:.0f} deg from upright in the mean "
        f"({d['after_deg']:.0f} deg if corrected)"
    ),
}


def _axes(d: Details) -> str:
    return f"{_SEEN[d['by']](d)}: {_mistake(np.array(d['correction']), d['of'], d['code'])}"


def _mistake(M: np.ndarray, of: str | None, code: str) -> str:
    """What is wrong where the correction M fits: `of` gyr or acc, or (None) of either."""
    if code == "gyr-in-deg":
        return "gyr is in deg/s, not rad/s"
    if code == "gyr-unit":
        return "gyr is 180/pi times too small (rad/s that were taken for deg/s)"
    diagonal = np.diag(M)
    if not np.abs(diagonal).all():
        order = ", ".join(
            ("-" if row.sum() < 0 else "") + AXES[int(np.abs(row).argmax())] for row in M
        )
        what = of or "gyr (against acc)"
        return f"the axes of {what} are exchanged, x, y, z should be its {order}"
    flipped = [AXES[i] for i in range(3) if diagonal[i] < 0]
    if of is None and len(flipped) == 2:
        (kept,) = set(AXES) - set(flipped)
        return f"axis {kept} of acc is reversed (or {' and '.join(flipped)} of gyr)"
    if len(flipped) == 3:
        if of == "acc":
            return "all axes of acc are reversed: it holds gravity instead of specific force"
        return "all axes of gyr are reversed, or the whole triad is left-handed"
    plural, verb = ("axis", "is") if len(flipped) == 1 else ("axes", "are")
    return f"{plural} {' and '.join(flipped)} of {of or 'gyr'} {verb} reversed"


def _lag(d: Details) -> str:
    late = d["late_s"]
    return (
        f"runs {abs(late) * 1000:.0f} ms {'behind' if late > 0 else 'ahead of'} the sensors next to it: its "
        f"clock is not synchronised"
    )


def _moved(d: Details) -> str:
    if "jump_deg" in d:
        return (
            f"its orientation jumps by {d['jump_deg']:.0f} deg during the pose, at {d['at_s']:.2f} s, which "
            f"its gyroscope does not see"
        )
    return f"moved by {d['moved_deg']:.1f} deg during the pose, {d['start_s']:.2f} to {d['end_s']:.2f} s"


def _posture(d: Details) -> str:
    judged, them = ("both thighs are", "them") if d["of"] == "thighs" else ("the pelvis is", "it")
    bends = ", and the knees would bend forward" if d["knees_forward"] else ""
    at = d["stance_s"]
    other = (
        "name the time of a stance"
        if at is None
        else f"at {at:.1f} s it stands still as in motion: name another time (--at {at:.1f})"
    )
    return (
        f"the pose, {d['start_s']:.2f} to {d['end_s']:.2f} s, is not one of standing: {judged} "
        f"{d['tilt_deg']:.0f} deg from where the legs' motion has {them}{bends}. The wearer probably sat; "
        f"{other}"
    )


_EXCHANGED: dict[str, Callable[[Details], str]] = {
    "levels": lambda d: (
        f"when the left one of one level of the limb moves, the right one of the next does "
        f"(correlation {d['correlation']:.2f})"
    ),
    "limbs": lambda d: (
        f"each turns with the other sensors of the other's limb (by {d['gain']:.2f} of a correlation more "
        f"than with those of its own)"
    ),
    "pelvis": lambda d: (
        f"their motion fits the pelvis better the other way round (score {d['score']:+.1f}, "
        f"{-d['score']:+.1f} if exchanged)"
    ),
    "rise": lambda d: (
        "the left one goes to the right and the right one to the left; or the facing is off by 180 deg"
    ),
}


def _swapped(d: Details) -> str:
    options = [" and ".join(o) for o in d["options"]]
    who = " (or else ".join(options) + ")" * (len(options) - 1)
    whole = ", with the other sensors of these limbs," if d.get("whole_limb") else ""
    return f"{who}{whole} are probably exchanged: {_EXCHANGED[d['by']](d)}"


def _other_pose(d: Details) -> str:
    when = {
        "still": "whenever the body stands still",
        "upright": "for most of the time that the body is upright",
    }[d["when"]]
    if d["called"] == "n":
        off = f"about {d['degrees']:.0f} deg from the N-pose {when}"
        return f"the arms are {off}: was it a T-pose (--pose t)?"
    return (
        f"the arms are where they were in the pose {when}, to {d['degrees']:.0f} deg, and never hang as they "
        f"would after a T-pose: was it an N-pose (--pose n)?"
    )


def _uncertain(d: Details) -> str:
    known = f"is known to {d['sigma_deg']:.0f} deg only"
    if d["single"]:
        return (
            f"its heading {known}, so it may be shown turned: calibrate again, and walk longer, with brisk "
            f"starts and stops, and bend forward"
        )
    return f"where the wearer faces {known}"


def _assumed(d: Details) -> str:
    if d["single"]:
        return (
            "nothing ties its heading to the others', so its facing is ASSUMED; give a known axis of it, a "
            "second pose, or record walking and bending"
        )
    return (
        "where the wearer faces in the pose cannot be told from the data: 0 deg in the sensors' world is "
        "ASSUMED; give the facing, a known axis, a second pose, or record walking"
    )


def _second(d: Details) -> str:
    return f"the second pose ({d['pose'].upper()}, {d['start_s']:.2f} to {d['end_s']:.2f} s)"


def _second_pose(d: Details) -> str:
    if "tilts" not in d:
        return (
            f"{_second(d)} is not used: no bone with a sensor tilts by more than {d['least_deg']:.0f} deg "
            f"between the poses"
        )
    return (
        f"{_second(d)} {'does not fit' if d['used'] else 'is not used'}: {d['tilts']} tilts by "
        f"{d['seen_deg']:.0f} deg between the poses, {d['expected_deg']:.0f} expected"
    )


def _rival(d: Details) -> str:
    c, e = d["rival_start_s"], d["rival_end_s"]
    return (
        f"the pose is taken at {d['start_s']:.2f} to {d['end_s']:.2f} s, but at {c:.2f} to {e:.2f} s the "
        f"body is about as still in another posture: if that is the pose, name its time "
        f"(--at {(c + e) / 2:.1f})"
    )


_READS = "a still sensor reads {reads:.3g}, expected 9.81 m/s^2: "
_TURNED = (
    "turned by its orientation, acc is {up_deg:.0f} deg from upright in the mean, and gyr is "
    "{rate_off:.0%} off the rate of it: "
)

# A template of the details where one serves, else a function of them.
WORDS: dict[str, Words] = {
    "impossible-sample": _impossible,
    "no-data": _no_data,
    "no-acc": _no_acc,
    "acc-without-gravity": _READS
    + "gravity seems to be removed already ({constant:.2g} in the mean over half a second), and the specific "
    "force with gravity is needed",
    "acc-in-g": _READS + "acc is in g, multiply by 9.80665",
    "acc-unit": lambda d: (_READS + _UNITS[d.get("likely")]).format(**d),
    "acc-gravity": _READS + "bias or scale of its accelerometer is off",
    "clipping": _clipping,
    "frozen": "repeats one sample for {seconds:.1f} s from {start_s:.1f} s on while the body moves: it "
    "is frozen or its channel is dead",
    "copied": "gyr and acc are those of {of} (alike to {likeness:.4f}): one channel was copied to the other",
    "sampling-rate": _rate,
    "gyr-scale": _scale,
    **dict.fromkeys(
        ("orientation-transposed", "quaternion-order", "orientation-world"),
        lambda d: (_TURNED + _MISTAKES[d["mistake"]]).format(**d),
    ),
    **dict.fromkeys(("gyr-axes", "acc-axes", "gyr-in-deg", "gyr-unit"), _axes),
    "gaps": "{share:.0%} of its samples are missing, the longest gap is {longest_s:.1f} s: its heading "
    "may differ behind a gap",
    "lag": _lag,
    "pose-not-still": "the wearer moves at the time of the pose, {start_s:.2f} to {end_s:.2f} s "
    "({rate_deg_s:.0f} deg/s): name another time, or let it be found",
    "pose-ambiguous": _rival,
    "moved-in-pose": _moved,
    "pose-posture": _posture,
    "pose-leaning": "leans {tilt_deg:.0f} deg in the pose against the median of the recording: the "
    "wearer leaned in the pose, or mostly leans or sits afterwards",
    "slipped": "tilted by {tilt_deg:.0f} deg since the pose when the body stands still again at "
    "{since_s:.1f} s, the others by {others_deg:.0f} deg: it slipped on the bone, or that limb was held "
    "differently",
    "swapped": _swapped,
    "other-pose": _other_pose,
    "facing-uncertain": _uncertain,
    "facing-disagrees": "the motion of legs and trunk says the wearer faced {off_deg:+.0f} deg from "
    "where the calibration has it",
    "facing-ambiguous": "the wearer faces {facing_deg:.0f} deg in the sensors' world by the {method}, "
    "but it could be the opposite way, {opposite_deg:.0f} deg: give the facing (--facing)",
    "facing-assumed": _assumed,
    "heading-off": "its heading is {off_deg:+.0f} deg from that of the others, by the {method}: its "
    "world is not theirs",
    "second-pose": _second_pose,
    "second-pose-not-still": lambda d: (
        f"{_second(d)}: the wearer moves then ({d['rate_deg_s']:.0f} deg/s)"
    ),
    "second-pose-disagrees": "the second pose is not used: {method} says otherwise of where the wearer faced",
}
