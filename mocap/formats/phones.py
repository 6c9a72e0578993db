"""Recordings of phones and watches: exports of Sensor Logger, SensorLog and phyphox.

A device is a file, or a folder with a file for each of its sensors; a take of several devices is a folder
of these. Sensors of one device have stamps of their own and are put on one grid, rotations on the manifold.
Systems differ in the sign and unit of accelerations and in which way a quaternion turns: gravity tells, since
the device's orientation must turn the specific force upright.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.findings import Finding, assumption, distinct
from mocap.formats import (
    Document,
    Format,
    Options,
    _checks,
    _clock,
    _opensim,
    _phone_tables,
    _physics,
    check_mapped,
)
from mocap.formats._phone_tables import App, Quantity, Stream
from mocap.orientation import Array
from mocap.recording import RawRecording

MAX_DEVICES = 16
UPRIGHT = 0.8  # of the mean specific force that a right orientation turns to the vertical
SURE = 0.05  # of it, between two readings that a device which hardly turned cannot tell apart
LONGEST_GAP = 2.5  # steps of a sensor, beyond which nothing is put in between

_MISSING = {
    "Sensor Logger": "record Gyroscope and Orientation too and give the folder that the app exports",
    "SensorLog": "switch Device Motion on, which has rates and orientation",
    "phyphox": "record an experiment with Acceleration (with g) and Gyroscope and give the folder",
}


@dataclass(frozen=True, eq=False)
class _Device:
    """One device: app, name, and its quantities by kind."""

    name: str
    app: App
    streams: dict[Quantity, Stream]


@dataclass(frozen=True, eq=False)
class _Track:
    """A device on a grid: times (T,) s, force, gyr, mag (T,3), R (T,3,3) in our world or None."""

    rate_hz: float
    t: Array
    force: Array
    gyr: Array
    mag: Array | None
    R: Array | None
    said: list[Finding]
    doubts: list[Finding]


def _devices(path: Path) -> list[_Device]:
    if path.is_file():
        return [_device(path.stem, [path])]
    own = _tables(path)
    if own:
        # SensorLog's tables are a device each, the others' a sensor each.
        if all(app == "SensorLog" for _, app in own) and len(own) > 1:
            return [_device(p.stem, [p]) for p, _ in own]
        return [_device(path.resolve().name, [p for p, _ in own])]
    inside = [f for f in sorted(path.iterdir()) if f.is_dir() and _tables(f)]
    if len(inside) > MAX_DEVICES:
        raise FormatError(path, f"{len(inside)} devices, at most {MAX_DEVICES} are read")
    return [_device(f.name, [p for p, _ in _tables(f)]) for f in inside]


def _tables(folder: Path) -> list[tuple[Path, App]]:
    found = []
    for p in sorted(folder.iterdir()):
        if p.suffix.lower() == ".csv" and p.is_file():
            with p.open("rb") as f:
                app = _phone_tables.app_of(f.read(4096))
            if app is not None:
                found.append((p, app))
    return found


def _device(name: str, files: list[Path]) -> _Device:
    """The device that these files, at least one, are of."""
    streams: dict[Quantity, Stream] = {}
    app: App = "Sensor Logger"
    for path in files:
        with path.open("rb") as f:
            found = _phone_tables.app_of(f.read(4096))
        if found is None:
            raise FormatError(path, "no table of a phone app")
        app = found
        for stream in _phone_tables.read(path, app):
            streams.setdefault(stream.kind, stream)
    folder = files[0] if len(files) == 1 else files[0].parent
    if not streams:
        raise FormatError(folder, f"is {app}'s, and holds no acceleration, rate or orientation")
    if "gyr" not in streams and "quat" not in streams:
        have = ", ".join(sorted(streams))
        raise FormatError(
            folder,
            f"is {app}'s, and its acceleration alone ({have}) tells no movement: {_MISSING[app]}",
        )
    if (
        "quat" not in streams
        and not {"force", "gravity"} & streams.keys()
        and not _has_gravity(streams)
    ):
        raise FormatError(
            folder,
            f"is {app}'s, without gravity and orientation, of which one is needed: {_MISSING[app]}",
        )
    return _Device(name, app, streams)


def _has_gravity(streams: dict[Quantity, Stream]) -> bool:
    """Whether what is called free of gravity holds it all the same."""
    if "free" not in streams:
        return False
    size = float(np.linalg.norm(np.median(streams["free"].values, axis=0)))
    return 0.5 < size < 2 or 0.5 * ori.GRAVITY < size < 2 * ori.GRAVITY


def _track(device: _Device) -> _Track:
    streams = device.streams
    base = next(streams[k] for k in ("gyr", "quat", "force", "free") if k in streams)
    where = f"{base.path.name}, time"
    clock = _clock.grid(base.path, base.t - base.t[0], where)
    grid = float(base.t[0]) + np.arange(int(clock.frames[-1]) + 1) / clock.rate_hz
    on: dict[Quantity, Array] = {}
    for kind, stream in streams.items():
        if len(stream.t) == len(base.t) and np.array_equal(stream.t, base.t):
            out = np.full((len(grid), stream.values.shape[1]), np.nan)
            out[clock.frames] = stream.values
        else:
            out = _between(stream, grid)
        on[kind] = out * (stream.to_si if stream.to_si is not None else 1.0)
    said: list[Finding] = []
    q = on.get("quat")
    R = (
        None
        if q is None
        else _checks.quaternions(base.path, q[:, None], (device.name,), "quaternion")[0][:, 0]
    )
    force, gravity_in = _force(device, on, said)
    if R is not None:
        force, R = _upright(device, force, R, gravity_in, said)
    elif device.app == "SensorLog":
        force = -force
        said.append(assumption("acc-turned-round"))
    gyr = on.get("gyr")
    if gyr is None:
        assert R is not None
        gyr = _checks.rates(R[:, None], clock.rate_hz)[:, 0]
        said.append(assumption("no-rates-of", device=device.name))
    return _Track(clock.rate_hz, grid, force, gyr, on.get("mag"), R, said, list(clock.doubts))


def _force(device: _Device, on: dict[Quantity, Array], said: list[Finding]) -> tuple[Array, bool]:
    """Acceleration (T,3) m/s^2 in the device's axes, of either sign, and whether it holds gravity."""
    if "force" in on:
        force, gravity = on["force"], True
    elif "free" in on and "gravity" in on:
        force, gravity = on["free"] + on["gravity"], True
        said.append(assumption("acc-summed", device=device.name))
    elif "free" in on:
        force, gravity = on["free"], _has_gravity(device.streams)
        if gravity:
            said.append(assumption("acc-has-gravity", device=device.name))
    elif "gravity" in on:
        force, gravity = on["gravity"], True
    else:
        nothing = next(iter(on.values()))
        return np.full((len(nothing), 3), np.nan), False
    unit = next(
        device.streams[k].to_si for k in ("force", "free", "gravity") if k in device.streams
    )
    if unit is None and gravity:
        size = float(np.nanmedian(np.linalg.norm(force, axis=1)))
        if 0.5 < size < 2:
            said.append(assumption("acc-of-device-in-g", device=device.name))
            force = ori.GRAVITY * force
    return force, gravity


def _upright(
    device: _Device, force: Array, R: Array, gravity_in: bool, said: list[Finding]
) -> tuple[Array, Array]:
    """Specific force and R_world_sensor in our world: sign, turning and vertical are those of gravity."""
    if not gravity_in:
        R_up = ori.R_YUP_ZUP @ R
        said.append(assumption("acc-put-back", device=device.name))
        up = np.array([0.0, ori.GRAVITY, 0.0])
        return force + np.einsum("tji,j->ti", R_up, up), R_up
    size = float(np.nanmean(np.linalg.norm(force, axis=1)))
    best, choice = -1.0, (1.0, False, 2)
    # In the order of what is documented, so that a device that hardly turned is read so.
    for inverse in (False, True):
        turned = np.einsum("tji,tj->ti" if inverse else "tij,tj->ti", R, force)
        mean = np.nanmean(turned, axis=0)
        for axis in (2, 1):
            share = abs(float(mean[axis])) / size
            if share > best + SURE:
                best, choice = share, (float(np.sign(mean[axis])), inverse, axis)
    if best < UPRIGHT:
        raise FormatError(
            device.streams["quat"].path,
            f"turns the acceleration to no vertical ({best:.0%} of it at best): of another device?",
            f"sensor {device.name}: orientation",
        )
    sign, inverse, axis = choice
    out = np.swapaxes(R, -1, -2) if inverse else R
    named = "zy"[axis == 1]
    said.append(
        assumption(
            "device-by-gravity",
            device=device.name,
            up=named,
            turned_round=sign < 0,
            inverted=inverse,
        )
    )
    return sign * force, out if axis == 1 else ori.R_YUP_ZUP @ out


def _between(stream: Stream, grid: Array) -> Array:
    """A stream's values at the times of a grid, NaN in its gaps and beyond its ends."""
    t, values = stream.t, stream.values
    order = np.flatnonzero(np.r_[True, np.diff(np.maximum.accumulate(t)) > 0])
    t, values = t[order], values[order]
    if len(t) < 2:
        raise FormatError(stream.path, "fewer than two samples", "time")
    if stream.kind == "quat":
        R = ori.from_quat(values / np.linalg.norm(values, axis=1, keepdims=True))
        out = ori.to_quat(ori.interpolate(t, R, np.clip(grid, t[0], t[-1])))
    else:
        out = np.stack([np.interp(grid, t, v) for v in values.T], axis=1)
    step = float(np.median(np.diff(t)))
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    gap = t[after] - t[after - 1] > LONGEST_GAP * step
    beyond = (grid < t[0] - step) | (grid > t[-1] + step)
    out[gap | beyond] = np.nan
    return np.asarray(out)


def _read(path: Path, options: Options) -> Document:
    devices = _devices(path)
    if not devices:
        raise FormatError(path, "no table of a phone app in it")
    tracks = [_track(d) for d in devices]
    names = [d.name for d in devices]
    check_mapped(path, options.mapping, names)
    given = _opensim.given(options)
    sensors = tuple(given.get(n, n) for n in names)
    rate = options.rate_hz or float(np.median([t.rate_hz for t in tracks]))
    begin, end = max(t.t[0] for t in tracks), min(t.t[-1] for t in tracks)
    doubts = [d for n, t in zip(names, tracks, strict=True) for d in _clock.within(n, t.doubts)]
    if len(tracks) > 1 and end <= begin:
        raise FormatError(path, "the devices' times do not overlap: were they recorded together?")
    if len(tracks) == 1:
        same, grid = True, tracks[0].t
        rate = tracks[0].rate_hz
    else:
        same = False
        grid = begin + np.arange(int((end - begin) * rate) + 1) / rate
    force, gyr = (
        np.stack([_resampled(t.t, getattr(t, k), grid, same) for t in tracks], axis=1)
        for k in ("force", "gyr")
    )
    mag = None
    if all(t.mag is not None for t in tracks):
        mag = np.stack([_resampled(t.t, np.asarray(t.mag), grid, same) for t in tracks], axis=1)
    R = None
    if any(t.R is not None for t in tracks):
        R = np.full((len(grid), len(tracks), 3, 3), np.nan)
        for s, t in enumerate(tracks):
            if t.R is not None:
                R[:, s] = t.R if same else _turned(t.t, t.R, grid)
    acc_unit, gyr_unit = _physics.factors(options)
    # Phones know their own heading alone, be it from a magnetometer that rooms turn.
    rec = RawRecording(
        rate, sensors, gyr * gyr_unit, force * acc_unit, mag, R, common_heading=len(tracks) == 1
    )
    apps = ", ".join(dict.fromkeys(d.app for d in devices))
    said = [assumption("exported-by", apps=apps), *distinct(s for t in tracks for s in t.said)]
    doubts += [*_opensim.unknown(sensors), *_physics.raw(path, rec)]
    return Document("phone", rec, (*said, *_physics.assumed(rec)), tuple(doubts))


def _resampled(t: Array, values: Array, grid: Array, same: bool) -> Array:
    if same:
        return values
    out = np.stack([np.interp(grid, t, v) for v in values.T], axis=1)
    return np.asarray(out)


def _turned(t: Array, R: Array, grid: Array) -> Array:
    has = np.isfinite(R).all((-1, -2))
    out = ori.interpolate(t[has], R[has], np.clip(grid, t[has][0], t[has][-1]))
    lost = np.interp(grid, t, (~has).astype(float)) > 0
    out[lost] = np.nan
    return np.asarray(out)


def _sniff(path: Path, head: bytes) -> bool:
    if path.is_file():
        return _phone_tables.app_of(head) is not None
    return bool(_tables(path)) or any(f.is_dir() and _tables(f) for f in path.iterdir())


FORMAT = Format(
    "phones",
    (".csv", ""),
    _sniff,
    _checks.quiet(_read),
    kinds=("raw",),
    about="Sensor Logger, SensorLog, phyphox: a file, or a folder a device",
    sign="exports of Sensor Logger, SensorLog and phyphox",
)
