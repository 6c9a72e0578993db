"""Orientation from gyr and acc (and mag): the truth, what realistic noise leaves of it, gaps, errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import calibrate
from mocap.calibration.fusion import fuse, with_orientation
from mocap.errors import CalibrationError
from mocap.recording import RawRecording
from mocap.synthesis import NOISES, Noise, raw_recording
from mocap.synthesis.motions import builtin


def tilt_deg(Ra: np.ndarray, Rb: np.ndarray) -> np.ndarray:
    """Angle between the up directions that two orientations see: independent of heading."""
    cos = np.einsum("...i,...i->...", Ra[..., 1, :], Rb[..., 1, :])
    return np.degrees(np.arccos(np.clip(cos, -1, 1)))


@pytest.fixture(scope="module")
def raw() -> RawRecording:
    return raw_recording(builtin(60.0), places.SIX, NOISES["none"], 3)


@pytest.mark.parametrize("rate", [37.0, 60.0, 200.0])
def test_tilt_is_right_at_any_rate(rate: float) -> None:
    raw = raw_recording(builtin(rate, 8.0), ("pelvis", "left_shank"), NOISES["none"], 1)
    assert tilt_deg(fuse(replace(raw, mag=None)).R_world_sensor, raw.R_world_sensor).max() < 3.0


def test_a_still_sensor_reads_gravity_up() -> None:
    """The z-up world of the filter has become ours: R acc = +9.81 e_y."""
    acc = np.tile([0.3, -0.5, 9.8], (200, 1, 1))
    raw = RawRecording(50.0, ("pelvis",), np.zeros_like(acc), acc)
    up = fuse(raw).R_world_sensor[-1, 0] @ acc[-1, 0]
    assert up == pytest.approx([0, np.linalg.norm(acc[0, 0]), 0], abs=1e-3)


def test_own_headings_stay_constant(raw: RawRecording) -> None:
    """6-axis: the heading of each sensor is off by a constant of its own, within 2 deg over 20 s."""
    found = fuse(raw, use_mag=False)
    assert not found.common_heading
    off = ori.heading(found.R_world_sensor @ np.swapaxes(raw.R_world_sensor, -1, -2))
    drift = np.degrees(np.angle(np.exp(1j * (off - off[60]))))
    assert np.abs(drift).max() < 2.0


def test_magnetometers_make_the_heading_common(raw: RawRecording) -> None:
    found = fuse(raw)
    assert found.common_heading
    off = ori.heading(found.R_world_sensor @ np.swapaxes(raw.R_world_sensor, -1, -2))[60:]
    assert np.degrees(np.abs(np.angle(np.exp(1j * (off - off[0, 0]))))).max() < 3.0


TAU_S = 3.0  # VQF's default time constant of the correction by gravity
SPAN_S = 5.0


@dataclass(frozen=True)
class Expected:
    """What the noise does to an orientation, deg, root mean square."""

    bias: float
    white: float
    lost_tilt: float
    lost_heading: float
    walk: float

    @classmethod
    def of(cls, noise: Noise, rate_hz: float) -> Expected:
        """From the noise's own numbers. gyr and acc measure the sensor, soft tissue and all, so tissue and
        mounting are no error here but in the samples that are lost.

        bias: acc_bias in the two level axes tilts "up" by sqrt(2) acc_bias / g. white: density acc_white^2
        / 60 in each, through a two-pole low-pass at sqrt(2) / (2 pi TAU_S), whose noise bandwidth, both
        sides, is 0.5 / TAU_S. lost: a burst of n samples (geometric, mean loss_s) hides the change of
        the tissue's wobble, 2 s^2 (1 - k^n) per axis, k its correlation over a sample, and puts n times
        the mean of the rates beside it in its place, n^2 s^2 (1 - k). With loss / loss_s bursts a second
        this is a random walk, which gravity stops for the tilt's two axes within TAU_S (steady variance
        rate TAU_S / 2; looking both ways in time, no more than that), and nothing for the heading.
        walk: of the heading that the reference itself reports.
        """
        k, leave = np.exp(-1 / (rate_hz * noise.tissue_s)), min(1, 1 / (noise.loss_s * rate_hz))
        hidden = 2 * (1 - leave * k / (1 - (1 - leave) * k))
        bridged = (2 - leave) / leave**2 * (1 - k)
        rate = noise.loss / noise.loss_s * noise.tissue_deg**2 * (hidden + bridged)
        density = noise.acc_white**2 / 60
        return cls(
            bias=float(np.degrees(np.sqrt(2) * noise.acc_bias / ori.GRAVITY)),
            white=float(np.degrees(np.sqrt(2 * density * 0.5 / TAU_S) / ori.GRAVITY)),
            lost_tilt=float(np.sqrt(2 * rate * TAU_S / 2)),
            lost_heading=float(np.sqrt(rate * SPAN_S)),
            walk=noise.heading_walk_deg * np.sqrt(SPAN_S),
        )


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(x**2)))


def errors(noise: Noise, rate_hz: float, seed: int) -> tuple[float, float]:
    """Tilt, and change of heading over SPAN_S, of 17 sensors against the truth: deg, root mean square."""
    raw = raw_recording(builtin(rate_hz), places.SUIT, noise, seed)
    found = fuse(replace(raw, mag=None)).R_world_sensor
    assert raw.R_world_sensor is not None
    off = ori.heading(found @ np.swapaxes(raw.R_world_sensor, -1, -2))
    span = round(SPAN_S * rate_hz)
    change = np.degrees(np.angle(np.exp(1j * (off[span:] - off[:-span]))))
    return rms(tilt_deg(found, raw.R_world_sensor)), rms(change)


@pytest.mark.parametrize("rate_hz", [60.0, 100.0])
def test_realistic_noise_leaves_what_it_must(rate_hz: float) -> None:
    """Tilt and heading are off by what `Expected` says of the noise, and what motion alone does.

    The bias of 17 sensors has 34 level components, so its root mean square varies by 1/sqrt(68) = 12 %
    from draw to draw: within three of these, 36 %. Of bursts there are some 75 in a recording, of very
    different size: 50 % for the heading; the tilt's variance is a bound from above, 20 % over it.
    """
    noise = Noise()
    expected = Expected.of(noise, rate_hz)
    moving, drift = errors(Noise.none(), rate_hz, 0)
    assert moving < 0.6 and drift < 0.1

    tilt, change = errors(replace(noise, loss=0.0), rate_hz, 1)
    assert tilt == pytest.approx(
        np.hypot(moving, np.hypot(expected.bias, expected.white)), rel=0.36
    )
    assert change == pytest.approx(expected.walk, rel=0.36)

    tilt, change = errors(noise, rate_hz, 1)
    most = np.sqrt(moving**2 + expected.bias**2 + expected.white**2 + expected.lost_tilt**2)
    assert expected.bias < tilt < 1.2 * most
    assert change == pytest.approx(np.hypot(expected.walk, expected.lost_heading), rel=0.5)


@pytest.mark.parametrize("seed", range(3))
def test_fused_and_calibrated_it_is_the_truth_within_the_noise(seed: int) -> None:
    """gyr and acc with the realistic noise, through the filter and the calibration: errors of the bones.

    Independent parts, root mean square over time, deg, s = tissue_deg per axis:
    wobble: the sensor on its bone now, sqrt(3) s.
    pose: its mean over the pose of W s, in which the mounting takes part: a first-order process of
    correlation time a has a mean of variance s^2 (2 a / W) (1 - (a / W) (1 - exp(-W / a))).
    tilt: `Expected`'s, in the pose and now. drift: its heading's random walk since the pose, whose
    variance grows with time, so half of that at the end of the recording on average.
    facing: a heading that is off by e turns a bone that left the pose by R_left by the angle
    e |R_left e_y - e_y| (first order of R_y(e) R_left R_y(-e)); e is said to be heading_sigma.
    All but the wobble is drawn about once for a sensor and a recording: one sensor may have three times
    that, but 17 independent ones together hardly more than the sum says.
    """
    rate_hz, noise = 60.0, Noise()
    motion = builtin(rate_hz)
    raw = replace(raw_recording(motion.turned(0.7), places.SUIT, noise, seed), mag=None)
    rec, cal = calibrate(raw, orientation="vqf")
    R_true = motion.R_world_joint[:, rec.joint]
    off = np.degrees(ori.angle_between(R_true, rec.R_world_bone))
    seen = np.sqrt(np.nanmean(off**2, axis=0))

    s, share = noise.tissue_deg, noise.tissue_s / (cal.time[1] - cal.time[0])
    mean = 2 * share * (1 - share * (1 - np.exp(-1 / share)))
    of = Expected.of(noise, rate_hz)
    tilt = 2 * (of.bias**2 + of.white**2 + of.lost_tilt**2)
    drift = of.lost_heading**2 / SPAN_S * len(motion) / rate_hz / 2
    wobble, once = 3 * s**2, 3 * s**2 * mean + tilt + drift
    left = R_true @ np.swapaxes(R_true[60], -1, -2)
    reach = np.sqrt((np.linalg.norm(left[..., 1] - [0, 1, 0], axis=-1) ** 2).mean(axis=0))
    once = once + (np.degrees(cal.heading_sigma) * reach) ** 2
    assert np.degrees(cal.heading_sigma).max() < 15
    assert (seen < np.sqrt(wobble + 9 * once)).all()
    assert np.sqrt(wobble) < rms(off) < 1.2 * np.sqrt(wobble + once.mean())


def test_online_variant_agrees_with_offline(raw: RawRecording) -> None:
    online = fuse(raw, use_mag=False, method="online").R_world_sensor
    assert tilt_deg(online, raw.R_world_sensor)[300:].mean() < 1.0


def test_gaps_are_bridged_and_stay_invalid(raw: RawRecording) -> None:
    whole = fuse(raw, use_mag=False)
    gyr, acc = raw.gyr.copy(), raw.acc.copy()
    gyr[200:206, 1], acc[200:206, 1] = np.nan, np.nan
    gyr[900:960, 4] = np.nan
    holed = replace(raw, gyr=gyr, acc=acc)
    found = fuse(holed, use_mag=False)
    assert np.isnan(found.R_world_sensor[200:206, 1]).all()
    assert np.isfinite(found.R_world_sensor[holed.valid]).all()
    after = ori.angle_between(found.R_world_sensor[300, 1], whole.R_world_sensor[300, 1])
    assert np.degrees(after) < 3.0
    assert found.long_gaps == ((4, 900, 60),)


def test_with_orientation_marks_what_it_knows(raw: RawRecording) -> None:
    fused = with_orientation(replace(raw, facing_rad=0.3), use_mag=False)
    assert fused.common_heading is False
    assert fused.facing_rad is None  # it was said of another world


def test_errors_name_the_sensor(raw: RawRecording) -> None:
    dead = raw.valid.copy()
    dead[:, 2] = False
    with pytest.raises(CalibrationError, match="left_shank"):
        fuse(replace(raw, valid=dead))
    with pytest.raises(CalibrationError, match="magnetometer"):
        fuse(replace(raw, mag=None), use_mag=True)
