"""AMASS motion files: SMPL poses in a numpy archive, z up; also how this project stores motions.

Read under the names of other tools too, and from pickles (`_smpl_fields`).

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
from mocap.findings import Finding, assumption, doubt
from mocap.formats import (
    Content,
    Document,
    Format,
    Options,
    _checks,
    _npz,
    _pickled,
    _smpl_fields,
    _upright,
)
from mocap.formats._files import write_aside
from mocap.motion import Motion
from mocap.skeleton import JOINTS, PARENTS, Skeleton

_READ = (*_smpl_fields.READ, "height", "offsets")
_WRITTEN = ("poses", "trans", "betas", "gender", "mocap_framerate")
HANDS = (66, 111)  # first columns of our joints 22 and 23 in SMPL+H's, which are written
COLUMNS = 156
FASTEST = 15.0  # m/s: no runner is, even for a moment


def read_motion(path: str | Path, options: Options | None = None) -> Motion:
    """The motion of an AMASS file, in our y-up world; see `read`."""
    content = read(Path(path), options or Options()).content
    assert isinstance(content, Motion)
    return content


def read(path: Path, options: Options) -> Document:
    """The motion of an AMASS file: `poses` (T,66 | 72 | 156 | 165) rad, `trans` (T,3) m, a frame rate.

    The body is, in this order: the user's SMPL file with the file's `betas`; `options.height`; what this
    project's own writer left (`offsets` or `height`); the table. options.rate_hz overrides the rate,
    options.up the axis of the file's world that points up (z).
    Raises FormatError naming the field and frame that do not fit.
    """
    path = Path(path)
    fields = _fields(path)
    poses, said = _smpl_fields.poses(fields)
    trans, more = _smpl_fields.path_of(fields, len(poses))
    rate = _smpl_fields.rate(fields, options)
    skeleton, shape = _body(fields, options)
    said += more + shape
    R = ori.exp(poses.reshape(-1, 24, 3))
    U = _upright.world(options.up or "z")
    R[:, 0] = U @ R[:, 0]
    p = (skeleton.offsets[0] + trans) @ U.T
    try:
        motion = Motion(rate, R, p, skeleton)
    except ShapeError as e:
        raise FormatError(path, str(e)) from e
    return Document("amass", motion, tuple(said), tuple(_doubts(motion, options)))


def _body(fields: _npz.Fields, options: Options) -> tuple[Skeleton, list[Finding]]:
    betas, said = _smpl_fields.betas(fields)
    if options.smpl is not None:
        return Skeleton.from_smpl_file(options.smpl, betas), said
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
        return skeleton, said
    return skeleton, [*said, assumption("betas-unused")]


def _doubts(motion: Motion, options: Options) -> list[Finding]:
    """A body that never rises tells of another axis up, one that flies of another unit."""
    doubts = []
    step = np.linalg.norm(np.diff(motion.p_world_root, axis=0), axis=1)
    speed = float(np.median(step)) * motion.rate_hz if len(step) else 0.0
    if speed > FASTEST:
        doubts.append(doubt("pelvis-fast", speed_m_s=speed))
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
    for joint, column in zip((22, 23), HANDS, strict=True):
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


def _fields(path: Path) -> _npz.Fields:
    """The arrays of an archive, or of a pickled dictionary as AIST++ has them."""
    if path.suffix.lower() == ".npz":
        return _npz.Fields(path, _npz.load(path, _READ))
    found = _pickled.fields(path)
    return _npz.Fields(path, {k: _pickled.plain(path, found[k], k) for k in _READ if k in found})


def _sniff(path: Path, head: bytes) -> bool:
    if path.suffix.lower() != ".npz":
        # Data sets of sensors have poses beside them, under other names.
        return any(
            all(_pickled.mentions(path, n.encode()) for n in names if not n.startswith("["))
            for names in _smpl_fields.POSES[1:]
        )
    if not head.startswith(b"PK"):
        return False
    # A file cut short has lost its directory; the first member still names itself.
    known = ("poses", "trans", *_smpl_fields.RATES)
    first = any(f"{n}.npy".encode() in head for n in known)
    found = _npz.names(path)
    return _smpl_fields.layout(found) is not None or (first and not found)


def _write(path: Path, content: Content) -> None:
    if not isinstance(content, Motion):
        raise FormatError(path, "an AMASS file holds a motion, not a recording")
    write_motion(path, content)


FORMAT = Format(
    "amass",
    (".npz", ".pkl"),
    _sniff,
    _checks.quiet(read),
    _write,
    kinds=("motion",),
    about="SMPL motions: AMASS, AIST++, what video tools write",
    sign="AMASS motions (field poses)",
)
