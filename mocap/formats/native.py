"""The project's own files: numpy archives, no pickles.

Recordings, "poser-recording/1" and "poser-raw/1": world y up, right-handed. A reference's `trans` is SMPL's:
p_world_root = J0 + trans, J0 the rest pelvis of the reference's body.

Motions: AMASS files (`mocap.formats.amass`) with one more field, `start_s`: the time of the first frame on
the recording's clock, s. Where it is missing nobody has said, and it is read as 0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import FormatError, PoserError
from mocap.formats import Content, Document, Format, Options, _checks, _npz, _physics, amass
from mocap.formats._files import write_aside
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.skeleton import Skeleton

RECORDING = "poser-recording/1"
RAW = "poser-raw/1"
_COMMON = (
    "schema", "rate_hz", "sensors", "valid", "start_s", "poses", "trans", "betas", "offsets",
)  # fmt: skip
_RECORDING = (
    *_COMMON, "R_world_bone", "acc_world", "placement", "joint", "calibration", "noise", "notes",
)  # fmt: skip
_RAW = (
    *_COMMON, "gyr", "acc", "mag", "R_world_sensor", "truth", "facing_rad", "common_heading",
)  # fmt: skip


def read_recording(path: str | Path, options: Options | None = None) -> Recording:
    """A calibrated recording of a "poser-recording/1" file.

    R_world_bone (T,S,3,3) and acc_world (T,S,3) m/s^2 come back as float64; "g" among the options' units
    says that a file, against the schema, has that. Raises FormatError naming the field that is missing or
    does not fit, also for a file of another schema.
    """
    path = Path(path)
    fields = _fields(path, RECORDING)
    sensors = fields.texts("sensors")
    S = len(sensors)
    R = fields.floats("R_world_bone", (None, S, 3, 3))
    T = len(R)
    acc = fields.floats("acc_world", (T, S, 3)) * _physics.factors(options or Options())[0]
    rate = fields.number("rate_hz")
    start = fields.number("start_s") if "start_s" in fields else 0.0
    return _made(
        path,
        Recording,
        rate_hz=rate,
        sensors=sensors,
        R_world_bone=R,
        acc_world=acc,
        valid=fields.bools("valid", (T, S)) if "valid" in fields else None,
        joint=fields.integers("joint", (S,)) if "joint" in fields else None,
        placement=fields.floats("placement", (S, 3)) if "placement" in fields else None,
        reference=_reference(fields, rate, T, start, options),
        calibration=fields.mapping("calibration"),
        noise=fields.mapping("noise"),
        start_s=start,
        notes=fields.texts("notes") if "notes" in fields else (),
    )


def read_raw(path: str | Path, options: Options | None = None) -> RawRecording:
    """A raw recording of a "poser-raw/1" file.

    gyr (T,S,3) rad/s, acc (T,S,3) m/s^2 with gravity, in the sensors' frames; "g" and "deg/s" among the
    options' units say that a file, against the schema, has those. Raises FormatError naming the field that
    is missing or does not fit, also for a file of another schema.
    """
    path = Path(path)
    fields = _fields(path, RAW)
    acc_unit, gyr_unit = _physics.factors(options or Options())
    sensors = fields.texts("sensors")
    S = len(sensors)
    acc = fields.floats("acc", (None, S, 3)) * acc_unit
    T = len(acc)
    rate = fields.number("rate_hz")
    has_R = "R_world_sensor" in fields
    start = fields.number("start_s") if "start_s" in fields else 0.0
    return _made(
        path,
        RawRecording,
        rate_hz=rate,
        sensors=sensors,
        gyr=fields.floats("gyr", (T, S, 3)) * gyr_unit,
        acc=acc,
        mag=fields.floats("mag", (T, S, 3)) if "mag" in fields else None,
        R_world_sensor=fields.floats("R_world_sensor", (T, S, 3, 3)) if has_R else None,
        valid=fields.bools("valid", (T, S)) if "valid" in fields else None,
        reference=_reference(fields, rate, T, start, options),
        truth=fields.mapping("truth"),
        start_s=start,
        facing_rad=fields.number("facing_rad") if "facing_rad" in fields else None,
        common_heading=bool(fields.number("common_heading"))
        if "common_heading" in fields
        else True,
    )


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a "poser-recording/1" file: R_world_bone and acc_world as float32, all else in full.

    The file appears whole or not at all. Raises OSError where it cannot be written.
    """
    arrays: dict[str, Any] = {
        "schema": RECORDING,
        "rate_hz": recording.rate_hz,
        "sensors": np.array(recording.sensors),
        "R_world_bone": recording.R_world_bone.astype(np.float32),
        "acc_world": recording.acc_world.astype(np.float32),
        "valid": recording.valid,
        "placement": recording.placement,
        "joint": recording.joint,
        "start_s": recording.start_s,
    }
    for name, value in (("calibration", recording.calibration), ("noise", recording.noise)):
        if value is not None:
            arrays[name] = _json(value)
    if recording.notes:
        arrays["notes"] = np.array(recording.notes)
    _write(Path(path), arrays, recording.reference)


def write_raw(path: str | Path, raw: RawRecording) -> None:
    """Write a "poser-raw/1" file: measurements as float32, a reference in full.

    The file appears whole or not at all. Raises OSError where it cannot be written.
    """
    arrays: dict[str, Any] = {
        "schema": RAW,
        "rate_hz": raw.rate_hz,
        "sensors": np.array(raw.sensors),
        "gyr": raw.gyr.astype(np.float32),
        "acc": raw.acc.astype(np.float32),
        "valid": raw.valid,
        "start_s": raw.start_s,
    }
    if raw.mag is not None:
        arrays["mag"] = raw.mag.astype(np.float32)
    if raw.R_world_sensor is not None:
        arrays["R_world_sensor"] = raw.R_world_sensor.astype(np.float32)
    if raw.facing_rad is not None:
        arrays["facing_rad"] = raw.facing_rad
    if not raw.common_heading:
        arrays["common_heading"] = 0
    if raw.truth is not None:
        arrays["truth"] = _json(raw.truth)
    _write(Path(path), arrays, raw.reference)


def write_motion(
    path: str | Path, motion: Motion, extra: Mapping[str, np.ndarray] | None = None
) -> None:
    """Write a motion as `mocap.formats.amass.write_motion` does, with its `start_s`."""
    amass.write_motion(path, motion, {**(extra or {}), "start_s": np.array(motion.start_s)})


def states_start(path: str | Path) -> bool:
    """Whether a native file says when its first frame was, and need not be taken to begin at 0."""
    return "start_s" in _npz.names(Path(path))


def deviations(path: str | Path, motion: Motion) -> np.ndarray | None:
    """std_rad (T,24,3) rad that a native file states of its motion's joints, or None. Raises FormatError."""
    path = Path(path)
    if "std_rad" not in _npz.names(path):
        return None
    found = _npz.Fields(path, _npz.load(path, ("std_rad",))).floats("std_rad", (len(motion), 24, 3))
    if not (np.isfinite(found) & (found > 0)).all():
        raise FormatError(path, "std_rad must be finite and positive")
    return found


def _fields(path: Path, schema: str) -> _npz.Fields:
    """The arrays of a file of this schema, which is looked at before anything large is read."""
    found = _npz.Fields(path, _npz.load(path, ("schema",))).text("schema")
    if found != schema:
        raise FormatError(path, f"schema is {found[:60]!r}, expected {schema!r}")
    return _npz.Fields(path, _npz.load(path, _RECORDING if schema == RECORDING else _RAW))


def _made(path: Path, kind: Any, **values: Any) -> Any:
    try:
        return kind(**values)
    except FormatError:
        raise
    except PoserError as e:
        raise FormatError(path, str(e)) from e


def _reference(
    fields: _npz.Fields, rate_hz: float, T: int, start_s: float, options: Options | None
) -> Motion | None:
    """The reference motion, where the file has one.

    Its body, in this order: the user's SMPL file with the file's betas; the bone vectors the file
    carries; the table. The bone vectors are an extra that only bodies other than the table's need.
    """
    if "poses" not in fields:
        return None
    path = fields.path
    poses = fields.floats("poses", (T, 72))
    trans = fields.floats("trans", (T, 3))
    betas = fields.floats("betas", (None,)) if "betas" in fields else np.zeros(10)
    for name, values in (("poses", poses), ("trans", trans)):
        if not np.isfinite(values).all():
            t = int(np.argwhere(~np.isfinite(values))[0][0])
            raise FormatError(path, f"{name} of the reference is not finite", f"frame {t}")
    try:
        if options is not None and options.smpl is not None:
            body = Skeleton.from_smpl_file(options.smpl, betas)
        else:
            table = Skeleton.default(options.height if options is not None else None)
            own = fields.floats("offsets", (24, 3)) if "offsets" in fields else table.offsets
            body = Skeleton(table.names, table.parents, own, betas)
        return replace(Motion.from_smpl(rate_hz, poses, trans, body), start_s=start_s)
    except FormatError:
        raise
    except PoserError as e:
        raise FormatError(path, f"reference: {e}") from e


def _json(value: dict[str, Any]) -> str:
    return json.dumps(value, default=_plain)


def _plain(value: Any) -> Any:
    """What JSON lacks: numpy arrays and numbers, paths."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value)


def _write(path: Path, arrays: dict[str, Any], reference: Motion | None) -> None:
    if reference is not None:
        arrays["poses"] = reference.poses
        arrays["trans"] = reference.trans
        arrays["betas"] = reference.skeleton.betas.astype(np.float64)
        if not np.array_equal(reference.skeleton.offsets, Skeleton.default().offsets):
            arrays["offsets"] = np.asarray(reference.skeleton.offsets)
    # Through an open file: numpy appends .npz to names that lack it.
    with write_aside(path) as aside, aside.open("wb") as f:
        np.savez_compressed(f, **arrays)


def _sniff(path: Path, head: bytes) -> bool:
    if not head.startswith(b"PK"):
        return False
    # A file cut short has lost its directory; the first member still names itself.
    return "schema" in _npz.names(path) or b"schema.npy" in head or is_motion(path)


def is_motion(path: Path) -> bool:
    """Whether a `.npz` is a motion that states its time, as poser writes those of a recording."""
    names = _npz.names(path)
    return "schema" not in names and {"poses", "mocap_framerate", "start_s"} <= names


def _read(path: Path, options: Options) -> Document:
    if is_motion(path):
        return _read_motion(path, options)
    schema = _npz.Fields(path, _npz.load(path, ("schema",))).text("schema")
    if schema == RAW:
        raw = read_raw(path, options)
        return Document("native", raw, _physics.assumed(raw), tuple(_physics.raw(path, raw)))
    if schema == RECORDING:
        recording = read_recording(path, options)
        return Document("native", recording, doubts=tuple(_physics.calibrated(path, recording)))
    raise FormatError(
        path, f"schema is {schema[:60]!r}; this version reads {RECORDING!r} and {RAW!r}"
    )


def _read_motion(path: Path, options: Options) -> Document:
    doc = amass.read(path, options)
    assert isinstance(doc.content, Motion)
    start = _npz.Fields(path, _npz.load(path, ("start_s",))).number("start_s")
    return replace(doc, content=replace(doc.content, start_s=start))


def _write_any(path: Path, content: Content) -> None:
    if isinstance(content, Recording):
        write_recording(path, content)
    elif isinstance(content, RawRecording):
        write_raw(path, content)
    else:
        write_motion(path, content)


FORMAT = Format(
    "native",
    (".npz",),
    _sniff,
    _checks.quiet(_read),
    _write_any,
    kinds=("motion", "recording", "raw"),
    about="this program's own recordings, and motions with what is known of them",
    sign="poser's recordings (field schema)",
)
