"""Virtual sensors on a motion: clean, or with the realistic noise of the design.

acc_t = (p_{t-1} - 2 p_t + p_{t+1}) rate^2, p the sensor's position (DIP, eq. 3); the two end frames
have none and are invalid. The reference is the very motion that was differentiated.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mocap import checked
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import SensorError, ShapeError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import RawRecording, Recording
from mocap.seats import second_difference, sensor_positions
from mocap.skeleton import MIRROR, Skeleton

MAGNETIC_FIELD = np.array([0.0, -40.0, 20.0])  # uT in the y-up world: north is +z, dip 63 degrees


@dataclass(frozen=True)
class Noise:
    """Sizes of the realistic noise, 1 sigma.

    mounting_deg: rotation of the sensor on its bone, per axis, constant. heading_deg: constant heading
    offset of a sensor's world; heading_walk_deg: its random walk, per square-root second. tissue_deg:
    wobble per axis, first order with correlation time tissue_s. seat_m: displacement of the seat, per
    axis, constant. acc_white: m/s^2 per sample at 60 Hz, scaled with sqrt(rate / 60). acc_bias: m/s^2
    per axis of the sensor's own frame, constant. loss: fraction of samples lost, in bursts of loss_s
    mean. bone: relative error of bone lengths, equal on both sides of the body.
    """

    mounting_deg: float = 4.0
    heading_deg: float = 3.0
    heading_walk_deg: float = 0.3
    tissue_deg: float = 2.0
    tissue_s: float = 0.3
    seat_m: float = 0.01
    acc_white: float = 0.35
    acc_bias: float = 0.1
    loss: float = 0.01
    loss_s: float = 0.05
    bone: float = 0.05

    def __post_init__(self) -> None:
        checked.settings(self, positive=("tissue_s", "loss_s"))
        if self.loss >= 1:
            raise ShapeError(f"Noise: loss must be a fraction below 1, got {self.loss!r}")

    @classmethod
    def none(cls) -> Noise:
        """No noise at all."""
        return cls(**{k: 0.0 for k in asdict(cls()) if k not in ("tissue_s", "loss_s")})


NOISES = {"none": Noise.none(), "realistic": Noise()}


@dataclass(frozen=True)
class Drawn:
    """One draw of the noise for T samples of S sensors: see `draw`."""

    R_bone_sensor: Array  # (S,3,3) constant mounting error
    heading: Array  # (T,S) rad
    tissue: Array  # (T,S,3,3)
    seat: Array  # (S,3) m, added to the placement
    white: Array  # (T,S,3) m/s^2, world
    bias: Array  # (S,3) m/s^2, sensor frame
    lost: np.ndarray  # (T,S) bool
    skeleton: Skeleton  # the body that was worn


def draw(
    noise: Noise, rng: np.random.Generator, T: int, S: int, rate_hz: float, skeleton: Skeleton
) -> Drawn:
    """Draw every random quantity of a recording. The order of the draws is fixed: a seed repeats."""
    dt = 1.0 / rate_hz
    mounting = ori.exp(np.deg2rad(noise.mounting_deg) * rng.normal(size=(S, 3)))
    start = noise.heading_deg * rng.normal(size=(1, S))
    steps = noise.heading_walk_deg * np.sqrt(dt) * rng.normal(size=(T, S))
    steps[0] = 0
    heading = np.deg2rad(start + np.cumsum(steps, axis=0))
    # First-order (Ornstein-Uhlenbeck) process, exact discretisation, started in its stationary law.
    keep = np.exp(-dt / noise.tissue_s)
    shocks = rng.normal(size=(T, S, 3))
    wobble = np.empty((T, S, 3))
    wobble[0] = shocks[0]
    for t in range(1, T):
        wobble[t] = keep * wobble[t - 1] + np.sqrt(1 - keep**2) * shocks[t]
    tissue = ori.exp(np.deg2rad(noise.tissue_deg) * wobble)
    seat = noise.seat_m * rng.normal(size=(S, 3))
    white = noise.acc_white * np.sqrt(rate_hz / 60.0) * rng.normal(size=(T, S, 3))
    bias = noise.acc_bias * rng.normal(size=(S, 3))
    factor = 1 + noise.bone * rng.normal(size=len(skeleton.names))
    left = np.minimum(np.arange(len(factor)), np.array(MIRROR))
    worn = skeleton.with_offsets(
        np.vstack([skeleton.offsets[:1], skeleton.offsets[1:] * factor[left][1:, None]])
    )
    lost = _losses(noise, rng, T, S, rate_hz)
    return Drawn(mounting, heading, tissue, seat, white, bias, lost, worn)


def _losses(noise: Noise, rng: np.random.Generator, T: int, S: int, rate_hz: float) -> np.ndarray:
    """Two-state Markov chain per sensor with the stationary fraction and the mean burst length."""
    if noise.loss <= 0:
        return np.zeros((T, S), bool)
    leave = min(1.0, 1.0 / (noise.loss_s * rate_hz))
    enter = leave * noise.loss / (1 - noise.loss)
    u = rng.uniform(size=(T, S))
    lost = np.zeros((T, S), bool)
    state = u[0] < noise.loss
    for t in range(T):
        state = np.where(state, u[t] >= leave, u[t] < enter)
        lost[t] = state
    return lost


def prepare(motion: Motion, rate_hz: float, lowpass_hz: float | None) -> Motion:
    """The motion that sensors are put on: low-passed, then resampled on the manifold."""
    if lowpass_hz is not None:
        motion = motion.lowpassed(lowpass_hz)
    return motion.resampled(rate_hz)


def _checked(motion: Motion, noise: Noise | None) -> Noise:
    checked.instance(motion, Motion, "virtual sensors: motion")
    noise = Noise.none() if noise is None else noise
    checked.instance(noise, Noise, "virtual sensors: noise")
    return noise


def recording(
    motion: Motion,
    sensors: tuple[str, ...] = places.SIX,
    noise: Noise | None = None,
    rng: np.random.Generator | int = 0,
) -> Recording:
    """Calibrated virtual sensors on `motion`, at the motion's rate (see `prepare`).

    R_world_bone = R_y(heading) R_true tissue mounting; acc_world = R_y(heading) (second difference on
    the worn body + R_world_sensor bias + white). Sensors lost have valid False and NaN.
    """
    noise = _checked(motion, noise)
    rng = np.random.default_rng(rng)
    sensors = checked.names(sensors, "virtual sensors: sensors", SensorError)
    joint, placement = places.joints_and_seats(sensors)
    d = draw(noise, rng, len(motion), len(sensors), motion.rate_hz, motion.skeleton)
    R_world_sensor, acc = _measure(motion, joint, placement, d, d.R_bone_sensor)
    R_heading = ori.rot_y(d.heading)
    R = R_heading @ R_world_sensor
    acc = np.einsum("tsij,tsj->tsi", R_heading, acc)
    valid = ~d.lost
    valid[[0, -1]] = False
    R[d.lost] = np.nan
    return Recording(
        motion.rate_hz,
        sensors,
        R,
        acc,
        valid=valid,
        joint=joint,
        placement=placement,
        reference=motion,
        noise=_describe(noise, d) if noise != Noise.none() else None,
    )


def raw_recording(
    motion: Motion,
    sensors: tuple[str, ...] = places.SIX,
    noise: Noise | None = None,
    rng: np.random.Generator | int = 0,
) -> RawRecording:
    """Raw virtual sensors on `motion`: own frames, arbitrary mounting, gravity in.

    Each sensor is mounted at a rotation drawn uniformly (a real one sits as the strap allows), whose
    truth is kept in `truth["R_bone_sensor"]`. acc = R_world_sensor^T (a_world + g e_y) + bias + white;
    gyr_t = Log(R_{t-1}^T R_t) rate, so that integrating it gives the orientation back; mag is a
    constant field. The reported R_world_sensor and mag carry the heading error, gyr and acc do not.
    """
    noise = _checked(motion, noise)
    rng = np.random.default_rng(rng)
    sensors = checked.names(sensors, "virtual sensors: sensors", SensorError)
    joint, placement = places.joints_and_seats(sensors)
    T, S = len(motion), len(sensors)
    if T < 3:
        raise ShapeError(f"raw sensors need a motion of 3 frames or more, got {T}")
    d = draw(noise, rng, T, S, motion.rate_hz, motion.skeleton)
    mounting = ori.from_quat(rng.normal(size=(S, 4)))
    R, acc_world = _measure(motion, joint, placement, d, mounting)
    acc_world[[0, -1]] = acc_world[[1, -2]]  # a raw stream has no hole at its ends
    acc = np.einsum("tsji,tsj->tsi", R, acc_world + ori.GRAVITY * np.array([0, 1.0, 0]))
    gyr = np.empty((T, S, 3))
    gyr[1:] = ori.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]) * motion.rate_hz
    gyr[0] = gyr[1]
    reported = ori.rot_y(d.heading) @ R
    mag = np.einsum("tsji,j->tsi", reported, MAGNETIC_FIELD)
    for a in (acc, gyr, mag, reported):
        a[d.lost] = np.nan
    truth = _describe(noise, d)
    del truth["mounting_rotvec"]  # drawn, but the uniform mounting takes its place here
    truth["R_bone_sensor"] = mounting.tolist()
    return RawRecording(
        motion.rate_hz, sensors, gyr, acc, mag, reported, ~d.lost, reference=motion, truth=truth
    )


def _measure(
    motion: Motion, joint: np.ndarray, placement: Array, d: Drawn, mounting: Array
) -> tuple[Array, Array]:
    """R_world_sensor (T,S,3,3) without heading error, and acc_world (T,S,3) with bias and white noise."""
    body = motion.on(d.skeleton)
    R = body.R_world_joint[:, joint] @ d.tissue @ mounting
    p = sensor_positions(body, joint, placement + d.seat)
    acc = second_difference(p, motion.rate_hz)
    return R, acc + np.einsum("tsij,sj->tsi", R, d.bias) + d.white


def _describe(noise: Noise, d: Drawn) -> dict[str, Any]:
    """What was drawn, as JSON: the constants that self-calibration should find again."""
    return {
        "sigma": asdict(noise),
        "mounting_rotvec": ori.log(d.R_bone_sensor).tolist(),
        "heading_start_rad": d.heading[0].tolist(),
        "heading_mean_rad": d.heading.mean(axis=0).tolist(),
        "seat_m": d.seat.tolist(),
        "acc_bias": d.bias.tolist(),
        "bone_offsets_m": d.skeleton.offsets.tolist(),
    }
