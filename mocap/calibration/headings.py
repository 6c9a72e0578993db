"""Headings that each sensor has for itself (6-axis orientation): brought together by shared motion.

When the body as a whole speeds up, brakes or sways, neighbouring segments have the same slow horizontal
acceleration, each seen in its own world. With h the complex heading of `calibration.facing` and phi_a, phi_b
the wearer's facing in the worlds of sensors a and b,

    phi_a - phi_b = arg sum_t h(acc_a) conj(h(acc_b)),

and the coherence |sum| / sqrt(sum |h_a|^2 sum |h_b|^2) says how far to trust it. These differences and
the absolute cues of `mocap.calibration.facing` form one weighted least-squares problem on the circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from mocap.calibration.facing import Cue, complex_heading, wrap
from mocap.calibration.fusion import bridged
from mocap.errors import CalibrationError
from mocap.orientation import Array
from mocap.recording import RawRecording
from mocap.skeleton import JOINTS, PARENTS

# Bands (Hz) in which segments move together: slower, integrated tilt errors rule; faster, limbs swing.
BANDS = ((0.1, 0.5), (0.2, 1.0), (0.3, 2.0))
MIN_COHERENCE, GOOD_COHERENCE = 0.4, 0.6
DOUBT_DEG = 25.0  # added to the floor where the coherence is only the former
MIN_ACC = 0.08  # m/s^2 rms: below, tilt errors of half a degree look the same
# Floor of the uncertainty, deg: for neighbours, and for every further joint between the two.
FLOOR_DEG, FLOOR_PER_JOINT_DEG = 8.0, 6.0


@dataclass(frozen=True)
class Relative:
    """phi_a - phi_b of two sensors (indices), its 1-sigma in rad, and the coherence it came with."""

    a: int
    b: int
    delta: float
    sigma: float
    coherence: float


def distance(joint_a: int, joint_b: int) -> int:
    """Number of joints between two bones of the body: 0 for the same bone."""
    up_a, up_b = _ancestors(joint_a), _ancestors(joint_b)
    shared = len(set(up_a) & set(up_b))
    return len(up_a) + len(up_b) - 2 * shared


def limb(joint: int) -> str:
    """`left_leg`, `right_arm` or `trunk`."""
    name = JOINTS[joint]
    side, _, part = name.rpartition("_")
    if not side or part == "collar":
        return "trunk"
    return f"{side}_{'leg' if part in ('hip', 'knee', 'ankle', 'foot') else 'arm'}"


def comparable(joint_a: int, joint_b: int) -> bool:
    """Whether two bones may share accelerations: on one limb, or one of them on the trunk.

    Limbs swing against each other, left against right and arm against leg, coherently and in
    opposite directions: across limbs the difference would come out turned by 180 deg.
    """
    limbs = {limb(joint_a), limb(joint_b)}
    return len(limbs) == 1 or "trunk" in limbs


def _ancestors(joint: int) -> list[int]:
    chain = [joint]
    while PARENTS[chain[-1]] >= 0:
        chain.append(PARENTS[chain[-1]])
    return chain


def shared_acceleration(raw: RawRecording, joints: np.ndarray) -> list[Relative]:
    """Differences of facing between all comparable pairs of sensors that move coherently.

    Needs R_world_sensor. For each pair the band with the best coherence counts; sigma^2 is
    (1 - c^2) / (2 c^2 n) with n = 2 (bandwidth) (seconds) independent samples, plus the floor squared.
    """
    assert raw.R_world_sensor is not None
    T, S = raw.valid.shape
    acc = np.einsum("tsij,tsj->tsi", raw.R_world_sensor, raw.acc)
    for s in range(S):
        acc[:, s] = bridged(acc[:, s], np.isfinite(acc[:, s]).all(-1))
    best: dict[tuple[int, int], Relative] = {}
    for low, high in BANDS:
        if high >= raw.rate_hz / 2 or 3 * raw.rate_hz / low > T:
            continue
        h = complex_heading(_bandpass(acc, low, high, raw.rate_hz))
        n = 2 * (high - low) * T / raw.rate_hz
        for a, b in combinations(range(S), 2):
            if not comparable(int(joints[a]), int(joints[b])):
                continue
            found = _pair(a, b, h, n, distance(int(joints[a]), int(joints[b])))
            if found and ((a, b) not in best or found.coherence > best[a, b].coherence):
                best[a, b] = found
    return list(best.values())


def _pair(a: int, b: int, h: Array, n: float, apart: int) -> Relative | None:
    power = [float(np.mean(np.abs(h[:, s]) ** 2)) for s in (a, b)]
    if min(power) < MIN_ACC**2:
        return None
    z = np.mean(h[:, a] * np.conj(h[:, b]))
    c = float(abs(z) / np.sqrt(power[0] * power[1]))
    if c < MIN_COHERENCE:
        return None
    floor = FLOOR_DEG + FLOOR_PER_JOINT_DEG * max(apart - 1, 0)
    floor = np.radians(floor + (DOUBT_DEG if c < GOOD_COHERENCE else 0.0))
    sigma = np.sqrt((1 - c**2) / (2 * c**2 * n) + floor**2)
    return Relative(a, b, float(np.angle(z)), float(sigma), c)


def _bandpass(x: Array, low: float, high: float, rate_hz: float) -> Array:
    sos = butter(2, [2 * low / rate_hz, 2 * high / rate_hz], "band", output="sos")
    return np.asarray(sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, int(rate_hz / low))))


def solve(
    sensors: tuple[str, ...], cues: list[Cue], relatives: list[Relative]
) -> tuple[Array, Array]:
    """Facing phi (S,) and its 1-sigma (S,), rad, from absolute and relative cues.

    Minimises sum (phi_s - cue)^2/sigma^2 + sum (phi_a - phi_b - delta)^2/sigma^2 over the circle,
    started along the most certain path from the cues and reweighted (Cauchy, 2 sigma), because a single
    cue may be turned by 180 deg. Sensors that no cue reaches have sigma pi and phi NaN.
    """
    S = len(sensors)
    if not cues:
        raise CalibrationError("no cue for the facing of any sensor")
    rows = [(sensors.index(c.sensor), -1, c.heading, c.sigma) for c in cues]
    rows += [(r.a, r.b, r.delta, r.sigma) for r in relatives]
    phi = _start(S, cues, sensors, relatives)
    reached = np.flatnonzero(np.isfinite(phi))
    rows = [r for r in rows if np.isfinite(phi[r[0]])]
    A = np.zeros((len(rows), S))
    for k, (a, b, _, _) in enumerate(rows):
        A[k, a] = 1
        if b >= 0:
            A[k, b] = -1
    A = A[:, reached]
    value, sigma = (np.array([r[i] for r in rows]) for i in (2, 3))
    weight = sigma**-2
    x = phi[reached]
    for _ in range(50):
        r = wrap(value - A @ x)
        w = weight / (1 + (r / (2 * sigma)) ** 2)
        step = np.linalg.solve(A.T @ (w[:, None] * A), A.T @ (w * r))
        x = x + step
        if np.abs(step).max() < 1e-9:
            break
    phi[reached] = wrap(x)
    spread = np.full(S, np.pi)
    spread[reached] = np.sqrt(np.diag(np.linalg.inv(A.T @ (w[:, None] * A))))
    return phi, spread


def _start(S: int, cues: list[Cue], sensors: tuple[str, ...], relatives: list[Relative]) -> Array:
    """Facing (S,) from which all cues together look best: each cue in turn, spread along the edges."""
    candidates = [_spread(S, sensors.index(c.sensor), c.heading, relatives) for c in cues]
    for phi in candidates:
        # Parts of the body that this cue does not reach take their own most certain cue.
        for c in sorted(cues, key=lambda c: c.sigma):
            s = sensors.index(c.sensor)
            if not np.isfinite(phi[s]):
                other = _spread(S, s, c.heading, relatives)
                phi[:] = np.where(np.isfinite(phi), phi, other)

    def agreement(phi: Array) -> float:
        off = [wrap(phi[sensors.index(c.sensor)] - c.heading) / c.sigma for c in cues]
        off += [
            wrap(phi[r.a] - phi[r.b] - r.delta) / r.sigma
            for r in relatives
            if np.isfinite(phi[r.a]) and np.isfinite(phi[r.b])
        ]
        return float(np.sum(np.minimum(np.abs(off), 3.0)))

    return min(candidates, key=agreement)


def _spread(S: int, root: int, heading: float, relatives: list[Relative]) -> Array:
    """Dijkstra with sigma^2 as length: phi (S,) along the most certain paths, NaN where none leads."""
    phi, length = np.full(S, np.nan), np.full(S, np.inf)
    phi[root], length[root] = heading, 0.0
    open_ = set(range(S))
    while open_:
        a = min(open_, key=lambda s: length[s])
        open_.remove(a)
        if not np.isfinite(length[a]):
            break
        for r in relatives:
            if a not in (r.a, r.b):
                continue
            b, delta = (r.b, -r.delta) if a == r.a else (r.a, r.delta)
            if length[a] + r.sigma**2 < length[b]:
                length[b], phi[b] = length[a] + r.sigma**2, phi[a] + delta
    return phi
