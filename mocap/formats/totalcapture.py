"""TotalCapture: the original Xsens files, and DIP's preprocessed pickles of it.

`*.sensors`: line 1 `n_sensors n_frames`; per frame its number from 1, then per sensor `name qw qx qy qz
acc(3) [gyr(3) mag(3)]`, acc with gravity in the sensor's frame, 60 Hz. With `*_calib_imu_bone.txt` and
`*_calib_imu_ref.txt` (a count, then `name qx qy qz qw`) the recording comes calibrated:

    R_S_B = R(q_bone)^T BONE,  R_I_M = R(q_ref)^T WORLD,  R_M_B = R_I_M^T R_I_S R_S_B

S sensor, I its inertial world, M the y-up SMPL world, B bone. No specification says so; one public
reader does, and what comes out is held against gravity and against the measured limb directions of
`gt_skel_gbl_pos.txt` (joint names, then `x y z` per cell in inches, x and z negated), where there is one.
Positions alone do not fix the twist of a limb, so they make no reference motion.

The preprocessed pickles hold `ori` (N,6,3,3), `acc` (N,6,3), `gt` (M,72), legs first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.findings import Finding, assumption, distinct, doubt
from mocap.formats import Document, Format, Options, _checks, _holes, _physics, _pickled, _text
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording
from mocap.sensors import SIX
from mocap.skeleton import Skeleton

PLACES: dict[str, str] = {
    "Head": "head", "Sternum": "sternum", "Pelvis": "pelvis",
    **{
        f"{S}_{theirs}": f"{side}_{ours}"
        for S, side in (("L", "left"), ("R", "right"))
        for theirs, ours in (
            ("UpArm", "upper_arm"), ("LowArm", "forearm"), ("UpLeg", "thigh"), ("LowLeg", "shank"),
            ("Foot", "foot"),
        )
    },
}  # fmt: skip
"""Sensor names of the file, and the places of the table."""

LEGS_FIRST = ("left_shank", "right_shank", "left_forearm", "right_forearm", "head", "pelvis")
BONE: Array = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])
WORLD: Array = np.diag([-1.0, 1.0, -1.0])
RATE = 60.0
INCH = 0.0254
# Limbs whose direction both positions and sensors tell: joints of the position file, our joints.
_LIMBS = {
    f"{side}_{place}": (f"{Side}{a}", f"{Side}{b}", joint + k, end + k)
    for k, (side, Side) in enumerate((("left", "Left"), ("right", "Right")))
    for place, a, b, joint, end in (
        ("upper_arm", "Arm", "ForeArm", 16, 18), ("forearm", "ForeArm", "Hand", 18, 20),
        ("thigh", "UpLeg", "Leg", 1, 4), ("shank", "Leg", "Foot", 4, 7),
    )
}  # fmt: skip
LIMB_DOUBT_DEG, LIMB_WRONG_DEG = 20.0, 60.0


@dataclass(frozen=True, eq=False)
class _Sensors:
    """A `.sensors` file: names, quaternions wxyz (T,S,4), acc (T,S,3), gyr and mag or None."""

    names: tuple[str, ...]
    quat: Array
    acc: Array
    gyr: Array | None
    mag: Array | None


def _integers(path: Path, line: str, count: int, number: int) -> list[int]:
    cells = line.split()
    if len(cells) != count or not all(c.isascii() and c.isdigit() for c in cells):
        expected = "the numbers of sensors and frames" if count == 2 else "a frame number"
        raise FormatError(path, f"{line.strip()[:40]!r}, expected {expected}", f"line {number}")
    return [int(c[:12]) for c in cells]


def _parse(path: Path) -> _Sensors:
    lines = _text.lines(path)
    number, line = next(lines, (1, ""))
    S, T = _integers(path, line, 2, number)
    if not 1 <= S <= 64 or T < 1:
        raise FormatError(path, f"declares {S} sensors and {T} frames", "line 1")
    names: list[str] = []
    rows: _text.Rows | None = None
    count = 0
    for number, line in lines:
        if not line.strip():
            continue
        place = count % (S + 1)
        frame = count // (S + 1)
        count += 1
        if place == 0:
            (said,) = _integers(path, line, 1, number)
            if said != frame + 1:
                raise FormatError(path, f"frame {said}, expected {frame + 1}", f"line {number}")
            continue
        name, *cells = line.split()
        if frame == 0:
            names.append(name)
        elif name != names[place - 1]:
            raise FormatError(
                path, f"sensor {name!r}, expected {names[place - 1]!r}", f"line {number}"
            )
        if rows is None:
            if len(cells) not in (7, 13):
                raise FormatError(path, f"{len(cells)} values, expected 7 or 13", f"line {number}")
            rows = _text.Rows(path, [f"value {i + 1}" for i in range(len(cells))])
        rows.add(number, cells)
    table = np.empty((0, 7)) if rows is None else rows.table()
    if len(table) != S * T or count != (S + 1) * T:
        raise FormatError(
            path, f"declares {T} frames of {S} sensors, holds {len(table) / S:.4g}: cut short?"
        )
    table = table.reshape(T, S, -1)
    aux = table.shape[-1] == 13
    return _Sensors(
        tuple(names),
        table[..., :4],
        table[..., 4:7],
        table[..., 7:10] if aux else None,
        table[..., 10:] if aux else None,
    )


def _beside(path: Path, kind: str) -> Path | None:
    """The calibration file of this take, in the same folder or in `imu/<subject>` of the data set."""
    take = path.name.split("_Xsens")[0].lower()
    subject = path.parent.name.lower()
    folders = (path.parent, path.parent.parent.parent / "imu" / path.parent.name)
    names = (f"{take}_{kind}.txt", f"{subject}_{take}_{kind}.txt", f"{kind}.txt")
    return next((f / n for f in folders for n in names if (f / n).is_file()), None)


def _positions_file(path: Path) -> Path | None:
    """`gt_skel_gbl_pos.txt` beside the take, in a folder named after it, or in the data set's `vicon`."""
    take = path.name.split("_Xsens")[0].lower().rpartition("_")[2]
    root = path.parent.parent.parent
    folders = (path.parent, path.parent / take, root / "vicon" / path.parent.name / take,
               root / "vicon" / path.parent.name.upper() / take)  # fmt: skip
    name = "gt_skel_gbl_pos.txt"
    return next((f / name for f in folders if (f / name).is_file()), None)


def _calibration(path: Path, names: tuple[str, ...]) -> Array:
    """R(q) (S,3,3) of a calibration file, in the order of `names`."""
    found: dict[str, list[float]] = {}
    for number, line in _text.lines(path):
        name, *cells = line.split() or [""]
        if number == 1 or not name:
            continue
        if len(cells) != 4:
            raise FormatError(path, f"{len(cells)} values, expected x y z w", f"line {number}")
        found[name] = [_text.number(path, c, f"line {number}, sensor {name}") for c in cells]
    missing = [n for n in names if n not in found]
    if missing:
        raise FormatError(path, f"no line for sensor {', '.join(missing)}")
    quat = np.array([[found[n] for n in names]])
    R, zeros = _checks.quaternions(path, quat, names, "calibration", scalar_first=False)
    if zeros or not np.isfinite(R).all():
        raise FormatError(path, "a quaternion is zero or not finite, expected norm 1")
    return R[0]


def _positions(path: Path) -> dict[str, Array]:
    """{joint: (T,3) m} of a position file, in our y-up world."""
    lines = _text.lines(path)
    _, header = next(lines, (0, ""))
    joints = header.rstrip().split("\t")
    rows = _text.Rows(path, [f"{j} {a}" for j in joints for a in "xyz"])
    for number, line in lines:
        if line.strip():
            rows.add(number, line.split())
    table = rows.table().reshape(-1, len(joints), 3) * INCH * np.diag(WORLD)
    return {name: table[:, j] for j, name in enumerate(joints)}


def _limb_doubts(path: Path, rec: Recording, positions: dict[str, Array]) -> list[Finding]:
    """Directions of limbs by the sensors against those by position; both end together."""
    rest = Skeleton.default().rest_positions
    off = {}
    for place, (a, b, joint, end) in _LIMBS.items():
        if place not in rec.sensors or a not in positions or b not in positions:
            continue
        measured = positions[b] - positions[a]
        T = min(len(measured), len(rec))
        measured = measured[-T:]
        bone = rec.R_world_bone[-T:, rec.sensors.index(place)] @ (rest[end] - rest[joint])
        size = np.linalg.norm(measured, axis=-1) * np.linalg.norm(bone, axis=-1)
        angle = np.arccos(np.clip((measured * bone).sum(-1) / size, -1, 1))
        if np.isfinite(angle).any():
            off[place] = float(np.rad2deg(np.nanmedian(angle)))
    wrong = {n: a for n, a in off.items() if a > LIMB_DOUBT_DEG}
    if not off:
        return [doubt("limbs-unchecked")]
    if float(np.median(list(off.values()))) > LIMB_WRONG_DEG:
        raise FormatError(
            path,
            f"sensors point the limbs {np.median(list(off.values())):.0f} deg (median) from the "
            f"positions: the calibration files do not mean what is assumed",
        )
    return [doubt("limb-off", n, off_deg=a) for n, a in wrong.items()]


def _read_sensors(path: Path, options: Options) -> Document:
    data = _parse(path)
    unknown = [n for n in data.names if n not in PLACES]
    if unknown:
        raise FormatError(path, f"sensor {unknown[0]!r}, expected one of {', '.join(PLACES)}")
    sensors = tuple(PLACES[n] for n in data.names)
    rate = options.rate_hz or RATE
    R_I_S, zeros = _checks.quaternions(path, data.quat, data.names, "orientation")
    acc_unit, gyr_unit = _physics.factors(options)
    measured = data.acc * acc_unit
    assumed = [] if options.rate_hz else [assumption("rate-of-data-set", rate_hz=RATE)]
    doubts = [doubt("zero-quaternions", count=zeros)] if zeros else []
    if data.gyr is None:
        assumed.append(assumption("rates-of-orientation"))
    gyr = _checks.rates(R_I_S, rate) if data.gyr is None else data.gyr * gyr_unit
    bone, ref = _beside(path, "calib_imu_bone"), _beside(path, "calib_imu_ref")
    if bone is None or ref is None:
        doubts.append(doubt("no-calibration-files"))
        assumed.append(assumption("world-of-sensors"))
        rec = RawRecording(rate, sensors, gyr, measured, data.mag, ori.R_YUP_ZUP @ R_I_S)
        return Document("totalcapture", rec, tuple(assumed), (*doubts, *_physics.raw(path, rec)))
    R_S_B = np.swapaxes(_calibration(bone, data.names), -1, -2) @ BONE
    R_M_S = WORLD @ _calibration(ref, data.names) @ R_I_S  # R_I_M^T = WORLD^T R(q), WORLD symmetric
    raw = RawRecording(rate, sensors, gyr, measured, data.mag, R_M_S)
    doubts += _physics.raw(path, raw)
    acc = np.einsum("tsij,tsj->tsi", R_M_S, measured) - np.array([0, ori.GRAVITY, 0])
    calibrated = Recording(rate, sensors, R_M_S @ R_S_B, acc, valid=raw.valid)
    assumed.append(assumption("calibrated-by", bone=bone.name, reference=ref.name))
    positions = _positions_file(path)
    if positions is None:
        doubts.append(doubt("no-positions"))
    else:
        doubts += _limb_doubts(path, calibrated, _positions(positions))
        assumed.append(assumption("limbs-checked", file=positions.name))
    doubts += _physics.calibrated(path, calibrated)
    return Document("totalcapture", calibrated, tuple(assumed), tuple(distinct(doubts)))


def _read_pickle(path: Path, options: Options) -> Document:
    data = _pickled.fields(path)
    R, acc, pose = (_pickled.array(path, data, n) for n in ("ori", "acc", "gt"))
    for name, value, tail in (("ori", R, (6, 3, 3)), ("acc", acc, (6, 3)), ("gt", pose, (72,))):
        if value.shape[1:] != tail or not len(value):
            raise FormatError(
                path, f"is {value.shape}, expected (N, {str(tail)[1:]}", f"field {name}"
            )
    T = min(len(R), len(acc), len(pose))
    longest = max(len(R), len(acc), len(pose))
    if longest - T > 3:
        raise FormatError(path, f"ori, acc and gt have {len(R)}, {len(acc)} and {len(pose)} frames")
    doubts = [doubt("lengths-differ", by=longest - T, frames=T)] if longest > T else []
    rate = options.rate_hz or RATE
    R = _checks.rotations(path, R[:T], LEGS_FIRST, "ori")
    whole = _holes.poses(pose[:T], rate)
    start_s = whole.kept.start / rate
    body = _pickled.body(options)
    reference, said = _pickled.reference(path, rate, whole.values, body, start_s)
    R, acc = R[whole.kept], acc[:T][whole.kept] * _physics.factors(options)[0]
    rec = Recording(rate, LEGS_FIRST, R, acc, reference=reference, start_s=start_s).select(SIX)
    assumed = (
        assumption("legs-first", rate_hz=rate),
        assumption("aligned-in-frame-0"),
    )
    doubts += [*whole.notes, *said, *_physics.calibrated(path, rec)]
    return Document("totalcapture", rec, assumed, tuple(doubts))


def _read(path: Path, options: Options) -> Document:
    return (_read_pickle if path.suffix.lower() == ".pkl" else _read_sensors)(path, options)


def _sniff(path: Path, head: bytes) -> bool:
    if path.suffix.lower() == ".pkl":
        return not _pickled.mentions(path, b"imu_ori") and all(
            _pickled.mentions(path, key) for key in (b"ori", b"acc", b"gt")
        )
    first = head.split(b"\n", 1)[0].split()
    return len(first) == 2 and all(c.isdigit() for c in first)


FORMAT = Format(
    "totalcapture",
    (".sensors", ".pkl"),
    _sniff,
    _checks.quiet(_read),
    kinds=("raw", "recording"),
    about="TotalCapture's Xsens files, or DIP's pickles of it",
    sign="TotalCapture",
)
