"""Motion made by formula, free of data and licence: what the demo, the examples and the tests move.

Every piece begins and ends at rest in the N-pose (arms 80 degrees down, feet flat on the floor y = 0),
facing +z, with zero velocity and acceleration, so that pieces join smoothly in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import Skeleton
from mocap.synthesis.posing import Score, bump, plateau, pose, step, step_integral

DEG = np.pi / 180
Piece = Callable[..., Motion]


def stand(seconds: float = 2.0, rate_hz: float = 60.0, skeleton: Skeleton | None = None) -> Motion:
    """The N-pose, still."""
    return pose(Score.blank(seconds, rate_hz), skeleton)


@dataclass(frozen=True)
class _Gait:
    """A straight walk: steps of `period` s, the left foot first, each foot `swing` s in the air."""

    seconds: float
    speed: float = 1.0
    period: float = 0.55
    swing: float = 0.42
    start: float = 0.4
    ramp: float = 1.1

    @property
    def steps(self) -> int:
        return int((self.seconds - self.start - self.swing - 0.4) / self.period) + 1

    def lift_off(self, k: int) -> float:
        return self.start + k * self.period

    def travelled(self, t: Array | float) -> Array:
        """Pelvis path in m: the speed ramps up, holds and ramps down as the last foot lands."""
        stop = self.lift_off(self.steps - 1) + self.swing + 0.15 - self.ramp
        up = step_integral(np.asarray(t - self.start + 0.25) / self.ramp)
        down = step_integral(np.asarray(t - stop) / self.ramp)
        return self.speed * self.ramp * (up - down)

    def foothold(self, k: int) -> float:
        """Where step k lands: under the pelvis at the middle of its stance; the last two side by side."""
        if k >= self.steps - 2:
            return float(self.travelled(self.seconds))
        middle = self.lift_off(k) + (self.swing + 2 * self.period) / 2
        return float(self.travelled(middle))

    def wave(self, t: Array, peak: float, steps: float = 1.0) -> Array:
        """cos with its peak at `peak`, one half turn every `steps` periods."""
        return np.cos(np.pi * (t - peak) / (steps * self.period))


def walk(seconds: float = 6.0, rate_hz: float = 60.0, skeleton: Skeleton | None = None) -> Motion:
    """Walking straight ahead at 1 m/s, arms swinging against the legs. At least 3 s."""
    if seconds < 3:
        raise PoserError(f"walk: needs at least 3 s to start and stop, got {seconds:g} s")
    gait = _Gait(seconds)
    s = Score.blank(seconds, rate_hz)
    last = gait.lift_off(gait.steps - 1) + gait.swing
    on = plateau(s.t, 0.05, 0.7, last + 0.35)
    landed = gait.start + gait.swing  # the left foot, and every second period again
    s.pelvis[:, 2] = gait.travelled(s.t)
    double = gait.start - (gait.period - gait.swing) / 2
    s.pelvis[:, 1] = -on * (0.080 + 0.014 * gait.wave(s.t, double, 0.5))
    s.pelvis[:, 0] = -0.025 * on * gait.wave(s.t, gait.start + gait.swing / 2)
    for k in range(gait.steps):
        foot, off = k % 2, gait.lift_off(k)
        before = gait.foothold(k - 2) if k >= 2 else 0.0
        x = (s.t - off) / gait.swing
        s.toes[:, foot, 2] += (gait.foothold(k) - before) * step(x)
        s.toes[:, foot, 1] += 0.06 * bump(x)
        s.heel[:, foot] += 35 * DEG * bump((s.t - off + 0.2) / (0.2 + 0.75 * gait.swing))
    stride = on * gait.wave(s.t, landed)  # +1: the left leg is in front
    s.turn[:, 1] = -5 * DEG * stride
    s.bend[:, 1] = 11 * DEG * stride
    s.bend[:, 0] = 3 * DEG * on
    for arm, sign in ((0, -1.0), (1, 1.0)):
        s.forward[:, arm] = 22 * DEG * sign * stride
        s.elbow[:, arm] = on * (18 * DEG + 8 * DEG * sign * gait.wave(s.t, landed))
    return pose(s, skeleton)


def squat(seconds: float = 3.0, rate_hz: float = 60.0, skeleton: Skeleton | None = None) -> Motion:
    """One squat with the arms stretched forward for balance."""
    s = Score.blank(seconds, rate_hz)
    down = plateau(s.t, 0.0, 0.45 * seconds, seconds)
    s.pelvis[:, 1] = -0.34 * down
    s.pelvis[:, 2] = -0.15 * down
    s.turn[:, 0] = 22 * DEG * down
    s.bend[:, 0] = 14 * DEG * down
    s.nod[:] = -18 * DEG * down
    s.forward[:] = 95 * DEG * down[:, None]
    s.elbow[:] = 8 * DEG * down[:, None]
    return pose(s, skeleton)


def arm_raises(
    seconds: float = 4.0, rate_hz: float = 60.0, skeleton: Skeleton | None = None
) -> Motion:
    """Both arms sideways to over the shoulders, then forward with the elbows bent, one after the other."""
    s = Score.blank(seconds, rate_hz)
    half = seconds / 2
    side = plateau(s.t, 0.0, 0.45 * half, half)
    s.raised[:] = 130 * DEG * side[:, None]
    s.elbow[:] = 12 * DEG * side[:, None]
    for arm, start in ((0, half), (1, half + 0.25 * half)):
        lift = plateau(s.t, start, 0.34 * half, start + 0.75 * half)
        s.forward[:, arm] += 75 * DEG * lift
        s.elbow[:, arm] += 85 * DEG * lift
        s.bend[:, 1] += (10 if arm else -10) * DEG * lift
    return pose(s, skeleton)


def jumping_jack(
    seconds: float = 4.0, rate_hz: float = 60.0, skeleton: Skeleton | None = None
) -> Motion:
    """Jumping jacks of 1.6 s: feet apart and arms up, and back, about 10 cm off the floor."""
    s = Score.blank(seconds, rate_hz)
    count = int((seconds - 0.4) / 1.6)
    if count < 1:
        raise PoserError(f"jumping_jack: needs at least 2 s, got {seconds:g} s")
    air, half = 0.46, 0.8
    for k in range(2 * count):
        start, opening = 0.2 + k * half, k % 2 == 0
        take_off = start + 0.17
        x = (s.t - take_off) / air
        s.pelvis[:, 1] += 0.10 * bump(x) - 0.07 * bump((s.t - start) / half) * (1 - bump(x))
        apart = 0.17 * (step(x) if opening else -step(x))
        for foot, sign in ((0, 1.0), (1, -1.0)):
            s.toes[:, foot, 0] += sign * apart
            s.toes[:, foot, 1] += 0.08 * bump(x)
            s.heel[:, foot] += 25 * DEG * bump(x)
        arms = step((s.t - start) / half)
        s.raised[:] += 140 * DEG * (arms if opening else -arms)[:, None]
    wide = s.toes[:, 0, 0] / 0.17
    s.pelvis[:, 1] -= 0.03 * wide
    s.elbow[:] = 15 * DEG * wide[:, None]
    return pose(s, skeleton)


def leg_raise(
    seconds: float = 4.0, rate_hz: float = 60.0, skeleton: Skeleton | None = None
) -> Motion:
    """Left, then right knee raised in front of the body while standing on the other leg."""
    s = Score.blank(seconds, rate_hz)
    half = seconds / 2
    for foot, sign in ((0, 1.0), (1, -1.0)):
        start = foot * half
        shift = plateau(s.t, start, 0.4 * half, start + half)
        up = plateau(s.t, start + 0.2 * half, 0.3 * half, start + 0.8 * half)
        s.pelvis[:, 0] += -sign * 0.07 * shift
        s.pelvis[:, 1] += -0.012 * shift
        s.toes[:, foot, 1] += 0.38 * up
        s.toes[:, foot, 2] += 0.26 * up
        s.heel[:, foot] += 20 * DEG * up
        s.bend[:, 2] += sign * 4 * DEG * shift
        s.raised[:] += 20 * DEG * shift[:, None]
        s.elbow[:] += 15 * DEG * up[:, None]
    return pose(s, skeleton)


PROGRAMME: tuple[tuple[Piece, float], ...] = (
    (stand, 2.0),
    (walk, 6.0),
    (squat, 3.0),
    (arm_raises, 4.0),
    (jumping_jack, 3.6),
    (leg_raise, 4.0),
)
"""The pieces of `builtin` and their seconds."""


def joined(pieces: Sequence[Motion]) -> Motion:
    """Pieces one after the other, each beginning where the pelvis of the one before it came to rest."""
    p, at = [], np.zeros(3)
    for m in pieces:
        p.append(m.p_world_root + at)
        # A piece ends one period before it is back at rest; what it travels is the floor's plane only.
        at = at + (m.p_world_root[-1] - m.p_world_root[0]) * [1, 0, 1]
    R = np.concatenate([m.R_parent_joint for m in pieces])
    return Motion(pieces[0].rate_hz, R, np.concatenate(p), pieces[0].skeleton)


def builtin(
    rate_hz: float = 60.0, seconds: float | None = None, skeleton: Skeleton | None = None
) -> Motion:
    """The built-in motion: N-pose, walk, squat, arm raises, jumping jacks, leg raises (22.6 s).

    With `seconds`: the programme, repeated as often as needed, cut to that length.
    """
    total = sum(length for _, length in PROGRAMME)
    wanted = total if seconds is None else float(seconds)
    if wanted <= 0:
        raise PoserError(f"builtin: seconds must be positive, got {wanted:g}")
    pieces: list[Motion] = []
    length = 0.0
    while length < wanted - 1e-9:
        for piece, part in PROGRAMME:
            if length < wanted - 1e-9:
                pieces.append(piece(part, rate_hz, skeleton))
                length += part
    return joined(pieces).slice(0, max(1, round(wanted * rate_hz)))
