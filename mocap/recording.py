"""What sensors measured: raw (own frames, gravity in) and calibrated (bones in the world, gravity out)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap import checked, gate
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import SensorError, ShapeError
from mocap.motion import Motion, check_rate
from mocap.orientation import Array

Bool = NDArray[np.bool_]


def _names(names: tuple[str, ...], what: str) -> tuple[str, ...]:
    names = checked.names(names, f"{what}: sensors", SensorError)
    if not names:
        raise SensorError(f"{what}: no sensor")
    if len(set(names)) != len(names):
        raise SensorError(f"{what}: sensor names are not unique: {', '.join(names)}")
    return names


def _array(x: Any, shape: tuple[int, ...], what: str) -> Array:
    x = checked.array(x, what)
    if x.shape != shape:
        raise ShapeError(f"{what} must be {shape}, got {x.shape}")
    return x


def _no_rotations(R: Array, rotation: Bool, valid: Bool, names: tuple[str, ...], what: str) -> Bool:
    """(T,S): said to be valid, finite, no rotation. Raises ShapeError where these are most of a sensor's."""
    has = valid & np.isfinite(R).all((-1, -2))
    bad: Bool = has & ~rotation
    most = 2 * bad.sum(axis=0) > has.sum(axis=0)
    if most.any():
        s = int(most.argmax())
        t = int(bad[:, s].argmax())
        with np.errstate(all="ignore"):
            det = float(np.linalg.det(R[t, s]))
        raise ShapeError(
            f"{what.partition(':')[0]}: frame {t}, sensor {names[s]}:{what.partition(':')[2]} is "
            f"{'left-handed' if det < 0 else 'not orthonormal'} (determinant {det:.3g}, expected 1), as are "
            f"{int(bad[:, s].sum())} of {int(has[:, s].sum())} of this sensor"
        )
    return bad


def gaps(valid: Bool) -> list[dict[str, Any]]:
    """Runs of invalid samples: [{"sensor": s, "start": frame, "frames": n}, ...], by sensor."""
    found = []
    for s in range(valid.shape[1]):
        edges = np.flatnonzero(np.diff(np.r_[False, ~valid[:, s], False]))
        for a, b in edges.reshape(-1, 2):
            found.append({"sensor": s, "start": int(a), "frames": int(b - a)})
    return found


@dataclass(frozen=True, eq=False)
class RawRecording:
    """T samples of S sensors in their own frames.

    gyr (T,S,3) rad/s; acc (T,S,3) m/s^2 with gravity (specific force: a still, upright sensor reads
    +9.81 on its up axis); mag (T,S,3) in any unit, or None; R_world_sensor (T,S,3,3) in a y-up world,
    or None; valid (T,S). reference: a known motion, frame for frame, if any. truth: what was synthesised
    (JSON-like), if anything. facing_rad: heading of the person's forward in the static pose, in the world
    of R_world_sensor: forward = (sin, 0, cos), where
    the file knows it (a reader of segment frames does; see `mocap.calibration`). common_heading: whether
    all sensors of R_world_sensor share one heading (False: 6-axis orientation, each its own).

    no_rotation (S,): how many samples of each sensor were said to be valid, though their orientation was no
    rotation to 1e-3: they are not valid here. Raises ShapeError where a sensor has more of these than others:
    then the layout is another one (transposed, left-handed), and no samples are spoiled. Not of what `slice`
    and `select` give.
    """

    rate_hz: float
    sensors: tuple[str, ...]
    gyr: Array
    acc: Array
    mag: Array | None = None
    R_world_sensor: Array | None = None
    valid: Bool = None  # type: ignore[assignment]
    reference: Motion | None = None
    truth: dict[str, Any] | None = None
    start_s: float = 0.0
    facing_rad: float | None = None
    common_heading: bool = True
    no_rotation: NDArray[np.int64] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        names = _names(self.sensors, "RawRecording")
        acc = checked.array(self.acc, "RawRecording: acc")
        T, S = (acc.shape[0] if acc.ndim == 3 else 0), len(names)
        if T == 0:
            raise ShapeError(f"RawRecording: acc must be (T,{S},3), T > 0, got {acc.shape}")
        put = object.__setattr__
        put(self, "rate_hz", check_rate(self.rate_hz, "RawRecording"))
        put(self, "start_s", checked.number(self.start_s, "RawRecording: start_s"))
        if self.reference is not None:
            checked.instance(self.reference, Motion, "RawRecording: reference")
        if self.facing_rad is not None:
            put(self, "facing_rad", checked.number(self.facing_rad, "RawRecording: facing_rad"))
        checked.instance(self.common_heading, bool, "RawRecording: common_heading")
        if self.truth is not None:
            checked.instance(self.truth, dict, "RawRecording: truth")
        put(self, "sensors", names)
        put(self, "acc", _array(self.acc, (T, S, 3), "RawRecording: acc"))
        put(self, "gyr", _array(self.gyr, (T, S, 3), "RawRecording: gyr"))
        finite = np.isfinite(self.acc).all(-1) & np.isfinite(self.gyr).all(-1)
        if self.mag is not None:
            put(self, "mag", _array(self.mag, (T, S, 3), "RawRecording: mag"))
        valid = np.ones((T, S), bool)
        if self.valid is not None:
            valid = checked.truths(self.valid, (T, S), "RawRecording: valid")
        if self.R_world_sensor is not None:
            R = _array(self.R_world_sensor, (T, S, 3, 3), "RawRecording: R_world_sensor")
            # Where nobody says that it is valid, it may not be read either: fusion and checks look at all.
            rotation = gate.is_rotation(R)
            bad = _no_rotations(R, rotation, valid, names, "RawRecording: R_world_sensor")
            R[~rotation] = np.nan
            put(self, "R_world_sensor", R)
            put(self, "no_rotation", bad.sum(axis=0))
            valid &= ~bad
            has = np.isfinite(R).all((-1, -2))
            # A sensor that delivers orientation alone (some exports do) counts by its orientation.
            blind = ~np.isfinite(self.acc).any((0, 2))
            finite = np.where(blind, has, finite)
        put(self, "valid", valid & finite)
        if self.reference is not None and len(self.reference) != T:
            raise ShapeError(f"RawRecording: reference has {len(self.reference)} frames, not {T}")

    def __len__(self) -> int:
        return len(self.acc)

    @property
    def seconds(self) -> float:
        return len(self) / self.rate_hz

    def select(self, names: tuple[str, ...]) -> RawRecording:
        """The same recording of these sensors, in this order."""
        idx = _indices(self.sensors, names)
        return replace(
            self,
            sensors=tuple(names),
            gyr=self.gyr[:, idx],
            acc=self.acc[:, idx],
            mag=None if self.mag is None else self.mag[:, idx],
            R_world_sensor=None if self.R_world_sensor is None else self.R_world_sensor[:, idx],
            valid=self.valid[:, idx],
        )

    def renamed(self, mapping: dict[str, str]) -> RawRecording:
        """Sensors renamed by `mapping` (names that are not in it stay)."""
        checked.instance(mapping, dict, "RawRecording.renamed: mapping")
        return replace(self, sensors=tuple(mapping.get(n, n) for n in self.sensors))

    def slice(self, start: int, stop: int) -> RawRecording:
        """Frames start to stop-1, at the time they have here."""
        cut = slice(start, stop)
        return replace(
            self,
            gyr=self.gyr[cut],
            acc=self.acc[cut],
            mag=None if self.mag is None else self.mag[cut],
            R_world_sensor=None if self.R_world_sensor is None else self.R_world_sensor[cut],
            valid=self.valid[cut],
            reference=None if self.reference is None else self.reference.slice(start, stop),
            start_s=self.start_s + slice(start, stop).indices(len(self))[0] / self.rate_hz,
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """T samples of S calibrated sensors: what every estimator reads.

    R_world_bone (T,S,3,3): orientation of the bone that carries the sensor (rest pose: identity), in
    the y-up world. acc_world (T,S,3) m/s^2: acceleration of the sensor in the world, gravity removed;
    a sensor without one has NaN. valid (T,S): False where nothing of the sample may be used; then
    acc_world is NaN, and what R_world_bone holds must be ignored. joint (S,) and placement (S,3) m:
    the joint whose rotation each sensor follows and its seat in that bone's rest frame (defaults: the
    table of places). reference: a known motion, frame for frame. calibration, noise: JSON-like records
    of how the recording was made. start_s: time of frame 0 on the source's clock. no_rotation (S,): as
    `RawRecording` has it.
    """

    rate_hz: float
    sensors: tuple[str, ...]
    R_world_bone: Array
    acc_world: Array
    valid: Bool = None  # type: ignore[assignment]
    joint: NDArray[np.int64] = None  # type: ignore[assignment]
    placement: Array = None  # type: ignore[assignment]
    reference: Motion | None = None
    calibration: dict[str, Any] | None = None
    noise: dict[str, Any] | None = None
    start_s: float = 0.0
    notes: tuple[str, ...] = field(default=())
    no_rotation: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        names = _names(self.sensors, "Recording")
        put(self, "sensors", names)
        put(self, "rate_hz", check_rate(self.rate_hz, "Recording"))
        S = len(names)
        put(self, "start_s", checked.number(self.start_s, "Recording: start_s"))
        if self.reference is not None:
            checked.instance(self.reference, Motion, "Recording: reference")
        for name in ("calibration", "noise"):
            if getattr(self, name) is not None:
                checked.instance(getattr(self, name), dict, f"Recording: {name}")
        put(self, "notes", checked.names(self.notes, "Recording: notes"))
        R = checked.array(self.R_world_bone, "Recording: R_world_bone")
        if R.ndim != 4 or R.shape[1:] != (S, 3, 3) or len(R) == 0:
            raise ShapeError(f"Recording: R_world_bone must be (T,{S},3,3), T > 0, got {R.shape}")
        T = len(R)
        acc = _array(self.acc_world, (T, S, 3), "Recording: acc_world")
        valid = np.ones((T, S), bool)
        if self.valid is not None:
            valid = checked.truths(self.valid, (T, S), "Recording: valid")
        bad = _no_rotations(R, gate.is_rotation(R), valid, names, "Recording: R_world_bone")
        put(self, "no_rotation", bad.sum(axis=0))
        R[bad], valid = np.nan, valid & ~bad
        has_R = np.isfinite(R).all((-1, -2))
        # Files hold float32: project once, so that rounding does not count as a residual.
        use = valid & has_R
        R[use] = ori.project(R[use])
        valid &= has_R | np.isfinite(acc).all(-1)
        acc[~valid] = np.nan
        put(self, "R_world_bone", R)
        put(self, "acc_world", acc)
        put(self, "valid", valid)
        joint, seat = self.joint, self.placement
        if joint is None or seat is None:
            joint_t, seat_t = places.joints_and_seats(names)
            joint = joint_t if joint is None else joint
            seat = seat_t if seat is None else seat
        joint = checked.whole(joint, "Recording: joint", SensorError)
        if joint.shape != (S,) or (joint < 0).any() or (joint > 23).any():
            raise SensorError(f"Recording: joint must hold {S} indices in 0..23, got {joint}")
        put(self, "joint", joint)
        seat = _array(seat, (S, 3), "Recording: placement")
        if not np.isfinite(seat).all() or np.abs(seat).max() > 2:
            raise ShapeError("Recording: placement must be metres on the bone, within 2 m")
        put(self, "placement", seat)
        if self.reference is not None:
            if len(self.reference) != T:
                raise ShapeError(f"Recording: reference has {len(self.reference)} frames, not {T}")
            if abs(self.reference.rate_hz - self.rate_hz) > 1e-6 * self.rate_hz:
                raise ShapeError("Recording: reference runs at another rate")
        for a in (R, acc, valid, joint, seat):
            a.setflags(write=False)

    def __len__(self) -> int:
        return len(self.R_world_bone)

    @property
    def seconds(self) -> float:
        """Length in s: frames / rate."""
        return len(self) / self.rate_hz

    @property
    def ori_valid(self) -> Bool:
        """(T,S): the orientation may be used."""
        return self.valid & np.isfinite(self.R_world_bone).all((-1, -2))

    @property
    def acc_valid(self) -> Bool:
        """(T,S): the acceleration may be used."""
        return self.valid & np.isfinite(self.acc_world).all(-1)

    def select(self, names: tuple[str, ...]) -> Recording:
        """The same recording of these sensors, in this order."""
        idx = _indices(self.sensors, names)
        return replace(
            self,
            sensors=tuple(names),
            R_world_bone=self.R_world_bone[:, idx],
            acc_world=self.acc_world[:, idx],
            valid=self.valid[:, idx],
            joint=self.joint[idx],
            placement=self.placement[idx],
        )

    def slice(self, start: int, stop: int) -> Recording:
        """Frames start to stop-1, at the time they have here."""
        return replace(
            self,
            R_world_bone=self.R_world_bone[start:stop],
            acc_world=self.acc_world[start:stop],
            valid=self.valid[start:stop],
            reference=None if self.reference is None else self.reference.slice(start, stop),
            start_s=self.start_s + slice(start, stop).indices(len(self))[0] / self.rate_hz,
        )

    def turned(self, yaw: float) -> Recording:
        """Everything turned about the vertical by `yaw` rad."""
        Ry = ori.rot_y(checked.number(yaw, "Recording.turned: yaw"))
        return replace(
            self,
            R_world_bone=Ry @ self.R_world_bone,
            acc_world=self.acc_world @ Ry.T,
            reference=None if self.reference is None else self.reference.turned(yaw),
        )


def _indices(have: tuple[str, ...], want: tuple[str, ...]) -> list[int]:
    want = checked.names(want, "select: sensors", SensorError)
    missing = [n for n in want if n not in have]
    if missing or not want:
        raise SensorError(
            f"sensor {', '.join(missing) or '(none)'} not in the recording; it has: {', '.join(have)}"
        )
    return [have.index(n) for n in want]
