"""The full-body example of qmt: a MATLAB file with raw IMU data and segment orientations.

`t` s; per segment `acc` m/s^2 and `gyr` rad/s in the sensor's frame, and `quat` (wxyz), the segment's
orientation in a z-up world. The constant rotation between sensor and segment is not in the file; it is
fitted here: quat turns by Exp(R_segment_sensor gyr / rate) from one sample to the next, and
R_world_segment R_segment_sensor turns gravity upright.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.calibration import measures as unit_checks
from mocap.calibration.static_pose import find_static
from mocap.errors import CalibrationError, FormatError
from mocap.findings import Finding, assumption, distinct, doubt
from mocap.formats import (
    Document,
    Format,
    Options,
    _checks,
    _clock,
    _mat5,
    _opensim,
    _physics,
    check_mapped,
)
from mocap.orientation import Array
from mocap.recording import RawRecording

PLACES: dict[str, str] = {
    "hip": "pelvis",
    "lower_back": "lower_back",
    "upper_back": "upper_back",
    "head": "head",
    **{
        f"{theirs}_{side}": f"{side}_{ours}"
        for theirs, ours in (
            ("upper_leg", "thigh"), ("lower_leg", "shank"), ("foot", "foot"),
            ("upper_arm", "upper_arm"), ("forearm", "forearm"), ("hand", "hand"),
        )
        for side in ("left", "right")
    },
}  # fmt: skip
"""Segment names of the file and the places of the table."""

MAX_SAMPLES = 10_000_000  # a day at 100 Hz
SETTLING = 0.25  # rad/s between quat and gyr, above which the file's filter has not settled
_ISB = ("pelvis", "lower_back", "upper_back", "thigh", "shank")
LEAST_TILT = 0.01  # rad: accelerometers are not levelled better
DOUBT = 0.15  # relative residual of the fit that is worth a warning


def fit_mounting(
    R_world_segment: Array, gyr: Array, acc: Array, rate_hz: float
) -> tuple[Array, float]:
    """R_segment_sensor (3,3) and its residual, from R_world_segment (T,3,3), gyr and acc (T,3).

    Minimises sum |w_k - Q gyr_k - b|^2 with w_k = Log(R_{k-1}^T R_k) rate over Q in SO(3) and the
    constant b (Wahba's problem, by SVD), with frames that fit badly weighted down (Huber). Then still
    frames add |R^T e_y - Q acc/|acc||^2, each part weighted by the inverse square of its own relative
    residual. The residual returned is the root mean square of w - Q gyr - b over that of w, each frame
    cut at Huber's bound. NaN where fewer than two frames have both.
    """
    w = ori.log(np.swapaxes(R_world_segment[:-1], -1, -2) @ R_world_segment[1:]) * rate_hz
    g = gyr[1:]
    ok = np.isfinite(w).all(-1) & np.isfinite(g).all(-1)
    w, g = w[ok], g[ok]
    if len(w) < 2:
        return np.full((3, 3), np.nan), np.nan
    Q, residual = _wahba(w, g, np.zeros((3, 3)))
    up, down = _gravity_pairs(R_world_segment, acc, rate_hz)
    if not len(up):
        return Q, residual
    tilt = float(np.sqrt(((up - down @ Q.T) ** 2).sum(-1).mean()))
    weight = (residual / max(tilt, LEAST_TILT)) ** 2
    return _wahba(w, g, weight * up.T @ down / len(up))


def _wahba(w: Array, g: Array, more: Array) -> tuple[Array, float]:
    """Q in SO(3) with w = Q g + b, robustly, and its relative residual; `more` is added to the
    correlation matrix, which has about unit trace."""
    weight = np.ones(len(w))
    for _ in range(10):
        wc = w - np.average(w, axis=0, weights=weight)
        gc = g - np.average(g, axis=0, weights=weight)
        H = (wc * weight[:, None]).T @ gc / max((weight * (wc**2).sum(-1)).sum(), 1e-12)
        Q = ori.project(H + more)
        off = np.linalg.norm(wc - gc @ Q.T, axis=1)
        bound = 3 * 1.48 * float(np.median(off)) + 1e-6
        weight = np.minimum(1.0, bound / np.maximum(off, 1e-12))
    off = np.minimum(off, bound)
    return Q, float(np.sqrt((off**2).sum() / max((w**2).sum(), 1e-12)))


def _gravity_pairs(R: Array, acc: Array, rate_hz: float) -> tuple[Array, Array]:
    """World up in the segment's and in the sensor's frame, (N,3) each, at frames where acc is still."""
    n = max(1, round(0.5 * rate_hz))
    if len(acc) < 4 * n:
        return np.empty((0, 3)), np.empty((0, 3))
    smooth = unit_checks.smoothed(acc, n)
    size = np.linalg.norm(smooth, axis=1)
    wobble = unit_checks.smoothed(np.abs(acc - smooth), n).max(axis=1)
    with np.errstate(invalid="ignore"):
        still = (np.abs(size - ori.GRAVITY) < 0.5) & (wobble < 0.3)
    still[: 2 * n] = still[-2 * n :] = False  # the moving average has no full window there
    still &= np.isfinite(R[:, 1]).all(-1)
    return R[still, 1, :], smooth[still] / size[still, None]


def _settled(R_world_sensor: Array, gyr: Array, rate_hz: float) -> int:
    """First frame from which the orientation follows gyr: the start, unless a filter was settling."""
    n = min(len(gyr), round(2 * rate_hz))
    w = ori.log(np.swapaxes(R_world_sensor[: n - 1], -1, -2) @ R_world_sensor[1:n]) * rate_hz
    off = np.linalg.norm(w - gyr[1:n], axis=-1)
    follows = np.flatnonzero(~(off > SETTLING))
    return int(follows[0]) if len(follows) and follows[0] > 0 else 0


def _facing(rec: RawRecording, R_world_segment: Array) -> tuple[float | None, list[Finding]]:
    """Heading (rad) of the wearer's forward in the static pose, and what was assumed for it.

    Trunk and leg segments have ISB axes, x forward, y up, in the N-pose; None where they do not agree.
    """
    axes = [s for s, name in enumerate(rec.sensors) if name.endswith(_ISB)]
    try:
        window = find_static(rec)
    except CalibrationError:
        return None, []
    R = R_world_segment[window.start : window.stop, axes]
    if not R.size or not np.isfinite(R).all():
        return None, []
    x = R[..., 0].mean(axis=0)
    mean = x.mean(axis=0)
    if min(np.hypot(mean[0], mean[2]), float(R[..., 1, 1].mean())) < 0.85:
        return None, []
    heading = float(np.arctan2(mean[0], mean[2]))
    a, b = window.seconds(rec)
    deg = float(np.rad2deg(heading))
    return heading, [assumption("facing-in-pose", facing_deg=deg, start_s=a, end_s=b)]


def _field(
    path: Path, fields: dict[str, _mat5.Field], segment: str, name: str, shape: tuple[int, int]
) -> Array:
    where = f"segment {segment}: {name}"
    if name not in fields:
        raise FormatError(path, "missing", where)
    value = fields[name]
    if isinstance(value, str):
        raise FormatError(path, f"is {value}, expected real {shape}", where)
    if value.shape != shape:
        raise FormatError(path, f"is {value.dtype} {value.shape}, expected real {shape}", where)
    return value.astype(float)


def _time(path: Path, value: _mat5.Variable) -> Array:
    """The time stamps (T,) in s."""
    if not isinstance(value, np.ndarray):
        what = "a struct" if isinstance(value, dict) else value
        raise FormatError(path, f"is {what}, expected (T,) seconds", "variable t")
    t = np.atleast_1d(value)
    if t.ndim != 1:
        raise FormatError(path, f"is {t.dtype} {t.shape}, expected (T,) seconds", "variable t")
    if len(t) > MAX_SAMPLES:
        raise FormatError(path, f"holds more than {MAX_SAMPLES} samples", "variable t")
    return t.astype(float)


def _read(path: Path, options: Options) -> Document:
    names = {**PLACES, **_opensim.given(options)}
    data = _mat5.read(path, {"t", *names})
    found = {n: v for n in names if isinstance(v := data.get(n), dict)}
    if "t" not in data or not found:
        raise FormatError(path, f"no variable t and no segment among {', '.join(PLACES)}")
    segments = list(found)
    check_mapped(path, options.mapping, segments)
    t = _time(path, data["t"])
    clock = _clock.grid(path, t, "variable t")
    rate, frames, doubts = clock.rate_hz, clock.frames, list(clock.doubts)
    if len(frames) != frames[-1] + 1:
        raise FormatError(path, "has gaps, expected a constant rate", "variable t")
    sensors = tuple(names[n] for n in segments)
    shapes = (("acc", 3), ("gyr", 3), ("quat", 4))
    acc, gyr, quat = (
        np.stack([_field(path, found[n], n, f, (len(t), k)) for n in segments], axis=1)
        for f, k in shapes
    )
    acc_unit, gyr_unit = _physics.factors(options)
    acc, gyr = acc * acc_unit, gyr * gyr_unit
    R_segment, zeros = _checks.quaternions(path, quat, sensors, "quat")
    if zeros:
        doubts.append(doubt("zero-quaternions", count=zeros))
    R_segment = ori.R_YUP_ZUP @ R_segment
    R, fitted = _mount(R_segment, gyr, acc, rate, sensors)
    doubts += [doubt("mounting-unsure", n, residual=e) for n, e in fitted.items() if e > DOUBT]
    settled = [_settled(R[:, s], gyr[:, s], rate) for s in range(len(sensors))]
    valid = np.arange(len(t))[:, None] >= np.array(settled)
    if max(settled):
        doubts.append(doubt("not-settled", frame=max(settled)))
    rec = RawRecording(rate, sensors, gyr, acc, R_world_sensor=R, valid=valid, start_s=float(t[0]))
    facing, assumed = _facing(rec, R_segment)
    rec = replace(rec, facing_rad=facing)
    return Document(
        "qmt",
        rec,
        (
            assumption("world-of-file"),
            assumption("mounting-fitted", residual=fitted),
            *assumed,
        ),
        tuple(distinct(doubts + _physics.raw(path, rec))),
    )


def _mount(
    R_segment: Array, gyr: Array, acc: Array, rate_hz: float, sensors: tuple[str, ...]
) -> tuple[Array, dict[str, float]]:
    """R_world_sensor (T,S,3,3) of R_world_segment, and the fit's residual by sensor."""
    R, residual = np.empty_like(R_segment), {}
    for s, name in enumerate(sensors):
        Q, residual[name] = fit_mounting(R_segment[:, s], gyr[:, s], acc[:, s], rate_hz)
        R[:, s] = R_segment[:, s] @ Q
    return R, residual


def _sniff(path: Path, head: bytes) -> bool:
    return head.startswith(b"MATLAB 5.0")


FORMAT = Format(
    "qmt",
    (".mat",),
    _sniff,
    _checks.quiet(_read),
    kinds=("raw",),
    about="qmt's full-body example",
    sign="qmt's full-body example (MATLAB 5.0)",
)
