"""Reversed or exchanged axes of one sensor, and a unit of its gyroscope that is off by 180/pi.

The test of axes needs no orientation. Over stretches of a few seconds gyr is integrated to R(t), and R(t)
acc(t) is the specific force in a frame that does not turn: gravity, constant, and what the sensor is
accelerated by, which averages out over a second or two because people do not get faster for longer. If
axes of gyr or acc are wrong, gravity seems to wander. Of the 48 signed permutations of the axes (or the
factors pi/180 and 180/pi) the one with which it rests is named. Reversing axes of acc by D is the same to
this test as reversing those of gyr by det(D) D: where both readings are possible, both are said. Reversing
all axes of acc alone cannot be seen without an orientation from elsewhere; nor can axes along which a
sensor that hardly tilts never sees gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations, product

import numpy as np

from mocap import orientation as ori
from mocap.calibration.checks.units import DEG, FASTEST, means, turning
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import Bool

STRETCH_S, HOP_S = 6.0, 1.0  # gyr is integrated this long: a bias of 0.01 rad/s turns it by 3 deg
# Human acceleration averages out; that of a gait, which is in step with its turning, too: half as long, and
# swinging arms look like reversed axes.
MEAN_S = 2.5
MIN_WINDOWS, MAX_WINDOWS = 9, 100  # 14 s: shorter clips are explained by chance
RATE_HZ = 60.0  # about: faster sensors are averaged to it
# Wandering of gravity (mean square over g^2; 3 deg) below which nothing is doubted, and above which it may be
# an error and not only a warning (6 deg).
WANDERS, WANDERS_FAR = 0.003, 0.01
# By how much the mean square must fall with another reading, with all windows and without the eighth that
# tells most; above which it may be an error. Of 268 right sensors (walks, jumping jacks, raised limbs, the
# built-in motion, training clips, pieces of 20 s of two real recordings) none fell by 1.5.
GAIN, GAIN_REST, GAIN_SURE = 2.0, 1.6, 3.0
TELLING = 8
FAST = 20.0  # rad/s: people seldom turn faster
LEAST_TURNING = 0.15  # rad/s, rms: below, gyr is not held against the orientation
AXES = "xyz"


def check_axes(
    name: str, gyr: Array, acc: Array, R: Array | None, ok: Bool, rate_hz: float
) -> list[Finding]:
    """Axes and unit of gyr and acc (T,3) of one sensor, bridged over what is not `ok` (T,).

    Against R (T,3,3), its orientation, where there is one, and against each other.
    """
    if R is not None:
        has = ok & np.isfinite(R).all((-1, -2))
        if has.sum() > rate_hz:
            found = _against_orientation(name, gyr, acc, R, has, rate_hz)
            if found:
                return found
    fast = float(np.percentile(np.linalg.norm(gyr, axis=1), 99.5))
    if fast > FASTEST:
        head = f"sensor {name}: turns at {fast:.0f} rad/s, faster than gyroscopes can measure: "
        return [named(name, head, np.eye(3) * DEG, None, fast)]
    windows = stretches(gyr, acc, ok, rate_hz)
    if windows is None:
        return []
    wanders = _wandering(*windows)
    trials = list(_readings())
    factors = [DEG] if fast > FAST else [1 / DEG] if fast < FASTEST * DEG else []
    for factor in factors:
        trials.append(np.eye(3) * factor)
        wanders = np.vstack([wanders, wandering_if_scaled(windows, factor)])
    better = _better(wanders, trials)
    if better is None:
        return []
    head = (
        f"sensor {name}: carried along by gyr, gravity wanders by {better.before_deg:.0f} deg in acc "
        f"({better.after_deg:.0f} deg if corrected): "
    )
    return [better.told(name, head, None)]


@cache
def _readings() -> tuple[Array, ...]:
    """The 48 signed permutations of three axes, the identity first, simplest next."""
    found = []
    for p in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), p] = signs
            found.append(M)
    return tuple(sorted(found, key=lambda M: 9 - int((np.eye(3) == M).sum())))


@dataclass(frozen=True, eq=False)
class _Better:
    """A reading of the axes with which gravity wanders clearly less; root mean squares in deg."""

    reading: Array
    before_deg: float
    after_deg: float
    sure: bool

    def told(self, name: str, head: str, of: str | None) -> Finding:
        """As `named`, an error only where it is sure."""
        found = named(name, head, self.reading, of, self.before_deg)
        return found if self.sure else replace(found, severity="warning")


def _better(wanders: Array, readings: Sequence[Array]) -> _Better | None:
    """The reading that explains the wandering (H,W), the identity's first; None if it needs none.

    Simple mistakes before others: one axis of gyr or acc, then all of one, then exchanged ones.
    """
    mean = wanders.mean(axis=1)
    kinds = np.array([_mistakes(M) for M in readings])
    best = 0
    for kind, factor in ((1, 1.0), (2, 0.9), (3, 0.7)):
        k = np.flatnonzero(kinds == kind)
        k = k[np.argmin(mean[k])]
        if best == 0 or mean[k] < factor * mean[best]:
            best = int(k)
    order = np.argsort(wanders[0] - wanders[best])
    rest = order[: len(order) - max(1, len(order) // TELLING)]
    least = WANDERS_FAR if kinds[best] == 3 else WANDERS
    if mean[0] < least or mean[0] < GAIN * mean[best]:
        return None
    if wanders[0][rest].mean() < GAIN_REST * wanders[best][rest].mean():
        return None
    before, after = (float(np.degrees(np.sqrt(x))) for x in (mean[0], mean[best]))
    sure = bool(mean[0] > WANDERS_FAR and mean[0] > GAIN_SURE * mean[best])
    return _Better(readings[best], before, after, sure)


def _mistakes(M: Array) -> int:
    """0: none. 1: one axis of gyr or of acc (two of gyr), or its unit. 2: all axes. 3: exchanged axes."""
    diagonal = np.sign(np.diag(M))
    if not np.abs(diagonal).all():
        return 3
    reversed_axes = int((diagonal < 0).sum())
    return {0: int(abs(M[0, 0]) != 1), 1: 1, 2: 1, 3: 2}[reversed_axes]


def stretches(
    gyr: Array, acc: Array, ok: Bool, rate_hz: float, most: int = MAX_WINDOWS
) -> tuple[Array, Array, float] | None:
    """gyr and acc (W,n,3) of the `most` stretches with most turning, and their rate; None if too few."""
    k = max(1, round(rate_hz / RATE_HZ))
    rate = rate_hz / k
    gyr, acc, ok = means(gyr, k), means(acc, k), means(ok[:, None].astype(float), k)[:, 0] > 0.5
    n, hop = round(STRETCH_S * rate), max(1, round(HOP_S * rate))
    starts = np.arange(0, len(gyr) - n + 1, hop)
    starts = np.array([a for a in starts if ok[a : a + n].mean() > 0.9], int)
    if len(starts) < MIN_WINDOWS:
        return None
    turned = np.array([np.linalg.norm(gyr[a : a + n], axis=1).sum() for a in starts])
    frames = starts[np.argsort(-turned, kind="stable")[:most], None] + np.arange(n)
    return gyr[frames], acc[frames], rate


def wandering_if_scaled(windows: tuple[Array, Array, float], factor: float) -> Array:
    """As `_wandering`, (W,), of stretches with gyr multiplied by `factor` and all axes as they are."""
    gyr, acc, rate_hz = windows
    x = np.einsum("pwijj->pwi", _carried(gyr * factor, acc, rate_hz))
    return np.asarray(((x - x.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0) / ori.GRAVITY**2)


def _carried(gyr: Array, acc: Array, rate_hz: float) -> Array:
    """(P,W,3,3,3): means of R[i,j] acc_k over windows of `MEAN_S` at P positions in W stretches (W,n,3).

    R(t), the identity at the beginning of each stretch, is gyr integrated.
    """
    n = round(MEAN_S * rate_hz)
    weight = _hann(n)
    steps = ori.exp(gyr / rate_hz)
    steps[:, 0] = np.eye(3)
    R = np.empty_like(steps)
    R[:, 0] = steps[:, 0]
    for t in range(1, gyr.shape[1]):
        R[:, t] = R[:, t - 1] @ steps[:, t]
    starts = range(0, gyr.shape[1] - n + 1, max(1, n // 4))
    return np.stack([
        np.einsum("t,wtij,wtk->wijk", weight, R[:, a : a + n], acc[:, a : a + n], optimize=True)
        for a in starts
    ])  # fmt: skip


def _wandering(gyr: Array, acc: Array, rate_hz: float) -> Array:
    """Mean square over g^2 of the wandering of mean specific force, (48,W): per reading M of gyr.

    exp([M w]) = M exp(det(M) [w]) M^T for a signed permutation M, so R_M(t) = M R_+-(t) M^T with R_+ from gyr
    and R_- from -gyr. |M x| = |x| leaves R_+-(t) M^T acc, which sums entries of
    means of R_+-[:, j] acc_k: computed once for all readings.
    """
    carried = {sign: _carried(sign * gyr, acc, rate_hz) for sign in (1.0, -1.0)}
    found = []
    for M in _readings():
        x = np.einsum("pwijk,kj->pwi", carried[float(np.round(np.linalg.det(M)))], M)
        found.append(((x - x.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0))
    return np.array(found) / ori.GRAVITY**2


def _against_orientation(
    name: str, gyr: Array, acc: Array, R: Array, has: Bool, rate_hz: float
) -> list[Finding]:
    """gyr against the rate of R_world_sensor, and acc, turned by it, against gravity."""
    found = []
    w, g = turning(gyr, R, has, rate_hz)
    if np.sqrt((w**2).sum(axis=1).mean()) > LEAST_TURNING:
        trials = [*_readings(), np.eye(3) * DEG]
        off = [relative(w, g @ M.T) for M in trials]
        best = int(np.argmin(off))
        if off[0] > 0.4 and off[best] < 0.5 * off[0]:
            head = f"sensor {name}: gyr is not the rate of its orientation ({off[0]:.0%} off): "
            found.append(named(name, head, trials[best], "gyr", off[0]))
    wanders = from_up(R, acc, has, rate_hz)
    better = None if wanders is None else _better(wanders, _readings())
    if better is not None:
        head = (
            f"sensor {name}: turned by its orientation, acc is {better.before_deg:.0f} deg from upright in "
            f"the mean ({better.after_deg:.0f} deg if corrected): "
        )
        found.append(better.told(name, head, "acc"))
    return found


def from_up(
    R: Array, acc: Array, has: Bool, rate_hz: float, least: int = MIN_WINDOWS
) -> Array | None:
    """Square over g^2 of how far mean R M acc is from gravity, (48,W): per reading M of acc.

    Windows of `MEAN_S` whose samples are there; None where there are fewer than `least`.
    """
    n, hop = round(MEAN_S * rate_hz), max(1, round(HOP_S * rate_hz))
    weight = _hann(n)
    starts = [a for a in range(0, len(acc) - n + 1, hop) if has[a : a + n].mean() > 0.9]
    if len(starts) < least:
        return None
    R = np.where(has[:, None, None], np.nan_to_num(R), 0.0)
    means = np.stack([
        np.einsum("t,tij,tk->ijk", weight, R[a : a + n], acc[a : a + n], optimize=True)
        / weight[has[a : a + n]].sum()
        for a in starts
    ])  # fmt: skip
    up = np.array([0.0, ori.GRAVITY, 0.0])
    off = [((np.einsum("wijk,jk->wi", means, M) - up) ** 2).sum(axis=-1) for M in _readings()]
    return np.array(off) / ori.GRAVITY**2


def _hann(n: int) -> Array:
    """Weights (n,) of a mean, sum 1: a periodic motion of two periods or more averages out."""
    weight = np.hanning(n + 2)[1:-1]
    return np.asarray(weight / weight.sum())


def relative(a: Array, b: Array) -> float:
    """|a - b| / |a|."""
    return float(np.sqrt(((a - b) ** 2).sum() / max((a**2).sum(), 1e-12)))


def named(name: str, head: str, M: Array, of: str | None, value: float) -> Finding:
    """The finding for the correction M that fits: `of` gyr or acc, or (None) of either."""
    if abs(abs(M).max() - DEG) < 1e-9:
        return Finding("error", name, "gyr-in-deg", head + "gyr is in deg/s, not rad/s", value)
    if abs(M).max() > 1:
        text = head + "gyr is 180/pi times too small (rad/s that were taken for deg/s)"
        return Finding("error", name, "gyr-unit", text, value)
    diagonal = np.diag(M)
    if not np.abs(diagonal).all():
        order = ", ".join(
            ("-" if M[i].sum() < 0 else "") + AXES[int(np.abs(M[i]).argmax())] for i in range(3)
        )
        what = of or "gyr (against acc)"
        text = head + f"the axes of {what} are exchanged, x, y, z should be its {order}"
        return Finding("error", name, f"{of or 'gyr'}-axes", text, value)
    flipped = [AXES[i] for i in range(3) if diagonal[i] < 0]
    if of is None and len(flipped) == 2:
        # The same as one reversed axis of acc, which is the simpler mistake.
        (kept,) = set(AXES) - set(flipped)
        text = head + f"axis {kept} of acc is reversed (or {' and '.join(flipped)} of gyr)"
        return Finding("error", name, "acc-axes", text, value)
    if len(flipped) == 3:
        what = "all axes of gyr are reversed, or the whole triad is left-handed"
        if of == "acc":
            what = "all axes of acc are reversed: it holds gravity instead of specific force"
        return Finding("error", name, f"{of or 'gyr'}-axes", head + what, value)
    plural = "axis" if len(flipped) == 1 else "axes"
    verb = "is" if len(flipped) == 1 else "are"
    text = head + f"{plural} {' and '.join(flipped)} of {of or 'gyr'} {verb} reversed"
    return Finding("error", name, f"{of or 'gyr'}-axes", text, value)
