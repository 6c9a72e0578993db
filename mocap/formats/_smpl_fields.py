"""SMPL motions under the names and shapes of their tools: poses, path, rate and shape of a file's arrays.

Poses are axis-angle, one array or several side by side: AMASS (`poses`), its SMPL-X releases (`root_orient`,
`pose_body`, `pose_hand`), AIST++ (`smpl_poses`), and what estimators from video write (`global_orient`,
`body_pose`). The path is `trans`, `transl` or `smpl_trans`; AIST++ has it in units of `smpl_scaling`, and
divides. What is missing or was taken for granted is said.
"""

from __future__ import annotations

import numpy as np

from mocap.errors import FormatError, ShapeError
from mocap.findings import Finding, assumption
from mocap.formats import Options
from mocap.formats._npz import Fields
from mocap.formats._pickled import LARGEST_ANGLE
from mocap.motion import check_rate
from mocap.orientation import Array

# Arrays that side by side are a pose; of those in brackets the file may lack. The first that fits counts.
POSES: tuple[tuple[str, ...], ...] = (
    ("poses",), ("smpl_poses",), ("root_orient", "pose_body", "[pose_hand]"),
    ("global_orient", "body_pose"),
)  # fmt: skip
PATHS = ("trans", "smpl_trans", "transl")
RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", "framerate")
_SCALE = "smpl_scaling"
READ = (
    *(name.strip("[]") for names in POSES for name in names), *PATHS, *RATES, _SCALE, "betas",
)  # fmt: skip
# First columns of our joints 22 and 23 by the number of columns; None: the file has no hands. SMPL+H has
# 15 joints a hand, the first of which takes the place of SMPL's hand joint; SMPL-X has jaw and eyes before.
HANDS: dict[int, tuple[int, int] | None] = {
    66: None, 72: (66, 69), 156: (66, 111), 165: (75, 120)
}  # fmt: skip
FARTHEST = 1e5  # m: a translation beyond it is no person's
USUAL_RATES = "AIST++ runs at 60, video mostly at 25 or 30"


def layout(names: frozenset[str] | set[str]) -> tuple[str, ...] | None:
    """The arrays of the first layout of POSES that a file with these names has, or None."""
    for wanted in POSES:
        if all(n in names for n in wanted if not n.startswith("[")):
            return tuple(n.strip("[]") for n in wanted if n.strip("[]") in names)
    return None


def poses(fields: Fields) -> tuple[Array, list[Finding]]:
    """Axis-angle (T,72) rad as it stands in the file, and what was assumed."""
    found = layout(set(fields.arrays)) or ("poses",)
    parts = [_flat(fields, name) for name in found]
    lengths = {len(p) for p in parts}
    if len(lengths) > 1:
        said = " and ".join(f"{n} {len(p)}" for n, p in zip(found, parts, strict=True))
        raise FormatError(fields.path, f"frames of {said}, expected as many", f"field {found[0]!r}")
    full = np.concatenate(parts, axis=1)
    if full.shape[1] not in HANDS or not len(full):
        known = " or ".join(f"(T, {n})" for n in HANDS)
        shape = fields.get(found[0]).shape if len(found) == 1 else full.shape
        where = f"field {found[0]!r}" if len(found) == 1 else f"fields {', '.join(found)}"
        raise FormatError(fields.path, f"has shape {shape}, expected {known}", where)
    joined = found != ("poses",)
    assumed = [assumption("fields-joined", fields=", ".join(found))] if joined else []
    hands = HANDS[full.shape[1]]
    if hands is None:
        assumed.append(assumption("no-hands"))
        full = np.concatenate([full, np.zeros((len(full), 6))], axis=1)
        hands = (66, 69)
    left, right = hands
    out = np.concatenate(
        [full[:, :66], full[:, left : left + 3], full[:, right : right + 3]], axis=1
    )
    _bounded(fields, out, LARGEST_ANGLE, "radians", found[0])
    return out, assumed


def _flat(fields: Fields, name: str) -> Array:
    """An array (T,N) or (T,J,3) as (T,N); a single person's leading axis of one is dropped."""
    raw = fields.get(name)
    values = fields.floats(name, raw.shape)
    if values.ndim >= 3 and values.shape[0] == 1 and values.shape[1] > 1:
        values = values[0]
    if values.ndim == 3 and values.shape[2] == 3:
        values = values.reshape(len(values), -1)
    if values.ndim != 2:
        known = " or ".join(f"(T, {n})" for n in HANDS)
        raise FormatError(
            fields.path, f"has shape {raw.shape}, expected {known}", f"field {name!r}"
        )
    return values


def path_of(fields: Fields, frames: int) -> tuple[Array, list[Finding]]:
    """trans (T,3) m as it stands in the file, and what was assumed."""
    name = next((n for n in PATHS if n in fields), PATHS[0])
    raw = fields.get(name)
    trans = fields.floats(name, raw.shape)
    if trans.ndim == 3 and len(trans) == 1:
        trans = trans[0]
    if trans.shape != (frames, 3):
        raise FormatError(
            fields.path, f"has shape {raw.shape}, expected {(frames, 3)}", f"field {name!r}"
        )
    assumed = []
    if _SCALE in fields:
        scale = fields.number(_SCALE)
        if not scale > 0:
            raise FormatError(
                fields.path, f"is {scale:g}, expected above zero", f"field {_SCALE!r}"
            )
        trans = trans / scale
        assumed.append(assumption("trans-scaled", field=name, by=_SCALE, scale=scale))
    _bounded(fields, trans, FARTHEST, "metres", name)
    return trans, assumed


def _bounded(fields: Fields, values: Array, most: float, unit: str, name: str) -> None:
    bad = ~(np.abs(values) <= most)
    if bad.any():
        t, k = (int(i) for i in np.argwhere(bad)[0])
        where = f"frame {t}, field {name!r}"
        raise FormatError(fields.path, f"is {values[t, k]:.4g}, expected {unit}", where)


def rate(fields: Fields, options: Options) -> float:
    """Frames per s, of the options or the file. Raises FormatError where neither says it."""
    name = next((n for n in RATES if n in fields), None)
    try:
        if options.rate_hz is not None:
            return check_rate(options.rate_hz, "rate_hz")
        if name is not None:
            return check_rate(fields.number(name), f"field {name!r}")
    except ShapeError as e:
        raise FormatError(fields.path, str(e)) from e
    raise FormatError(
        fields.path,
        f"has no frame rate (field {RATES[0]!r} is missing): say it with --rate HZ; {USUAL_RATES}",
    )


def betas(fields: Fields) -> tuple[Array, list[Finding]]:
    """The body's shape (N,), and what was assumed: of one for each frame the mean counts."""
    if "betas" not in fields:
        return np.zeros(10), []
    found = fields.floats("betas", fields.get("betas").shape)
    found = found.reshape(-1, found.shape[-1]) if found.ndim > 1 else found.reshape(1, -1)
    if not found.size or found.shape[1] > 400 or not np.isfinite(found).all():
        raise FormatError(fields.path, "is no shape of finite numbers", "field 'betas'")
    same = bool((np.ptp(found, axis=0) < 1e-6).all())
    said = [] if same else [assumption("betas-change")]
    return found.mean(axis=0), said
