"""What readers of files assume and doubt."""

from __future__ import annotations

from typing import Any

from mocap.findings import Words
from mocap.orientation import GRAVITY

Details = dict[str, Any]


def _names(names: list[str], most: int = 200) -> str:
    return ", ".join(names)[:most]


def _missing(d: Details) -> str:
    counts = list(d["by_sensor"].values())
    if len(counts) > 1 and min(counts) == max(counts):
        by = f"{counts[0]} of each sensor"
    else:
        by = ", ".join(f"{n} {k}" for n, k in d["by_sensor"].items() if k)
    share = f"{sum(counts)} of {d['of']} samples"
    if d["what"] is not None:
        return f"{share} have no {d['what']} ({by})"
    return f"{share} are missing or not finite ({by}), the longest gap {d['longest_frames']} frames"


def _no_rotation(d: Details) -> str:
    each = ", ".join(f"{n} {k}" for n, k in d["by_sensor"].items() if k)
    count = sum(d["by_sensor"].values())
    return f"{count} samples hold no rotation and are taken for missing ({each})"


def _unmeasured(d: Details) -> str:
    return f"no sample of {d['what']} from " + ("any sensor" if d["all"] else ", ".join(d["names"]))


def _vector(v: list[float]) -> str:
    return f"({v[0]:.1f}, {v[1]:.1f}, {v[2]:.1f})"


def _not_upright(d: Details) -> str:
    return (
        f"orientation turns the mean acceleration to {_vector(d['mean_m_s2'])} m/s^2, "
        f"{d['tilt_deg']:.0f} deg off the vertical"
    )


def _acc_mean(d: Details) -> str:
    return f"acc_world: mean {_vector(d['mean_m_s2'])} m/s^2, expected about 0 without gravity"


def _cut(d: Details) -> str:
    ends = " and ".join(f"{a} to {b}" for a, b in d["cut"])
    return f"frames {ends} of {d['of']} are cut off: the reference has a hole there"


def _never_upright(d: Details) -> str:
    said = f"the trunk is never upright, it leans by {d['lean_deg']:.0f} deg or more"
    if d["told"] is not None:
        return f"{said} with {d['told']} up, as told"
    return f"{said}: another axis of the file may point up; --up y or --up z says which"


def _joints(d: Details) -> str:
    pairs = ", ".join(f"{name} is {joint}" for name, joint in d["joints"].items())
    return f"joints by their names: {pairs}"


def _fit(d: Details) -> str:
    residuals = ", ".join(f"{n} {e:.1%}" for n, e in d["residual"].items())
    return (
        "quat is the segment's orientation; the constant rotation to the sensor is fitted to gyr and "
        f"gravity, residual of the rate: {residuals}"
    )


def _by_gravity(d: Details) -> str:
    words = [f"{d['up']}-up"]
    words += ["accelerations turned round"] if d["turned_round"] else []
    words += ["quaternions inverted"] if d["inverted"] else []
    return f"orientation of {d['device']} by gravity: {', '.join(words)}"


def _acc_unit(d: Details) -> str:
    known = d["size"] is not None
    how = f"{d['size']:.3g} {d['when']}" if known else "never still, not checked"
    return f"the unit of acc is not declared; read as {d['unit']} ({how})"


WORDS: dict[str, Words] = {
    # Any file.
    "option-unused": "{option} was given, but has no effect on this file",
    "rate-told": "states {stated_hz:g} Hz, read as {read_hz:g} Hz as was said",
    # Samples, and the time of them.
    "missing-samples": _missing,
    "no-rotation": _no_rotation,
    "not-measured": _unmeasured,
    "stamps-jitter": "{where}: stamps jitter by up to {jitter:.0%} of a step, read as even",
    "clock-wanders": "{where}: the clock wanders by up to {wander_frames:.1f} frames around {rate_hz:.6g} "
    "Hz, read as even",
    "stamps-missing": "{where}: {count} of {of} samples are missing",
    "no-time": "frames carry no time: the rate is not checked",
    "clock-off": "{file}: its clock is {ppm:.0f} ppm off the others', {frames} frames by the end; its "
    "samples lie where its stamps say",
    "no-counter": "no PacketCounter: files are aligned at their first row",
    "not-synchronised": "the devices' clocks have no time in common (not synchronised): aligned at their "
    "first rows",
    "rows-differ": "files of {least} to {most} rows, all cut to the shortest",
    "lengths-differ": "lengths differ by {by}: cut to {frames} frames",
    "common-part": "frames {first} to {last} of {of} are read: all sensors have begun, none has ended",
    "rate-of-data-set": "rate {rate_hz:g} Hz, as the data set states",
    "rate-of-paper": "rate {rate_hz:g} Hz, that of the paper's network (--rate overrides)",
    "rate-of-stamps": "rate {rate_hz:g} Hz, by SampleTimeFine",
    # Units and axes.
    "no-acc-in-file": "no acceleration in the file",
    "acc-sign": "acc is specific force (up at rest), not gravity: only orientations could tell",
    "acc-size": "acc: {size:.2f} m/s^2 when still, expected " + f"{GRAVITY:.2f}",
    "acc-unchecked": "no sensor is still for half a second: the unit of acc is not checked",
    "acc-mean": _acc_mean,
    "acc-undeclared": _acc_unit,
    "acc-undeclared-free": "the unit of acc is not declared, and it holds no gravity: read as m/s^2",
    "gyr-undeclared": "the unit of gyr is not declared; read as {unit}",
    "gravity-put-back": "acc holds no gravity: it is put back by the orientation, acc taken in the "
    "sensors' axes",
    "free-acc-put-back": "FreeAcc holds no gravity: it is put back by the orientation",
    "rates-of-orientation": "no rates in the file; gyr is the rate of the orientation",
    "rates-of-orientation-of": "gyr of {sensors} is the rate of the orientation",
    "orientations-alone": "no acceleration in the file; gyr is the rate of the orientation",
    "world": "the world of the file is {world}, ours y-up",
    "world-by-gravity": "gravity is along {axis} in the file's world: read as {world}, against its format",
    "world-undeclared": "the world of the file is {world} (the file does not say)",
    "quaternions-into": "quaternions turn into a {world} world, {source}",
    "zero-quaternions": "{count} quaternions are zero, read as missing",
    "not-upright": _not_upright,
    # Sensors and their places.
    "unknown-places": "no place of the table: {names}; --map NAME=PLACE,... says where each was worn",
    "torso-on-sternum": "the torso sensor is taken to sit on the sternum",
    "names-from": "sensors named by {file}",
    "files-left-out": "left out, no exports: {files}",
    "columns-left-out": "columns not read: {columns}",
    # References.
    "off-reference": "{off_deg:.0f} deg (median) from the reference's bone",
    "hole-cut": _cut,
    "hole-bridged": "{poses} poses of the reference are not finite: bridged, the longest hole "
    "{longest_frames} frames",
    "no-reference": "{poses} of {of} poses are not finite: no reference",
    "no-reference-holes": "too many frames are missing for a reference",
    "pelvis-stays": "no translation in the file: the pelvis of the reference stays in place",
    "trans-not-finite": "some trans is not finite: the pelvis of the reference stays in place",
    # Motions on our body.
    "unit-told": "length unit {unit_m:g} m as told (stature about {stature_m:.2f} m)",
    "unit-guessed": "length unit {unit}, guessed from the legs (stature about {stature_m:.2f} m)",
    "unit-unknown": "length unit unknown: the body is taken to be as tall as ours",
    "unit-none-fits": "legs of {leg:.4g} units fit no known length unit; use --scale",
    "stature": "stature {stature_m:.2f} m if the unit is {unit}",
    "t-pose-dropped": "the file starts with a T-pose: its first {frames} frames are dropped",
    "path-scaled": "the path is scaled by the ratio of leg lengths, and the lowest foot stands on the "
    "floor y = 0",
    "rest-pose": "zero rotations are the rest pose, and its straightened limbs are our T-pose",
    "t-pose-first": "frame 0 is a T-pose and gives each joint's rest orientation",
    "axes-by-geometry": "zero rotations are no rest pose: each joint's axes are found from the bones' "
    "geometry and the hinges of knees and elbows",
    "axes-aslant": "the local axes of {joint} lie {off_deg:.0f} deg off the body's, so its twist is that "
    "of the mean posture",
    "rig-cmu": "CMU's skeleton: neck and head are upright as in the T-pose that MotionBuilder's conversion "
    "has",
    "rig-daz": "the Daz-friendly conversion of CMU's trials: limbs, neck and head are the original AMC's, "
    "not the figure's own bones",
    "rig-bandai-namco": "Bandai-Namco's rig: neck, head, collars and feet as upright people have them on "
    "average",
    "joint-names": _joints,
    "joint-moves": "joint {joint} moves in its parent by up to {units:.3g} units; the mean is used",
    "beyond-anatomy": "{joint} turns by up to {most_deg:.0f} deg, more than a body can, in {frames} frames "
    "between {first} and {last}",
    "knee-backward": "the {side} knee bends backward in most frames: left and right may be exchanged",
    "never-upright": _never_upright,
    # BVH.
    "frame-time-ms": "Frame Time is {text}, read as milliseconds: {rate_hz:.6g} Hz",
    "frame-time-rounded": "Frame Time {text} is {rate_hz:.6g} Hz, of a time with few digits",
    "frames-line": "holds {frames} frames, its 'Frames:' line says {stated}: read as they are",
    "offsets-hold": "the positions of {joints} joints are all zero, so their OFFSETs hold",
    # ASF and AMC.
    "skeleton-file": "the skeleton is {file}",
    "late-start": "the file begins with frame {frame} of its take: the time starts there",
    "rate-of-cmu": "{rate_hz:g} Hz, as CMU records: AMC files name no rate",
    "bones-still": lambda d: f"bones without angles in the file stand still: {_names(d['bones'])}",
    "bones-rigid": lambda d: (
        f"bones that change their length are read as rigid: {_names(d['bones'])}"
    ),
    # AMASS and SMPL.
    "fields-joined": "poses are the fields {fields}",
    "no-hands": "no hands in the file: they are straight",
    "trans-scaled": "{field} is divided by {by}, {scale:g}, to metres",
    "betas-change": "betas change from frame to frame: their mean is the body's shape",
    "betas-unused": "the file's betas need an SMPL model; the neutral mean shape is used",
    "betas-unused-smpl": "the file's betas need an SMPL file (--smpl): the table's body is used",
    "pelvis-fast": "the pelvis moves at {speed_m_s:.0f} m/s (median): trans may not be in metres",
    # DIP-IMU, TotalCapture, IMUPoser.
    "one-of-sequences": "{sequences} sequences in the file; only the first is read",
    "pelvis-frame": "all is relative to the pelvis sensor, which therefore reads the identity: the "
    "vertical is lost",
    "no-calibration-files": "no calibration files beside it: read as a raw recording",
    "world-of-sensors": "the sensors' world is z-up, y-up here",
    "calibrated-by": "calibrated by {bone} and {reference} as one public reader does",
    "no-positions": "no gt_skel_gbl_pos.txt found: the calibration is checked by gravity alone",
    "limbs-checked": "limb directions checked against {file}; it makes no reference",
    "limbs-unchecked": "no limb of the position file is known: directions are not checked",
    "limb-off": "the limb is {off_deg:.0f} deg (median) off its positions",
    "legs-first": "rate {rate_hz:g} Hz; sensors legs first, as three of four public readers have it",
    "aligned-in-frame-0": "orientations are aligned to the pose of frame 0; the pelvis of the reference "
    "stays in place",
    "bones-y-up": "orientations are those of the bones, in a y-up world, accelerations m/s^2 without gravity",
    # MVNX.
    "world-of-mvn": "world is z-up with x forward in the file, y-up here",
    "stature-of-frame": "stature {stature_m:.2f} m, from the head joint over the toes in the {frame} frame",
    "stature-of-table": "stature {stature_m:.2f} m: the file's poses do not tell it",
    "segments-missing": "segments {segments} are missing, so no reference motion",
    "arms-hang": "the arms hang in the {frame} frame, yet segment frames are taken to be the world's in a "
    "T-pose",
    "mounted-at-mean": "sensors are mounted on their segments at their mean relative orientation",
    "sensors-left-out": "sensors {sensors} sit on no known segment and are left out",
    "mounting-varies": "{off_deg:.0f} deg (median) off a constant mounting",
    "no-free-acc": "no {field} in the file: orientations alone",
    "acc-read-as": "no {field}; {instead} is read as {reading}",
    "no-sensor-data": "no sensor data: read as a motion",
    # Phones.
    "exported-by": "exported by {apps}",
    "acc-summed": "acceleration of {device} is gravity and acceleration together",
    "acc-has-gravity": "acceleration of {device} holds gravity, whatever its name",
    "acc-of-device-in-g": "acceleration of {device} is in g, by the size of gravity",
    "acc-put-back": "acceleration of {device} holds no gravity: it is put back by the orientation, taken "
    "to turn the device to a z-up world",
    "acc-turned-round": "accelerations are turned round: iOS gives those of gravity",
    "no-rates-of": "no rates of {device}: gyr is the rate of the orientation",
    "device-by-gravity": _by_gravity,
    # qmt.
    "world-of-file": "world is z-up in the file, y-up here",
    "mounting-fitted": _fit,
    "mounting-unsure": "{residual:.0%} residual of the mounting fit",
    "not-settled": "the file's orientations have not settled before frame {frame}: those samples are "
    "marked invalid",
    "facing-in-pose": "the wearer faces {facing_deg:.0f} deg in the static pose at {start_s:.1f} to "
    "{end_s:.1f} s: the x axes of trunk and legs there",
}
