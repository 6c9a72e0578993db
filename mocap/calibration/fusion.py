"""Orientation of each sensor from its own gyroscope, accelerometer and, if any, magnetometer.

The filter is VQF (Laidig and Seel, Information Fusion 91, 2023, doi:10.1016/j.inffus.2022.10.014), by
default its offline variant, which looks both ways in time. VQF's world is z-up; ours is y-up:
R_world_sensor = R_YUP_ZUP R_vqf.

Without a magnetometer the heading of each sensor is its own, starts arbitrarily and drifts slowly;
with one, all headings refer to magnetic north.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from mocap import orientation as ori
from mocap.errors import CalibrationError
from mocap.orientation import Array
from mocap.recording import Bool, RawRecording, gaps

# A gap is bridged by straight lines. Longer than this, a limb may turn and turn back unseen, and the
# heading behind the gap no longer follows from the one before it.
LONG_GAP_S = 0.25

Method = Literal["offline", "online"]


@dataclass(frozen=True, eq=False)
class Fusion:
    """What the filter found.

    R_world_sensor (T,S,3,3), y-up; NaN where the raw sample is invalid. common_heading: True where
    magnetometers tie all headings to north, False where each sensor has its own. gyr_bias (S,3) rad/s,
    the mean estimate. rest (T,S): samples the filter took for rest. long_gaps: (sensor index, start
    frame, frames) of holes behind which a 6-axis heading may have jumped.
    """

    R_world_sensor: Array
    common_heading: bool
    gyr_bias: Array
    rest: Bool
    long_gaps: tuple[tuple[int, int, int], ...]


def fuse(
    raw: RawRecording,
    use_mag: bool | None = None,
    method: Method = "offline",
    parameters: Mapping[str, Any] | None = None,
) -> Fusion:
    """R_world_sensor of every sensor of `raw` by VQF; what the recording itself claims is ignored.

    use_mag: None uses the magnetometers if all sensors have them. method: "offline" (acausal, the
    better one) or "online" (each sample from the past alone, as a live run would have it).
    parameters: VQF's own, by their names there. Invalid samples are bridged by linear interpolation
    for the filter and come back as NaN. Raises CalibrationError where a sensor has no valid sample, or
    where magnetometers are asked for and absent.
    """
    mag = _magnetometers(raw, use_mag)
    T, S = raw.valid.shape
    R = np.full((T, S, 3, 3), np.nan)
    bias, rest = np.zeros((S, 3)), np.zeros((T, S), bool)
    for s, name in enumerate(raw.sensors):
        ok = raw.valid[:, s]
        if ok.sum() < 2:
            raise CalibrationError(f"sensor {name}: fewer than two valid samples, nothing to fuse")
        gyr, acc = bridged(raw.gyr[:, s], ok), bridged(raw.acc[:, s], ok)
        field = None
        if mag is not None:
            field = bridged(mag[:, s], ok & np.isfinite(mag[:, s]).all(-1))
        out = _run(gyr, acc, field, 1.0 / raw.rate_hz, method, dict(parameters or {}))
        quat = out["quat6D" if field is None else "quat9D"]
        R[ok, s] = ori.R_YUP_ZUP @ ori.from_quat(quat[ok])
        bias[s], rest[:, s] = out["bias"].mean(axis=0), out["restDetected"]
    long = tuple(
        (g["sensor"], g["start"], g["frames"])
        for g in gaps(raw.valid)
        if g["frames"] > LONG_GAP_S * raw.rate_hz
    )
    return Fusion(R, mag is not None, bias, rest, long)


def with_orientation(
    raw: RawRecording, use_mag: bool | None = None, method: Method = "offline"
) -> RawRecording:
    """`raw` with the R_world_sensor of `fuse`, and `common_heading` set accordingly.

    A facing that was known in another world does not hold in the filter's, so it is dropped.
    """
    found = fuse(raw, use_mag, method)
    return replace(
        raw,
        R_world_sensor=found.R_world_sensor,
        common_heading=found.common_heading,
        facing_rad=None,
    )


def _magnetometers(raw: RawRecording, use_mag: bool | None) -> Array | None:
    if raw.mag is None:
        if use_mag:
            raise CalibrationError("magnetometers were asked for, the recording has none")
        return None
    usable = (np.isfinite(raw.mag).all(-1) & (np.abs(raw.mag).max(-1) > 0)).sum(axis=0) >= 2
    if use_mag and not usable.all():
        name = raw.sensors[int(np.argmin(usable))]
        raise CalibrationError(f"sensor {name}: magnetometers were asked for, it has none")
    return raw.mag if usable.all() and use_mag is not False else None


def bridged(x: Array, ok: Bool) -> Array:
    """(T,3) with the samples that are not `ok` on straight lines between their neighbours."""
    if ok.all():
        return np.ascontiguousarray(x)
    t, known = np.arange(len(x)), np.flatnonzero(ok)
    return np.stack([np.interp(t, known, x[known, k]) for k in range(3)], axis=1)


def _run(
    gyr: Array,
    acc: Array,
    mag: Array | None,
    dt: float,
    method: Method,
    parameters: dict[str, Any],
) -> dict[str, Array]:
    import vqf

    if method == "offline":
        return dict(vqf.offlineVQF(gyr, acc, mag, dt, parameters))
    return dict(vqf.VQF(dt, **parameters).updateBatchFullState(gyr, acc, mag))
