"""Units and axes of a recording, held against gravity, its own orientation and a reference.

A contradiction raises FormatError naming file, sensor and field; a doubt is a finding of
`Document.doubts`. The measures are `mocap.calibration.measures`'. What the shared diagnostics of a raw
recording (`mocap.calibration.checks`) can name, such as reversed axes or a transposed orientation, is told
as they find it and left to `poser calibrate` to refuse; only what nothing explains is refused here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.calibration import measures as unit_checks
from mocap.calibration.checks import check_sensors, rates, spikes
from mocap.calibration.evidence import gather
from mocap.calibration.measures import (
    FASTEST,
    KEPT,
    WRONG_UNIT,
    gravity_size,
    smoothed,
    unmeasured,
    usual_force,
)
from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Options
from mocap.formats._checks import gap_report, half_report, rotation_report
from mocap.orientation import GRAVITY, Array
from mocap.recording import RawRecording, Recording
from mocap.seats import second_difference, sensor_positions
from mocap.sensors import PLACES

LIMB_SPEED = 6.0  # m/s: between two ends of a swing
TILTED_DEG = 60.0  # mean acceleration this far from upright is no movement and no bad calibration
SURELY_UP = 0.9  # of the mean force along an axis: within 26 deg of it
LIVELY = 40.0  # m/s^2: no body's acceleration, in the median over time and sensors
ALIKE = 0.5  # correlation of acc_world with the reference's, either way: one is the other, scaled


def factors(options: Options) -> tuple[float, float]:
    """Factors of acc to m/s^2 and of gyr to rad/s, where the user says that a file, against its format,
    has them in g or deg/s."""
    return (
        GRAVITY if "g" in options.units else 1.0,
        np.pi / 180 if "deg/s" in options.units else 1.0,
    )


def raw(path: Path, rec: RawRecording) -> list[Finding]:
    """Warnings on a raw recording; raises FormatError where units or axes contradict gravity."""
    doubts = rotation_report(rec) + gap_report(rec.valid, rec.sensors) + _absent(rec)
    evidence = gather(rec)
    rec = evidence.raw
    doubts += spikes.check(evidence)
    if rec.R_world_sensor is not None:
        has = np.asarray(np.isfinite(rec.R_world_sensor).all(axis=(-1, -2)), bool)
        doubts += half_report(rec.valid & ~has, rec.sensors, "orientation")
    doubts += _accelerometer(path, rec)
    doubts += _gyroscope(path, rec)
    return doubts + _up(path, rec)


def upright(R: Array, acc: Array, documented: str) -> tuple[Array, Finding]:
    """R_world_sensor (T,S,3,3) of a file in our y-up world, and what was assumed.

    documented: "z-up" or "y-up", what the format says. Where the specific force acc (T,S,3) of all sensors
    together clearly stands along the other axis, that one is up: hand-made and converted files are.
    """
    force = np.einsum("tsij,tsj->tsi", R, acc).reshape(-1, 3)
    force = force[np.isfinite(force).all(-1)]
    mean = force.mean(axis=0) if len(force) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    axes = {"y-up": 1, "z-up": 2}
    other = next(a for a in axes if a != documented)
    against = size > 0.5 * GRAVITY and mean[axes[other]] > SURELY_UP * size
    world = other if against else documented
    said = assumption("world", world=world)
    if against:
        said = assumption("world-by-gravity", axis=other[0], world=world)
    return (R if world == "y-up" else ori.R_YUP_ZUP @ R), said


def assumed(rec: RawRecording) -> tuple[Finding, ...]:
    """What nothing in a raw recording can tell, for `Document.assumed`."""
    if _orientations_alone(rec):
        return (assumption("no-acc-in-file"),)
    if rec.R_world_sensor is not None or not np.isfinite(rec.acc).any():
        return ()
    # With -acc, up and all movement are turned round together: gyr fits either.
    return (assumption("acc-sign"),)


def _orientations_alone(rec: RawRecording) -> bool:
    """Whether there are orientations and no acc at all, as some exports are meant to be."""
    return rec.R_world_sensor is not None and not np.isfinite(rec.acc).any()


def _absent(rec: RawRecording) -> list[Finding]:
    """Sensors without any sample of acc or of gyr, one warning for either.

    Not of acc where the file has orientations alone: `assumed` says so.
    """
    lacking: dict[str, list[str]] = {}
    for s, name in enumerate(rec.sensors):
        for what in unmeasured(rec, s):
            if what == "acc" and _orientations_alone(rec):
                continue
            lacking.setdefault(what, []).append(name)
    return [
        doubt("not-measured", what=what, names=names, all=len(names) == len(rec.sensors))
        for what, names in lacking.items()
    ]


def _accelerometer(path: Path, rec: RawRecording) -> list[Finding]:
    """Size of gravity in still windows; where there is none, in the slowest tenth of the time."""
    still = gravity_size(rec.acc, rec.rate_hz)
    slow = np.array([_slow(rec, s) for s in range(len(rec.sensors))])
    mean = np.linalg.norm(unit_checks.mean_force(rec), axis=1)
    doubts = []
    for s, name in enumerate(rec.sensors):
        where = f"sensor {name}: acc"
        size, when = (still[s], "when still") if np.isfinite(still[s]) else (slow[s], "when slow")
        if not np.isfinite(size):
            continue
        if when == "when slow" and size < 3 and mean[s] < 0.25 * size:
            size, when = mean[s], "on average"  # what the orientation turns cancels: no gravity
        elif when == "when slow" and size < 3 and np.isnan(mean[s]) and _free(rec, s, size):
            raise FormatError(path, f"{size:.3g} {when}{FREE}", where)
        # A sensor that never rests reads up to a few g; its unit is wrong where none could be.
        off = abs(size / GRAVITY - 1) > 0.15 if when == "when still" else bool(_guess(size))
        if off:
            raise FormatError(
                path, f"{size:.3g} {when}, expected {GRAVITY:.2f} m/s^2{_guess(size)}", where
            )
        if abs(size / GRAVITY - 1) > 0.05 and when == "when still":
            doubts.append(doubt("acc-size", name, size=float(size)))
    if not (np.isfinite(still) | np.isfinite(slow)).any() and np.isfinite(rec.acc).any():
        doubts.append(doubt("acc-unchecked"))
    return doubts


def _slow(rec: RawRecording, s: int) -> float:
    """|mean acc| of sensor `s` in its slowest half seconds; in half of all without gyr; NaN under 2 s."""
    ok = rec.valid[:, s] & np.isfinite(rec.acc[:, s]).all(-1) & np.isfinite(rec.gyr[:, s]).all(-1)
    if not np.isfinite(rec.gyr[:, s]).any():
        return float(usual_force(rec.acc[:, [s]], rec.rate_hz)[0][0])
    if ok.sum() < 2 * rec.rate_hz or not rec.acc[ok, s].any():
        return float("nan")
    return unit_checks.constant_force(rec.gyr[ok, s], rec.acc[ok, s], rec.rate_hz)


def _free(rec: RawRecording, s: int, size: float) -> bool:
    """Whether |mean acc| of sensor `s` is `size` but |acc| is so much more that no gravity is in it."""
    ok = rec.valid[:, s]
    if not ok.any():
        return bool(size < KEPT * usual_force(rec.acc[:, [s]], rec.rate_hz)[1][0])
    return size < KEPT * unit_checks.still_gravity(rec.gyr[ok, s], rec.acc[ok, s])[0]


FREE = (
    ", so gravity was removed: export the acceleration with gravity, or the orientation (quat_w to quat_z) "
    "beside it"
)


def _guess(size: float) -> str:
    """What explains an accelerometer that reads `size` where gravity alone acts."""
    if abs(size - 1) < 0.3:
        return ", so the unit is g (--units g)"
    if abs(size / GRAVITY**2 - 1) < 0.3:
        return ", so it was m/s^2 already (--units m/s^2)"
    if abs(size - 1000) < 300:
        return ", so the unit is mg"
    return FREE if size < 0.5 else ""


def _swing(rec: RawRecording | Recording) -> float:
    """What the mean acceleration of a limb may be, m/s^2: its change of speed over the time."""
    return 1.0 + LIMB_SPEED / rec.seconds


def gyr_in_degrees(rec: RawRecording) -> bool:
    """Whether most sensors whose gyr can be checked turn 15 times too fast, or all implausibly fast."""
    each = range(len(rec.sensors))
    known = [r for s in each if (r := unit_checks.gyr_ratio(rec, s)[0]) is not None]
    if known:
        return float(np.median(known)) > WRONG_UNIT
    return max(unit_checks.fastest(rec, s) for s in each) > FASTEST


def _gyroscope(path: Path, rec: RawRecording) -> list[Finding]:
    """Unit of gyr: against the rate of the orientation, else against how gravity moves in acc."""
    for s, name in enumerate(rec.sensors):
        where = f"sensor {name}: gyr"
        ratio, by = unit_checks.gyr_ratio(rec, s)
        fast = unit_checks.fastest(rec, s)
        if (ratio is not None and ratio > WRONG_UNIT) or (ratio is None and fast > FASTEST):
            found = f"{ratio:.0f} times what {by}" if ratio else f"up to {fast:.0f} rad/s"
            raise FormatError(path, f"{found}: in degrees (--units deg/s)?", where)
        if ratio is not None and ratio < 1 / WRONG_UNIT:
            found = f"{1 / ratio:.0f} times less than {by}"
            raise FormatError(path, f"{found}: in rad already (--units rad/s)?", where)
    if rec.R_world_sensor is None:
        return []
    return list(rates.check(gather(rec)))


def _up(path: Path, rec: RawRecording) -> list[Finding]:
    """Whether R_world_sensor turns the mean specific force upright, and if not, why."""
    wrong: list[Finding] = []
    refused: dict[str | None, str] = {}
    for name, mean in zip(rec.sensors, unit_checks.mean_force(rec), strict=True):
        if not np.isfinite(mean).all():
            continue
        tilt = np.rad2deg(np.arccos(np.clip(mean[1] / max(np.linalg.norm(mean), 1e-9), -1, 1)))
        if tilt > TILTED_DEG:
            found = f"({mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f})"
            refused[name] = (
                f"turns the mean acceleration to {found}, expected (0, {GRAVITY:.1f}, 0): y up"
            )
        elif np.hypot(mean[0], mean[2]) <= _swing(rec):
            continue
        wrong.append(doubt("not-upright", name, mean_m_s2=mean.tolist(), tilt_deg=float(tilt)))
    if not wrong:
        return []
    named: dict[str | None, list[Finding]] = {}
    known = tuple(n for n in rec.sensors if n in PLACES)
    for f in check_sensors(rec.select(known)) if known else ():
        if f.severity == "error":
            named.setdefault(f.sensor, []).append(f)
    doubts: list[Finding] = []
    for one in wrong:
        if one.sensor not in named and one.sensor in refused:
            raise FormatError(path, refused[one.sensor], f"sensor {one.sensor}: orientation")
        doubts += named.get(one.sensor, [one])
    return doubts


def missing(rec: Recording) -> list[Finding]:
    """The warnings about samples that are missing, in whole or in part."""
    # A second difference has no value at either end, and some sensors measure orientation alone.
    half = rec.valid & ~rec.acc_valid & rec.acc_valid.any(axis=0)
    half[[0, -1]] = False
    return [
        *rotation_report(rec),
        *gap_report(rec.valid, rec.sensors),
        *half_report(rec.valid & ~rec.ori_valid, rec.sensors, "orientation"),
        *half_report(half, rec.sensors, "acceleration"),
    ]


def calibrated(path: Path, rec: Recording) -> list[Finding]:
    """Warnings on a calibrated recording; raises FormatError where gravity is in or acc is in g."""
    doubts = missing(rec)
    acc = {s: rec.acc_world[rec.acc_valid[:, s], s] for s in range(len(rec.sensors))}
    acc = {s: a for s, a in acc.items() if len(a) >= 2 * rec.rate_hz}
    usual = [float(np.median(np.linalg.norm(a, axis=1))) for a in acc.values()]
    if usual and np.median(usual) > LIVELY:
        found = f"{np.median(usual):.3g} m/s^2 in the median, more than bodies can"
        raise FormatError(path, f"{found}: in cm/s^2 or mg?", "acc_world")
    for s, a in acc.items():
        mean = a.mean(axis=0)
        size = float(np.linalg.norm(mean))
        where = f"sensor {rec.sensors[s]}: acc_world"
        found = f"mean ({mean[0]:.1f}, {mean[1]:.1f}, {mean[2]:.1f}) m/s^2"
        if np.linalg.norm(mean - [0, GRAVITY, 0]) < 2.5 or size > 8:
            raise FormatError(path, f"{found}, expected about 0: {_why(a, mean)}", where)
        if size > _swing(rec):
            doubts.append(doubt("acc-mean", rec.sensors[s], mean_m_s2=mean.tolist()))
    return doubts + against_reference(path, rec)


def _why(a: Array, mean: Array) -> str:
    """What explains the mean of acc_world (T,3) of one sensor, where it is no movement."""
    if np.linalg.norm(mean - [0, GRAVITY, 0]) < 2.5:
        return "gravity must be removed"
    if abs(float(np.linalg.norm(mean)) - GRAVITY) < 2.5:
        return "gravity must be removed, and it should be along +y"
    sizes = np.linalg.norm(a, axis=1)
    if np.median(sizes) > LIVELY:
        return f"{np.median(sizes):.3g} m/s^2 in the median, in cm/s^2 or mg?"
    return f"neither gravity nor movement, samples of up to {sizes.max():.3g} m/s^2"


def against_reference(path: Path, rec: Recording) -> list[Finding]:
    """Orientation and acceleration against a reference motion, where there is one."""
    if rec.reference is None:
        return []
    doubts = []
    R_ref = rec.reference.R_world_joint[:, rec.joint]
    use = rec.ori_valid
    for s, name in enumerate(rec.sensors):
        if use[:, s].any():
            off = ori.angle_between(rec.R_world_bone[use[:, s], s], R_ref[use[:, s], s])
            deg = float(np.rad2deg(np.median(off)))
            if deg > 30:
                doubts.append(doubt("off-reference", name, off_deg=deg))
    ratio = _acc_ratio(rec)
    if ratio is not None and ratio < 0:
        raise FormatError(
            path, "opposite to what the reference motion gives: reversed in sign?", "acc_world"
        )
    if ratio is not None and not 0.25 < ratio < 4:
        unit = ": in g (--units g)?" if 0.06 < ratio < 0.16 else ""
        raise FormatError(
            path, f"{ratio:.2g} times what the reference motion gives{unit}", "acc_world"
        )
    return doubts


def _acc_ratio(rec: Recording) -> float | None:
    """Slope of acc_world on the reference's accelerations, both relative to the pelvis and smoothed.

    Relative, because references without translation are known only so; negative where they are opposite,
    None where neither.
    """
    if rec.reference is None or len(rec) < rec.rate_hz or "pelvis" not in rec.sensors:
        return None
    root = rec.sensors.index("pelvis")
    p = sensor_positions(rec.reference, rec.joint, rec.placement)
    n = max(3, round(rec.rate_hz / 10))
    want = second_difference(p - p[:, [root]], rec.rate_hz)
    have = rec.acc_world - rec.acc_world[:, [root]]
    flat = (len(rec), -1)
    a, b = smoothed(have.reshape(flat), n), smoothed(want.reshape(flat), n)
    ok = np.isfinite(a) & np.isfinite(b)
    xy, xx, yy = (a[ok] * b[ok]).sum(), (b[ok] ** 2).sum(), (a[ok] ** 2).sum()
    # Still bodies tell nothing: their reference accelerates less than sensors err.
    if xx < 0.25 * ok.sum() or yy == 0 or abs(xy) < ALIKE * np.sqrt(xx * yy):
        return None
    return float(xy / xx)
