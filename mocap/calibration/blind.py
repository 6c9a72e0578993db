"""Sensors that deliver an orientation and no acceleration: OpenSense tables, some exports of suits.

They stand in for slow ones: at rest a sensor's specific force is g R_world_sensor^T e_y. With that, the
static pose is found and checked as ever; what they measured stays without acceleration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from mocap.findings import Finding
from mocap.recording import Bool, RawRecording


def blind(raw: RawRecording) -> Bool:
    """(S,): sensors of `raw` with orientations, rates of turning and no sample of acc."""
    S = len(raw.sensors)
    if raw.R_world_sensor is None:
        return np.zeros(S, bool)
    oriented = np.isfinite(raw.R_world_sensor).all((-1, -2)).any(axis=0)
    turning = np.isfinite(raw.gyr).all(-1).any(axis=0)
    return np.asarray(oriented & turning & ~np.isfinite(raw.acc).any((0, 2)))


def at_rest(raw: RawRecording) -> RawRecording:
    """`raw` with acc of its blind sensors as if they hardly moved: g R_world_sensor^T e_y."""
    none = blind(raw)
    if not none.any() or raw.R_world_sensor is None:
        return raw
    acc = raw.acc.copy()
    acc[:, none] = ori.GRAVITY * raw.R_world_sensor[:, none, 1, :]
    return replace(raw, acc=acc)


def told(raw: RawRecording) -> list[Finding]:
    """A warning for each blind sensor."""
    names = [n for n, none in zip(raw.sensors, blind(raw), strict=True) if none]
    return [
        Finding("warning", n, "no-acc", None, {"all": len(names) == len(raw.sensors)})
        for n in names
    ]
