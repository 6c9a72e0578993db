"""MVNX, the XML that Xsens MVN exports: segment orientations and positions, and the sensors behind them.

Read by tag. A frame of type `normal` holds `orientation` (wxyz per segment), `position` (m), and per
sensor `sensorOrientation` (wxyz) and `sensorFreeAcceleration` (m/s^2, gravity removed, world); where there is
`sensorAcceleration` instead, gravity tells whose axes it is in. The world is z-up with x forward: (x, y, z)
becomes our (y, z, x). Segment frames are the world's in the T-pose, with straight arms and legs. Our bones'
are the world's in our rest pose, so those of arms and legs are turned from one to the other, as in
`_retarget`.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.errors import FormatError, ShapeError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Document, Format, Options, _checks, _clock, _holes, _physics, _text, _xml
from mocap.formats._neutral import straightening
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton

# Our axes of theirs: v_ours = R_OURS_MVN v_mvn, x left, y up, z forward of x forward, y left, z up.
R_OURS_MVN: Array = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
PLACES: dict[str, str] = {
    "Pelvis": "pelvis", "T8": "sternum", "Head": "head",
    **{
        f"{Side}{theirs}": f"{Side.lower()}_{ours}"
        for Side in ("Left", "Right")
        for theirs, ours in (
            ("Shoulder", "shoulder_blade"), ("UpperArm", "upper_arm"), ("ForeArm", "forearm"),
            ("Hand", "hand"), ("UpperLeg", "thigh"), ("LowerLeg", "shank"), ("Foot", "foot"),
        )
    },
}  # fmt: skip
"""Segments that carry a sensor, and the places of the table."""

CARRIERS = (
    "Pelvis", "LeftUpperLeg", "RightUpperLeg", "L5", "LeftLowerLeg", "RightLowerLeg", "T12",
    "LeftFoot", "RightFoot", "T8", "LeftToe", "RightToe", "Neck", "LeftShoulder", "RightShoulder",
    "Head", "LeftUpperArm", "RightUpperArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
    "LeftHand", "RightHand",
)  # fmt: skip
"""The segment whose orientation each of our 24 joints takes."""

_FREE, _SENSED = "sensorFreeAcceleration", "sensorAcceleration"
_PER = {"orientation": 4, "position": 3, "sensorOrientation": 4, _FREE: 3, _SENSED: 3}
_SENSOR_TAGS = ("sensorOrientation", _FREE, _SENSED)
_WANTED = frozenset(_PER)
_CALIBRATION_FRAMES = ("identity", "tpose", "tpose-isb", "npose")
SPREAD_DEG = 10.0  # a sensor that moves more than this on its segment is worth a warning
MAX_NAMES = 200
LONGEST_TAKE_S = 1e6  # times beyond it count from 1970, not from the take's beginning
REACH = (0.25, 3.0)  # m: from the pelvis to the farthest segment, of a child that squats to a giant


@dataclass
class _Take:
    """What one pass over the file collects: names, rate, numbers of normal frames, the first T-pose."""

    rate_hz: float | None = None
    segments: list[str] = field(default_factory=list)
    sensors: list[str] = field(default_factory=list)
    values: dict[str, array[float]] = field(
        default_factory=lambda: {tag: array("f") for tag in _PER}
    )
    times: array[float] = field(default_factory=lambda: array("d"))
    tpose: dict[str, list[float]] = field(default_factory=dict)
    tpose_kind: str = ""


def _collect(path: Path) -> _Take:
    take = _Take()
    elements = _xml.elements(path, _WANTED)
    for e in elements:
        if e.text is not None:
            continue
        if e.tag == "subject":
            rate = e.attributes.get("frameRate")
            take.rate_hz = (
                None if rate is None else _text.number(path, rate, f"line {e.line}: frameRate")
            )
        elif e.tag in ("segment", "sensor"):
            names = take.segments if e.tag == "segment" else take.sensors
            names.append(e.attributes.get("label", ""))
            if len(names) > MAX_NAMES:
                raise FormatError(path, f"more than {MAX_NAMES} of <{e.tag}>", f"line {e.line}")
        elif e.tag == "frame":
            _frame(path, take, e, elements)
    return take


def _frame(path: Path, take: _Take, start: _xml.Element, elements: Iterator[_xml.Element]) -> None:
    """Read one <frame> up to its end: numbers of normal frames, the pose of the calibration frames."""
    kind = start.attributes.get("type", "normal") or "normal"
    number = len(take.times)
    found: dict[str, list[float]] = {}
    for e in elements:
        if e.text is None:
            continue
        if e.tag == "frame":
            break
        if e.tag in _WANTED:
            where = f"line {e.line}, frame {number}: {e.tag}"
            found[e.tag] = [_text.number(path, cell, where) for cell in e.text.split()]
            sensor = e.tag in _SENSOR_TAGS
            expected = _PER[e.tag] * len(take.sensors if sensor else take.segments)
            if len(found[e.tag]) != expected:
                raise FormatError(path, f"{len(found[e.tag])} numbers, expected {expected}", where)
    if kind in _CALIBRATION_FRAMES:
        if not take.tpose or kind == "tpose":
            take.tpose, take.tpose_kind = found, kind
        return
    if kind != "normal":
        return
    for tag, values in take.values.items():
        if tag in found:
            values.extend(found[tag])
        elif len(values) or (number and tag == "orientation"):
            raise FormatError(path, f"no <{tag}>", f"line {start.line}, frame {number}")
    time = start.attributes.get("time", "")
    take.times.append(_text.number(path, time, f"line {start.line}: time") if time else np.nan)


def _array(path: Path, take: _Take, tag: str) -> Array | None:
    """(T,N,k) of one tag, or None where the file lacks it."""
    values = take.values[tag]
    if not values:
        return None
    N = len(take.sensors if tag in _SENSOR_TAGS else take.segments)
    if len(values) != len(take.times) * N * _PER[tag]:
        raise FormatError(path, f"<{tag}> is missing in some frames")
    return np.asarray(values, float).reshape(len(take.times), N, _PER[tag])


@dataclass(frozen=True, eq=False)
class _Clock:
    """rate_hz; frames (N,): where the file's frames lie among all; start_s: time of the first; doubts."""

    rate_hz: float
    frames: NDArray[np.int64]
    start_s: float
    doubts: list[Finding]

    @property
    def whole(self) -> bool:
        """Whether no frame is missing."""
        return len(self.frames) == int(self.frames[-1]) + 1

    def placed(self, values: Array) -> Array:
        """Values (N,...) of the file's frames among all (T,...); NaN where one is missing."""
        if self.whole:
            return values
        out = np.full((int(self.frames[-1]) + 1, *values.shape[1:]), np.nan)
        out[self.frames] = values
        return out


def _clock_of(path: Path, take: _Take, options: Options) -> _Clock:
    """frameRate, held against the frames' times (ms); frames that are missing stay gaps."""
    times = np.asarray(take.times) / 1000
    rate = options.rate_hz or take.rate_hz
    if np.isfinite(times).all() and len(times) > 1:
        found = _clock.grid(path, times, "time")
        if rate is not None and abs(found.rate_hz / rate - 1) > 0.05:
            raise FormatError(
                path, f"times run at {found.rate_hz:.4g} Hz, frameRate is {rate:g}", "time"
            )
        start = float(times[0]) if 0 < times[0] < LONGEST_TAKE_S else 0.0
        return _Clock(rate or found.rate_hz, found.frames, start, list(found.doubts))
    if rate is None:
        raise FormatError(path, "neither frameRate nor times (say rate)")
    doubts = [doubt("no-time")]
    return _Clock(rate, np.arange(len(times)), 0.0, doubts)


def _turned(path: Path, quat: Array, names: tuple[str, ...], tag: str) -> Array:
    """P R P^T (T,N,3,3): orientations in our axes, of frames that are ours too in the T-pose."""
    R, zeros = _checks.quaternions(path, quat, names, tag)
    if zeros:
        t, s = np.argwhere(np.linalg.norm(quat, axis=-1) == 0)[0]
        if tag == "orientation":
            raise FormatError(path, "is zero, expected norm 1", _checks.at(names, t, s, tag))
    return R_OURS_MVN @ R @ R_OURS_MVN.T


def straightened(body: Skeleton) -> dict[int, Array]:
    """R_segment_bone (3,3) of thighs, shanks, upper arms and forearms, by our joint index.

    A segment's frame is the world's in the T-pose with straight limbs; our bones' are in our rest pose.
    """
    turns = straightening(body.rest_positions, {j: j for j in range(24)})
    return {joint: S.T for joint, S in turns.items()}


def root(p_world_pelvis: Array, R_world_pelvis: Array, body: Skeleton) -> Array:
    """p_world_root (...,3) m of where the pelvis segment's origin is, which lies between the hips."""
    between = body.rest_positions[[1, 2]].mean(axis=0) - body.offsets[0]
    return np.asarray(p_world_pelvis - R_world_pelvis @ between)


def _bones(take: _Take, R: Array, body: Skeleton) -> Array:
    """R_world_bone (T,N,3,3) of our body from R_world_segment, segments as they are named."""
    R = np.array(R)
    for joint, R_segment_bone in straightened(body).items():
        if CARRIERS[joint] in take.segments:
            i = take.segments.index(CARRIERS[joint])
            R[:, i] = R[:, i] @ R_segment_bone
    return R


def _body(take: _Take, options: Options) -> tuple[Skeleton, list[Finding]]:
    """The table's body at the wearer's stature: by the height of the head joint over the toes."""
    if options.smpl is not None:
        return Skeleton.from_smpl_file(options.smpl), []
    if options.height is not None:
        return Skeleton.default(options.height), []
    table = Skeleton.default()
    position = np.asarray(take.tpose.get("position", ()), float).reshape(-1, 3)
    names = take.segments
    if len(position) and {"Head", "LeftToe", "RightToe"} <= set(names):
        toes = [position[names.index(n), 2] for n in ("LeftToe", "RightToe")]
        span = position[names.index("Head"), 2] - min(toes)
        rest = table.rest_positions
        height = float(span / (rest[15, 1] - rest[[10, 11], 1].min()) * table.stature)
        try:
            said = assumption("stature-of-frame", stature_m=height, frame=take.tpose_kind)
            return Skeleton.default(height), [said]
        except ShapeError:
            pass
    return table, [assumption("stature-of-table", stature_m=table.stature)]


def _is_tpose(take: _Take) -> bool | None:
    """Whether the arms are level in the calibration frame; None where it has no positions."""
    position = np.asarray(take.tpose.get("position", ()), float).reshape(-1, 3)
    names = take.segments
    if not len(position) or not {"LeftUpperArm", "LeftHand"} <= set(names):
        return None
    arm = position[names.index("LeftHand")] - position[names.index("LeftUpperArm")]
    return bool(abs(arm[2]) < 0.5 * np.linalg.norm(arm))


def _positions(path: Path, take: _Take) -> Array | None:
    """Positions (T,N,3) m, or None where the file has none.

    Raises FormatError where the pelvis' is not finite, or segments lie farther apart than a body's.
    """
    position = _array(path, take, "position")
    if position is None:
        return None
    pelvis = position[:, [take.segments.index("Pelvis")]]
    bad = ~np.isfinite(pelvis[:, 0]).all(-1)
    if bad.any():
        where = _checks.at(("Pelvis",), int(np.argmax(bad)), 0, "position")
        raise FormatError(path, "not finite", where)
    reach = np.linalg.norm(position - pelvis, axis=-1)
    farthest = float(np.median(np.where(np.isfinite(reach), reach, 0.0).max(axis=1)))
    if not REACH[0] < farthest < REACH[1]:
        found = f"the farthest segment lies {farthest:.3g} from the pelvis"
        raise FormatError(path, f"{found}, expected metres", "position")
    return position


def _motion(
    path: Path, take: _Take, R: Array, clock: _Clock, body: Skeleton
) -> tuple[Motion | None, slice, tuple[Finding, ...]]:
    """R_world_bone (N,n,3,3) by segment, on our tree, the frames that it covers, and what was mended.

    None where more than half of the frames are beyond a
    hole too long to be bridged.
    """
    index = [take.segments.index(n) for n in CARRIERS]
    R_world_joint = R[:, index]
    position = _positions(path, take)
    if position is None:
        p = np.zeros((len(R), 3))
    else:
        pelvis = position[:, take.segments.index("Pelvis")] @ R_OURS_MVN.T
        p = root(pelvis, R_world_joint[:, 0], body)
    mended = _holes.rotations(clock.placed(R_world_joint), clock.rate_hz)
    if not np.isfinite(mended.values).all():
        return None, slice(0, len(mended.values)), ()
    every = np.arange(int(clock.frames[-1]) + 1)[mended.kept]
    p = np.stack([np.interp(every, clock.frames, p[:, k]) for k in range(3)], axis=1)
    local = body.local_rotations(mended.values)
    start = clock.start_s + mended.kept.start / clock.rate_hz
    return Motion(clock.rate_hz, local, p, body, start), mended.kept, mended.notes


def _recording(
    path: Path,
    take: _Take,
    R_carrier: Array,
    motion: Motion | None,
    kept: slice,
    clock: _Clock,
    options: Options,
) -> tuple[Recording, list[Finding]]:
    """Sensors on their bones: R_world_bone = R_world_sensor R_bone_sensor^T.

    R_carrier (N,n,3,3): R_world_bone by segment. R_bone_sensor is the chordal mean over all frames of its
    inverse times R_world_sensor. Of all frames those `kept` are in the recording.
    """
    quat = _array(path, take, "sensorOrientation")
    assert quat is not None
    use = [s for s, n in enumerate(take.sensors) if n in PLACES and n in take.segments]
    names = tuple(take.sensors[s] for s in use)
    sensors = tuple(PLACES[n] for n in names)
    R = _turned(path, quat[:, use], names, "sensorOrientation")
    carrier = R_carrier[:, [take.segments.index(n) for n in names]]
    relative = np.swapaxes(carrier, -1, -2) @ R
    R_bone = np.empty_like(R)
    doubts = []
    left_out = [n for n in take.sensors if n not in names]
    if left_out:
        doubts.append(doubt("sensors-left-out", sensors=", ".join(left_out)))
    for s, name in enumerate(sensors):
        ok = np.isfinite(relative[:, s]).all((-1, -2))
        if not ok.any():
            R_bone[:, s] = np.nan
            continue
        mount = ori.mean(relative[ok, s])
        R_bone[:, s] = R[:, s] @ mount.T
        spread = float(np.rad2deg(np.median(ori.angle_between(mount, relative[ok, s]))))
        if spread > SPREAD_DEG:
            doubts.append(doubt("mounting-varies", name, off_deg=spread))
    acc, more = _acceleration(path, take, use, R, _physics.factors(options)[0])
    R_bone, acc = (clock.placed(x)[kept] for x in (R_bone, acc))
    start = clock.start_s + kept.start / clock.rate_hz
    rec = Recording(clock.rate_hz, sensors, R_bone, acc, reference=motion, start_s=start)
    return rec, doubts + more


def _acceleration(
    path: Path, take: _Take, use: list[int], R: Array, unit: float
) -> tuple[Array, list[Finding]]:
    """acc_world (N,S,3) m/s^2 of the sensors `use`, and doubts. R: their orientations in our axes.

    Free acceleration as it is. Of `sensorAcceleration`, which versions write in the sensor's axes or in the
    world's, with gravity or without, the reading counts whose mean is nearest to what a body's is.
    """
    free = _array(path, take, _FREE)
    if free is not None:
        return free[:, use] @ R_OURS_MVN.T * unit, []
    sensed = _array(path, take, _SENSED)
    if sensed is None:
        return np.full((*R.shape[:2], 3), np.nan), [doubt("no-free-acc", field=_FREE)]
    world = sensed[:, use] @ R_OURS_MVN.T * unit
    turned = np.einsum("tsij,tsj->tsi", R, world)
    up = np.array([0.0, ori.GRAVITY, 0.0])
    readings = {
        "in the sensors' axes with gravity, which is taken off": turned - up,
        "in the world's axes with gravity, which is taken off": world - up,
        "in the world's axes without gravity": world,
    }
    size = {
        k: float(np.linalg.norm(np.nanmean(a, axis=0), axis=-1).mean()) for k, a in readings.items()
    }
    best = min(size, key=lambda k: size[k])
    return readings[best], [doubt("acc-read-as", field=_FREE, instead=_SENSED, reading=best)]


def _read(path: Path, options: Options) -> Document:
    take = _collect(path)
    if not len(take.times):
        raise FormatError(path, "no frame of type normal")
    quat = _array(path, take, "orientation")
    if quat is None or not take.segments:
        raise FormatError(path, "no segment orientation")
    clock = _clock_of(path, take, options)
    doubts = clock.doubts
    R = _turned(path, quat, tuple(take.segments), "orientation")
    if not np.isfinite(R).all():
        t, s = np.argwhere(~np.isfinite(R).all((-1, -2)))[0]
        where = _checks.at(tuple(take.segments), t, s, "orientation")
        raise FormatError(path, "not finite", where)
    body, assumed = _body(take, options)
    R = _bones(take, R, body)
    missing = [n for n in dict.fromkeys(CARRIERS) if n not in take.segments]
    motion, kept = None, slice(0, int(clock.frames[-1]) + 1)
    if missing:
        doubts.append(doubt("segments-missing", segments=", ".join(missing)))
    else:
        motion, kept, mended = _motion(path, take, R, clock, body)
        doubts += mended or ([] if motion else [doubt("no-reference-holes")])
    assumed = [assumption("world-of-mvn"), *assumed]
    level = _is_tpose(take)
    if level is False:
        doubts.append(doubt("arms-hang", frame=take.tpose_kind))
    has_sensors = bool(take.values["sensorOrientation"])
    if has_sensors and any(n in PLACES and n in take.segments for n in take.sensors):
        rec, more = _recording(path, take, R, motion, kept, clock, options)
        assumed.append(assumption("mounted-at-mean"))
        doubts += more + _physics.calibrated(path, rec)
        return Document("mvnx", rec, tuple(assumed), tuple(doubts))
    if motion is None:
        why = f"no {', '.join(missing)}" if missing else "too many frames are missing"
        raise FormatError(path, f"neither sensors nor a whole body: {why}")
    return Document("mvnx", motion, tuple(assumed), (*doubts, doubt("no-sensor-data")))


def _sniff(path: Path, head: bytes) -> bool:
    return b"<mvnx" in head or head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<?xml")


FORMAT = Format(
    "mvnx",
    (".mvnx",),
    _sniff,
    _checks.quiet(_read),
    kinds=("recording", "motion"),
    about="Xsens MVN exports, with the suit's motion as reference",
    sign="Xsens MVNX",
)
