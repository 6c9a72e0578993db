"""How far a predicted motion is from a reference, under the field's names and in named units.

The field's evaluator (TransPose, PIP, PNP share it) masks the root's orientation, wrists, hands,
ankles and feet before it measures; the figures beside it (`root_deg`, `global_deg`,
`world_position_cm`) mask nothing. Both motions are put on the table's unscaled skeleton and the
prediction is resampled on the manifold to the reference's rate. Frames at which the reference is not trusted
count nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap import checked
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton

Mask = NDArray[np.bool_]
MASKED: tuple[int, ...] = (0, 7, 8, 10, 11, 20, 21, 22, 23)
"""Joints whose local rotation the field's evaluator sets to the identity."""
SIP_JOINTS: tuple[int, ...] = (1, 2, 16, 17)
DIP_JOINTS: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19)
HORIZONS_S: tuple[int, ...] = (1, 2, 5)
STILL_M = 1e-6  # a pelvis path that spans less than this is taken for a path that nobody measured


@dataclass(frozen=True, eq=False)
class Metrics:
    """One comparison. Each figure is None where it is undefined; `metrics.md` of the design has the
    names.

    sip_deg, angular_deg: mean geodesic angle of global rotations over hips and shoulders, over all
    24 joints, both masked. local_angular_deg: local angles of DIP's 15 joints. position_cm: joint
    distance, roots aligned, masked; mesh_cm: the same over the SMPL mesh. jitter, jitter_reference:
    mean third difference, 100 m/s^3, masked, root fixed. root_deg, global_deg, instrumented_deg:
    nothing masked. left_out_deg: angle to what unseen sensors measured. world_position_cm: pelvis
    positions aligned, rotations untouched. translation_m: {"1","2","5"} s, m. translation_m_per_m:
    after one metre travelled. inside_1_sigma, inside_2_sigma: shares of the errors of DIP's 15
    joints, axis by axis, that lie inside one and two of the deviations that the prediction states (normal
    errors that are stated rightly: 0.683 and 0.954).

    frames: those that count. Kept for the report, not part of the JSON: angle_deg (T,24) global and
    unmasked, masked_angle_deg (T,24), distance_cm (T,24) masked, NaN at frames that do not count;
    untrusted_frames: how many these are.
    """

    frames: int
    rate_hz: float | None
    sip_deg: float | None = None
    angular_deg: float | None = None
    local_angular_deg: float | None = None
    position_cm: float | None = None
    mesh_cm: float | None = None
    jitter: float | None = None
    jitter_reference: float | None = None
    root_deg: float | None = None
    global_deg: float | None = None
    instrumented_deg: float | None = None
    left_out_deg: float | None = None
    world_position_cm: float | None = None
    translation_m: dict[str, float | None] | None = None
    translation_m_per_m: float | None = None
    inside_1_sigma: float | None = None
    inside_2_sigma: float | None = None
    angle_deg: Array | None = None
    masked_angle_deg: Array | None = None
    distance_cm: Array | None = None
    untrusted_frames: int = 0

    def to_json(self) -> dict[str, Any]:
        """The figures under their JSON names; arrays are left out."""
        stated = {name: getattr(self, name) for name in SHARES}
        return {name: getattr(self, name) for name in JSON_NAMES} | {
            name: share for name, share in stated.items() if share is not None
        }

    @property
    def frame_sip_deg(self) -> Array | None:
        """(T,) deg: `sip_deg` of each frame."""
        a = self.masked_angle_deg
        return None if a is None else a[:, list(SIP_JOINTS)].mean(axis=1)

    @property
    def frame_position_cm(self) -> Array | None:
        """(T,) cm: `position_cm` of each frame."""
        return None if self.distance_cm is None else self.distance_cm.mean(axis=1)

    @property
    def joint_deg(self) -> Array | None:
        """(24,) deg: mean global angle of each joint, nothing masked."""
        return None if self.angle_deg is None else np.nanmean(self.angle_deg, axis=0)

    @property
    def joint_cm(self) -> Array | None:
        """(24,) cm: mean distance of each joint, masked, roots aligned."""
        return None if self.distance_cm is None else np.nanmean(self.distance_cm, axis=0)


SHARES = ("inside_1_sigma", "inside_2_sigma")
"""JSON names of what only motions with deviations have."""
_KEPT = ("angle_deg", "masked_angle_deg", "distance_cm", "untrusted_frames")
JSON_NAMES: tuple[str, ...] = tuple(
    f.name for f in fields(Metrics) if f.name not in (*_KEPT, *SHARES)
)


def _check_start(prediction: Motion, other: Motion | Recording, what: str) -> None:
    """Raises PoserError for motions of different times: frames would be compared that are not of one moment.

    A start of 0 may mean that nobody has said when: then the frames are taken as they are.
    """
    a, b = prediction.start_s, other.start_s
    if a and b and abs(a - b) > (1 + 1e-6) / min(prediction.rate_hz, other.rate_hz):
        raise PoserError(
            f"evaluate: the prediction starts at {a:g} s, the {what} at {b:g} s; cut both to one time "
            f"(mocap.timeline)"
        )


def evaluate(
    prediction: Motion,
    reference: Motion | None,
    *,
    recording: Recording | None = None,
    seen: tuple[str, ...] | None = None,
    smpl: Skeleton | None = None,
    trusted: Mask | None = None,
    std_rad: Array | None = None,
) -> Metrics:
    """Compare `prediction` with `reference`.

    recording: what all sensors measured, over the same time, for `left_out_deg`. seen: the sensors
    that the method saw (default: all of `recording`), for `instrumented_deg` and `left_out_deg`.
    smpl: a body with a mesh, for `mesh_cm`. trusted (T,): the frames of the reference that count (default:
    its own `trusted`); a step of jitter or translation that touches another one does not count either.
    std_rad (T,24,3): the deviations that the prediction states of its joints' rotation vectors.
    Without a reference only `left_out_deg` and `jitter` are defined.

    Raises PoserError where the lengths differ by more than one period of the slower motion, where no frame
    counts, and where neither reference nor recording is given.
    """
    checked.instance(prediction, Motion, "evaluate: prediction", PoserError)
    if reference is not None:
        checked.instance(reference, Motion, "evaluate: reference", PoserError)
        _check_start(prediction, reference, "reference")
    if recording is not None:
        checked.instance(recording, Recording, "evaluate: recording", PoserError)
        _check_start(prediction, recording, "recording")
    if seen is not None:
        seen = checked.names(seen, "evaluate: seen", PoserError)
    left_out = None
    if recording is not None and seen is not None:
        left_out = left_out_deg(prediction, recording, seen)
    if reference is None:
        if recording is None:
            raise PoserError(
                "evaluate: needs a reference motion, or a recording with sensors left out"
            )
        p = _aligned(prediction, recording.rate_hz, len(recording), "the recording")
        return Metrics(len(p), p.rate_hz, jitter=_jitter(_Body.of(p)), left_out_deg=left_out)
    p = _aligned(prediction, reference.rate_hz, len(reference), "the reference")
    r = reference.on(Skeleton.default()).slice(0, len(p))
    counts = _counts(reference, trusted)[: len(p)]
    P, R = _Body.of(p), _Body.of(r)
    angle = np.rad2deg(ori.angle_between(p.R_world_joint, r.R_world_joint))
    masked = np.rad2deg(ori.angle_between(P.R, R.R))
    local = np.rad2deg(ori.angle_between(p.R_parent_joint, r.R_parent_joint)[:, list(DIP_JOINTS)])
    distance = 100 * np.linalg.norm(P.p - R.p, axis=-1)
    world = np.linalg.norm(_from_root(p) - _from_root(r), axis=-1)
    for each in (angle, masked, local, distance, world):
        each[~counts] = np.nan
    joints = _instrumented(recording, seen)
    translation, per_metre = _translation(p, r, counts)
    return Metrics(
        frames=int(counts.sum()),
        rate_hz=r.rate_hz,
        sip_deg=float(np.nanmean(masked[:, list(SIP_JOINTS)])),
        angular_deg=float(np.nanmean(masked)),
        local_angular_deg=float(np.nanmean(local)),
        position_cm=float(np.nanmean(distance)),
        mesh_cm=_mesh_cm(p, r, smpl, counts),
        jitter=_jitter(P, counts),
        jitter_reference=_jitter(R, counts),
        root_deg=float(np.nanmean(angle[:, 0])),
        global_deg=float(np.nanmean(angle)),
        instrumented_deg=float(np.nanmean(angle[:, joints])) if joints else None,
        left_out_deg=left_out,
        world_position_cm=float(100 * np.nanmean(world)),
        translation_m=translation,
        translation_m_per_m=per_metre,
        **_inside(prediction, std_rad, p, r, counts),
        angle_deg=angle,
        masked_angle_deg=masked,
        distance_cm=distance,
        untrusted_frames=int((~counts).sum()),
    )


def _inside(
    prediction: Motion, std_rad: Array | None, p: Motion, r: Motion, counts: Mask
) -> dict[str, float]:
    """Shares of errors inside one and two stated deviations; p, r: both motions, aligned.

    An error is that of the rotation vector theta: J_r^-1(theta) Log(R_p^T R_r) per joint.
    """
    if std_rad is None:
        return {}
    if np.shape(std_rad) != (len(prediction), 24, 3):
        raise PoserError(
            f"evaluate: std_rad must be ({len(prediction)},24,3), got {np.shape(std_rad)}"
        )
    joints = list(DIP_JOINTS)
    at = np.arange(len(p)) * prediction.rate_hz / p.rate_hz
    stated = std_rad[np.clip(np.round(at).astype(int), 0, len(prediction) - 1)][:, joints]
    R_p, R_r = (m.R_parent_joint[:, joints] for m in (p, r))
    turned = ori.log(np.swapaxes(R_p, -1, -2) @ R_r)
    error = np.abs((ori.right_jacobian_inv(ori.log(R_p)) @ turned[..., None])[..., 0])[counts]
    return {f"inside_{k}_sigma": float((error <= k * stated[counts]).mean()) for k in (1, 2)}


def _counts(reference: Motion, trusted: Mask | None) -> Mask:
    """(T,): the frames of the reference that count."""
    own = reference.trusted
    if trusted is not None:
        own = checked.truths(trusted, (len(reference),), "evaluate: trusted", PoserError)
    if own is None:
        return np.ones(len(reference), bool)
    if not own.any():
        raise PoserError("evaluate: no frame of the reference is trusted")
    return own


def left_out_deg(prediction: Motion, recording: Recording, seen: tuple[str, ...]) -> float | None:
    """Mean angle in deg between the predicted orientation of bones that carry no sensor in `seen`
    and what the other sensors of `recording` measured on them; no solver in between. None without
    any.
    """
    seen_joints = {
        int(recording.joint[recording.sensors.index(n)]) for n in _known(recording, seen)
    }
    out: list[int] = [
        s
        for s, name in enumerate(recording.sensors)
        if name not in seen and int(recording.joint[s]) not in seen_joints
    ]
    p = _aligned(prediction, recording.rate_hz, len(recording), "the recording")
    T = len(p)
    valid = recording.ori_valid[:T, out]
    if not valid.any():
        return None
    measured = recording.R_world_bone[:T, out][valid]
    estimated = p.R_world_joint[:, recording.joint[out]][valid]
    return float(np.rad2deg(ori.angle_between(estimated, measured).mean()))


def mean_over(metrics: Sequence[Metrics]) -> Metrics:
    """Mean over sequences of per-sequence means, each sequence counting once whatever its length.

    A figure is the mean over the sequences that have it, None where none has. frames is the sum;
    rate_hz is None where the sequences differ. The arrays are dropped.
    """
    if not metrics:
        raise PoserError("mean_over: no sequence to average")
    rates = {m.rate_hz for m in metrics}
    values: dict[str, Any] = {
        "frames": sum(m.frames for m in metrics),
        "rate_hz": rates.pop() if len(rates) == 1 else None,
    }
    for name in (*JSON_NAMES, *SHARES):
        if name not in (*values, "translation_m"):
            values[name] = _mean([getattr(m, name) for m in metrics])
    known = [m.translation_m for m in metrics if m.translation_m is not None]
    if known:
        keys = [str(s) for s in HORIZONS_S]
        values["translation_m"] = {k: _mean([t.get(k) for t in known]) for k in keys}
    return Metrics(**values)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def _aligned(motion: Motion, rate_hz: float, frames: int, what: str) -> Motion:
    """`motion` on the table's skeleton, at `rate_hz`, at most `frames` long."""
    slower = min(motion.rate_hz, rate_hz)
    if abs(motion.seconds - frames / rate_hz) > (1 + 1e-6) / slower:
        raise PoserError(
            f"the prediction lasts {motion.seconds:.3f} s ({len(motion)} frames), {what} "
            f"{frames / rate_hz:.3f} s ({frames} frames): they may differ by one frame at most"
        )
    motion = motion.on(Skeleton.default()).resampled(rate_hz)
    return motion.slice(0, min(len(motion), frames))


@dataclass(frozen=True, eq=False)
class _Body:
    """The masked body: global rotations R (T,24,3,3) and joints p (T,24,3) m, root fixed at the
    origin.
    """

    R: Array
    p: Array
    rate_hz: float

    @classmethod
    def of(cls, motion: Motion) -> _Body:
        local = np.array(motion.R_parent_joint)
        local[:, list(MASKED)] = np.eye(3)
        R, p = motion.skeleton.forward(local, np.zeros((len(motion), 3)))
        return cls(R, p, motion.rate_hz)


def _from_root(motion: Motion) -> Array:
    p = motion.p_world_joint
    return p - p[:, :1]


def _jitter(body: _Body, counts: Mask | None = None) -> float | None:
    """mean |p_{t+3} - 3 p_{t+2} + 3 p_{t+1} - p_t| rate^3 over frames and joints, in 100 m/s^3."""
    if len(body.p) < 4:
        return None
    jerk = np.diff(body.p, n=3, axis=0) * body.rate_hz**3
    if counts is not None:
        jerk = jerk[_whole(counts, 3)]
    return float(np.linalg.norm(jerk, axis=-1).mean() / 100) if len(jerk) else None


def _whole(counts: Mask, n: int) -> Mask:
    """(T-n,): whether frames t to t+n all count."""
    wrong = np.r_[0, np.cumsum(~counts)]
    return np.asarray(wrong[n + 1 :] == wrong[: -n - 1])


def _instrumented(recording: Recording | None, seen: tuple[str, ...] | None) -> list[int]:
    """Joints that carry a sensor, each once."""
    if recording is None:
        return sorted({places.lookup(n).joint for n in seen or ()})
    names = recording.sensors if seen is None else _known(recording, seen)
    return sorted({int(recording.joint[recording.sensors.index(n)]) for n in names})


def _known(recording: Recording, seen: tuple[str, ...]) -> tuple[str, ...]:
    missing = [n for n in seen if n not in recording.sensors]
    if missing:
        raise PoserError(
            f"sensor {', '.join(missing)} not in the recording; "
            f"it has: {', '.join(recording.sensors)}"
        )
    return seen


def _unmeasured(motion: Motion) -> bool:
    """The body moves and the pelvis does not by a micrometre: no translation was measured."""
    moves = np.ptp(motion.R_parent_joint, axis=0).max() > 1e-6
    return bool(moves and np.ptp(motion.p_world_root, axis=0).max() < STILL_M)


def _translation(
    p: Motion, r: Motion, counts: Mask
) -> tuple[dict[str, float | None] | None, float | None]:
    """Mean |dp_pred - dp_ref| over all starts after 1, 2, 5 s, and per metre that the reference
    travels.

    Per metre: from each start to the first frame at which the reference's pelvis has travelled a
    metre along its path, the error divided by the path.
    """
    if _unmeasured(p) or _unmeasured(r):
        return None, None
    error = p.p_world_root - r.p_world_root
    after: dict[str, float | None] = {}
    for seconds in HORIZONS_S:
        n = round(seconds * r.rate_hz)
        drift = np.linalg.norm(error[n:] - error[:-n], axis=-1)[
            _whole(counts, n)[: max(0, len(error) - n)]
        ]
        after[str(seconds)] = float(drift.mean()) if len(drift) else None
    path = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(r.p_world_root, axis=0), axis=-1))]
    end = np.searchsorted(path, path + 1.0 - 1e-9)
    wrong = np.r_[0, np.cumsum(~counts)]
    inside = np.minimum(end, len(path) - 1)
    start = np.flatnonzero((end < len(path)) & (wrong[inside + 1] == wrong[:-1]))
    if not len(start):
        return after, None
    end = end[start]
    drift = np.linalg.norm(error[end] - error[start], axis=-1)
    return after, float((drift / (path[end] - path[start])).mean())


def _mesh_cm(p: Motion, r: Motion, smpl: Skeleton | None, counts: Mask) -> float | None:
    """Mean distance in cm over the mesh's vertices, masked, roots aligned, on the body of
    `smpl`.
    """
    if smpl is None or smpl.mesh is None:
        return None
    total, chunk = 0.0, 256  # 6890 vertices a frame: 256 frames of both take about 85 MB
    for start in range(0, len(p), chunk):
        vertices = []
        for motion in (p, r):
            local = np.array(motion.R_parent_joint[start : start + chunk])
            local[:, list(MASKED)] = np.eye(3)
            masked = Motion(motion.rate_hz, local, np.zeros((len(local), 3)), smpl)
            vertices.append(smpl.mesh.vertices(masked))
        gap = np.linalg.norm(vertices[0] - vertices[1], axis=-1).mean(axis=-1)
        total += float(gap[counts[start : start + chunk]].sum())
    return 100 * total / int(counts.sum())
