"""AMASS motion files: SMPL poses in a numpy archive, z up; also how this project stores motions.

`trans` is SMPL's: the pelvis joint lies at J0 + trans, where J0, the rest pelvis of the file's body, does
not turn with the world. With A = `R_ZUP_YUP` (ours to AMASS's world):

    R_amass = A R_ours (the root alone),      trans_amass = A p_world_root - J0

and reading inverts it. Taking `trans` for a point would move the body by |A^T J0 - J0| = 0.32 m.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError, PoserError, ShapeError
from mocap.formats import Content, Document, Format, Options, _checks, _npz, _upright
from mocap.formats._files import write_aside
from mocap.formats._pickled import LARGEST_ANGLE
from mocap.motion import Motion, check_rate
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS, Skeleton

RATES = ("mocap_framerate", "mocap_frame_rate")  # the second in the SMPL-X releases
_READ = ("poses", "trans", "betas", "height", "offsets", *RATES)
_WRITTEN = ("poses", "trans", "betas", "gender", "mocap_framerate")
# First columns of our joints 22 and 23 by the number of columns. SMPL+H has 15 joints a hand, the first
# of which takes the place of SMPL's hand joint; SMPL-X has jaw and eyes before them.
HANDS = {72: (66, 69), 156: (66, 111), 165: (75, 120)}
COLUMNS = 156
FASTEST = 15.0  # m/s: no runner is, even for a moment
FARTHEST = 1e5  # m: a translation beyond it is no person's


def read_motion(path: str | Path, options: Options | None = None) -> Motion:
    """The motion of an AMASS file, in our y-up world; see `read`."""
    content = read(Path(path), options or Options()).content
    assert isinstance(content, Motion)
    return content


def read(path: Path, options: Options) -> Document:
    """The motion of an AMASS file: `poses` (T,72 | 156 | 165) rad, `trans` (T,3) m, a frame rate.

    The body is, in this order: the user's SMPL file with the file's `betas`; `options.height`; what this
    project's own writer left (`offsets` or `height`); the table. options.rate_hz overrides the rate,
    options.up the axis of the file's world that points up (z).
    Raises FormatError naming the field and frame that do not fit.
    """
    path = Path(path)
    fields = _npz.Fields(path, _npz.load(path, _READ))
    poses, trans = _poses(fields)
    rate = _rate(fields, options)
    skeleton, said = _body(fields, options)
    R = ori.exp(poses.reshape(-1, 24, 3))
    U = _upright.world(options.up or "z")
    R[:, 0] = U @ R[:, 0]
    p = (skeleton.offsets[0] + trans) @ U.T
    try:
        motion = Motion(rate, R, p, skeleton)
    except ShapeError as e:
        raise FormatError(path, str(e)) from e
    return Document("amass", motion, tuple(said), tuple(_doubts(motion, options)))


def _poses(fields: _npz.Fields) -> tuple[Array, Array]:
    """Axis-angle (T,72) rad and trans (T,3) m as they stand in the file."""
    path, raw = fields.path, fields.get("poses")
    if raw.ndim != 2 or raw.shape[1] not in HANDS or len(raw) == 0:
        known = " or ".join(f"(T, {n})" for n in HANDS)
        raise FormatError(path, f"has shape {raw.shape}, expected {known}", "field 'poses'")
    full = fields.floats("poses", raw.shape)
    left, right = HANDS[raw.shape[1]]
    poses = np.concatenate(
        [full[:, :66], full[:, left : left + 3], full[:, right : right + 3]], axis=1
    )
    trans = fields.floats("trans", (len(poses), 3))
    for name, values, most, unit in (
        ("poses", poses, LARGEST_ANGLE, "radians"),
        ("trans", trans, FARTHEST, "metres"),
    ):
        bad = ~(np.abs(values) <= most)
        if bad.any():
            t, k = (int(i) for i in np.argwhere(bad)[0])
            raise FormatError(
                path, f"is {values[t, k]:.4g}, expected {unit}", f"frame {t}, field {name!r}"
            )
    return poses, trans


def _rate(fields: _npz.Fields, options: Options) -> float:
    name = next((n for n in RATES if n in fields), None)
    if options.rate_hz is None and name is None:
        raise FormatError(fields.path, f"has no frame rate: field {RATES[0]!r} is missing")
    try:
        if options.rate_hz is not None:
            return check_rate(options.rate_hz, "rate_hz")
        return check_rate(fields.number(str(name)), f"field {name!r}")
    except ShapeError as e:
        raise FormatError(fields.path, str(e)) from e


def _body(fields: _npz.Fields, options: Options) -> tuple[Skeleton, list[str]]:
    betas = np.zeros(10)
    if "betas" in fields:
        betas = fields.floats("betas", fields.get("betas").shape).reshape(-1)
        if len(betas) > 400 or not np.isfinite(betas).all():
            raise FormatError(fields.path, "is no shape of finite numbers", "field 'betas'")
    if options.smpl is not None:
        return Skeleton.from_smpl_file(options.smpl, betas), []
    try:
        table = Skeleton.default(options.height)
        own = table.offsets
        if options.height is None and "offsets" in fields:
            own = fields.floats("offsets", (24, 3))
        elif options.height is None and "height" in fields:
            own = Skeleton.default(fields.number("height")).offsets
        skeleton = Skeleton(JOINTS, PARENTS, own, betas)
    except FormatError:
        raise
    except PoserError as e:
        raise FormatError(fields.path, str(e)) from e
    if not betas.any() or "offsets" in fields or "height" in fields:
        return skeleton, []
    return skeleton, ["the file's betas need an SMPL model; the neutral mean shape is used"]


def _doubts(motion: Motion, options: Options) -> list[str]:
    """A body that never rises tells of another axis up, one that flies of another unit."""
    doubts = []
    step = np.linalg.norm(np.diff(motion.p_world_root, axis=0), axis=1)
    speed = float(np.median(step)) * motion.rate_hz if len(step) else 0.0
    if speed > FASTEST:
        doubts.append(f"the pelvis moves at {speed:.0f} m/s (median): trans may not be in metres")
    return doubts + _upright.doubts(motion, options.up)


def write_motion(
    path: str | Path, motion: Motion, extra: Mapping[str, np.ndarray] | None = None
) -> None:
    """Write a motion as an AMASS file, all numbers float64, in AMASS's z-up world.

    `poses` (T,156) rad: body 0:66; our hand joints 22 and 23 in 66:69 and 111:114 (SMPL+H's first joint
    of each hand), all other hand columns zero. `trans` (T,3) m, `betas`, `gender` "neutral",
    `mocap_framerate` Hz. A body other than the table's is kept as `height` (m, a scaled table) or
    `offsets` (24,3) m; other readers of AMASS ignore both. extra: more arrays, as they are.

    The file appears whole or not at all. Raises ShapeError for another joint tree, for an extra that
    would replace a field of the format, and for one that would need a pickle; OSError where the file
    cannot be written.
    """
    if motion.skeleton.names != JOINTS:
        raise ShapeError("AMASS files hold the 24-joint body only")
    arrays = _arrays(motion)
    for name, value in (extra or {}).items():
        if name in _WRITTEN or np.asarray(value).dtype.hasobject:
            raise ShapeError(f"the extra array {name!r} cannot be stored in an AMASS file")
        arrays[name] = np.asarray(value)
    # A long motion that stands still packs so well that the reader would take it for a bomb.
    save = np.savez_compressed if arrays["poses"].nbytes < _npz.BOMB_BYTES else np.savez
    # Through an open file: numpy appends .npz to names that lack it.
    with write_aside(path) as aside, aside.open("wb") as f:
        save(f, **arrays)  # type: ignore[arg-type]


def _arrays(motion: Motion) -> dict[str, np.ndarray]:
    R = np.array(motion.R_parent_joint)
    R[:, 0] = ori.R_ZUP_YUP @ R[:, 0]
    ours = ori.log(R)
    poses = np.zeros((len(motion), COLUMNS))
    poses[:, :66] = ours[:, :22].reshape(len(motion), 66)
    for joint, column in zip((22, 23), HANDS[COLUMNS], strict=True):
        poses[:, column : column + 3] = ours[:, joint]
    body = motion.skeleton
    arrays = {
        "poses": poses,
        "trans": motion.p_world_root @ ori.R_ZUP_YUP.T - body.offsets[0],
        "betas": body.betas.astype(np.float64),
        "gender": np.array("neutral"),
        "mocap_framerate": np.array(motion.rate_hz),
    }
    return arrays | _own_body(body)


def _own_body(body: Skeleton) -> dict[str, np.ndarray]:
    """A body's bones, so that reading needs no SMPL file; nothing for the table's."""
    if np.array_equal(body.offsets, Skeleton.default().offsets):
        return {}
    try:
        scaled = Skeleton.default(body.stature).offsets
    except ShapeError:
        return {"offsets": np.array(body.offsets)}
    if np.abs(scaled - body.offsets).max() < 1e-12:
        return {"height": np.array(body.stature)}
    return {"offsets": np.array(body.offsets)}


def _sniff(path: Path, head: bytes) -> bool:
    if not head.startswith(b"PK"):
        return False
    # A file cut short has lost its directory; the first member still names itself.
    first = any(f"{n}.npy".encode() in head for n in ("poses", "trans", *RATES))
    found = _npz.names(path)
    return "poses" in found or (first and not found)


def _write(path: Path, content: Content) -> None:
    if not isinstance(content, Motion):
        raise FormatError(path, "an AMASS file holds a motion, not a recording")
    write_motion(path, content)


FORMAT = Format("amass", (".npz",), _sniff, _checks.quiet(read), _write)
