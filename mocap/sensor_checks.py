"""What one sensor's own data betray: units, reversed or exchanged axes, clipping.

The test of axes needs no orientation. Over stretches of a few seconds gyr is integrated to R(t), and R(t)
acc(t) is the specific force in a frame that does not turn: gravity, constant, and what the sensor is
accelerated by, which averages out over a second or two because people do not get faster for longer. If
axes of gyr or acc are wrong, gravity seems to wander. Of the 48 signed permutations of the axes (or the
factor pi/180) the one with which it rests is named. Reversing axes of acc by D is the same to this test
as reversing those of gyr by det(D) D: where both readings are possible, both are said. Reversing all axes
of acc alone cannot be seen without an orientation from elsewhere; nor can axes along which a sensor that
hardly tilts never sees gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations, product

import numpy as np

from mocap import orientation as ori
from mocap.findings import Finding
from mocap.fusion import bridged
from mocap.orientation import Array
from mocap.recording import RawRecording

STRETCH_S, HOP_S = 6.0, 1.0  # gyr is integrated this long: a bias of 0.01 rad/s turns it by 3 deg
# Human acceleration averages out; that of a gait, which is in step with its turning, too: half as long, and
# swinging arms look like reversed axes.
MEAN_S = 2.5
MIN_WINDOWS, MAX_WINDOWS = 9, 100  # 14 s: shorter clips are explained by chance
RATE_HZ = 60.0  # about: faster sensors are averaged to it
DEG = np.pi / 180
# Wandering of gravity (mean square over g^2; 3 deg) below which nothing is doubted, and above which it may be
# an error and not only a warning (6 deg).
WANDERS, WANDERS_FAR = 0.003, 0.01
# By how much the mean square must fall with another reading, with all windows and without the eighth that
# tells most; above which it may be an error. Of 268 right sensors (walks, jumping jacks, raised limbs, the
# built-in motion, training clips, pieces of 20 s of two real recordings) none fell by 1.5.
GAIN, GAIN_REST, GAIN_SURE = 2.0, 1.6, 3.0
TELLING = 8
FAST, FASTEST = 20.0, 60.0  # rad/s: people seldom turn faster; no usual gyroscope measures faster
GRAVITY_RANGE = (9.3, 10.3)  # m/s^2: more than bias and scale of any usual sensor
RESTLESS = 0.35  # m/s^2: above, the sensor never rests; white noise of that size leaves 0.24
RESTLESS_RANGE = (3.0, 25.0)  # m/s^2: what limbs have at their slowest, even in running and jumping
AXES = "xyz"


def check_sensors(raw: RawRecording) -> list[Finding]:
    """All checks of this module, sensor by sensor."""
    found: list[Finding] = []
    for s, name in enumerate(raw.sensors):
        ok = raw.valid[:, s]
        if ok.sum() < raw.rate_hz:
            text = f"sensor {name}: only {int(ok.sum())} valid samples"
            found.append(Finding("error", name, "no-data", text, float(ok.sum())))
            continue
        gyr, acc = bridged(raw.gyr[:, s], ok), bridged(raw.acc[:, s], ok)
        gravity = _gravity(name, gyr, acc)
        found += gravity
        found += _clipping(name, "acc", acc) + _clipping(name, "gyr", gyr)
        if not any(f.severity == "error" for f in gravity):
            found += _axes(name, gyr, acc, ok, raw, s)
    return found


def still_gravity(gyr: Array, acc: Array) -> tuple[float, float]:
    """Median |acc| of the tenth of the samples with the slowest rotation, and its median deviation."""
    rate = np.linalg.norm(gyr, axis=1)
    size = np.linalg.norm(acc[rate <= np.percentile(rate, 10)], axis=1)
    median = float(np.median(size))
    return median, float(np.median(np.abs(size - median)))


def _gravity(name: str, gyr: Array, acc: Array) -> list[Finding]:
    """Is a still sensor's |acc| 9.81, and if not, in which unit would it be?"""
    g, deviation = still_gravity(gyr, acc)
    if GRAVITY_RANGE[0] <= g <= GRAVITY_RANGE[1]:
        return []
    head = f"sensor {name}: a still sensor reads {g:.3g}, expected 9.81 m/s^2: "
    if 0.9 <= g <= 1.1:
        return [Finding("error", name, "acc-in-g", head + "acc is in g, multiply by 9.80665", g)]
    if 930 <= g <= 1030:
        why = "acc is in mg or cm/s^2, divide by 1000/9.80665 or by 100"
        return [Finding("error", name, "acc-unit", head + why, g)]
    if g < 0.6:
        why = "gravity has been removed; the specific force with gravity is needed"
        return [Finding("error", name, "acc-without-gravity", head + why, g)]
    # A sensor that never rests reads more than g, by as much as it is shaken, or less where it falls.
    if deviation > RESTLESS and RESTLESS_RANGE[0] <= g <= RESTLESS_RANGE[1]:
        return []
    if 8.3 <= g <= 11.3:
        why = "bias or scale of its accelerometer is off"
        return [Finding("warning", name, "acc-gravity", head + why, g)]
    return [Finding("error", name, "acc-unit", head + "its unit is unknown", g)]


def _clipping(name: str, what: str, x: Array) -> list[Finding]:
    """Samples that stay at an axis's extreme while the other axes move."""
    worst, limit = 0, 0.0
    for k in range(3):
        for sign in (1.0, -1.0):
            top = float((sign * x[:, k]).max())
            if top <= 1e-3:
                continue
            at = sign * x[:, k] >= top * (1 - 1e-9)
            others = np.abs(np.diff(np.delete(x, k, axis=1), axis=0)).max(axis=1)
            n = int((at[1:] & at[:-1] & (others > 0.02 * top)).sum())
            if n > worst:
                worst, limit = n, top
    if worst < 3:
        return []
    unit = "m/s^2" if what == "acc" else "rad/s"
    text = (
        f"sensor {name}: {what} stays at its limit of {limit:.4g} {unit} for {worst} samples: the "
        f"sensor's range is too small for this motion"
    )
    return [Finding("warning", name, "clipping", text, limit)]


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


def _axes(
    name: str, gyr: Array, acc: Array, ok: np.ndarray, raw: RawRecording, s: int
) -> list[Finding]:
    """Units and axes of gyr and acc, against R_world_sensor where there is one and each other."""
    if raw.R_world_sensor is not None:
        R = raw.R_world_sensor[:, s]
        has = ok & np.isfinite(R).all((-1, -2))
        if has.sum() > raw.rate_hz:
            found = _against_orientation(name, gyr, acc, R, has, raw.rate_hz)
            if found:
                return found
    fast = float(np.percentile(np.linalg.norm(gyr, axis=1), 99.5))
    if fast > FASTEST:
        head = f"sensor {name}: turns at {fast:.0f} rad/s, faster than gyroscopes can measure: "
        return [_named(name, head, np.eye(3) * DEG, None, fast)]
    stretches = _stretches(gyr, acc, ok, raw.rate_hz)
    if stretches is None:
        return []
    wanders = _wandering(*stretches)
    trials = list(_readings())
    if fast > FAST:
        trials.append(np.eye(3) * DEG)
        gyr, acc, rate = stretches
        wanders = np.vstack([wanders, _wandering(gyr * DEG, acc, rate)[:1]])
    better = _better(wanders, trials)
    if better is None:
        return []
    head = (
        f"sensor {name}: carried along by gyr, gravity wanders by {better.before_deg:.0f} deg in acc "
        f"({better.after_deg:.0f} deg if corrected): "
    )
    return [better.told(name, head, None)]


@dataclass(frozen=True, eq=False)
class _Better:
    """A reading of the axes with which gravity wanders clearly less; root mean squares in deg."""

    reading: Array
    before_deg: float
    after_deg: float
    sure: bool

    def told(self, name: str, head: str, of: str | None) -> Finding:
        """As `_named`, an error only where it is sure."""
        found = _named(name, head, self.reading, of, self.before_deg)
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
    return {0: int(abs(M[0, 0]) < 1), 1: 1, 2: 1, 3: 2}[reversed_axes]


def _stretches(
    gyr: Array, acc: Array, ok: np.ndarray, rate_hz: float
) -> tuple[Array, Array, float] | None:
    """gyr and acc (W,n,3) of the stretches with most turning, and their rate; None if too few."""
    k = max(1, round(rate_hz / RATE_HZ))
    rate = rate_hz / k
    gyr, acc, ok = _means(gyr, k), _means(acc, k), _means(ok[:, None].astype(float), k)[:, 0] > 0.5
    n, hop = round(STRETCH_S * rate), max(1, round(HOP_S * rate))
    starts = np.arange(0, len(gyr) - n + 1, hop)
    starts = np.array([a for a in starts if ok[a : a + n].mean() > 0.9], int)
    if len(starts) < MIN_WINDOWS:
        return None
    turning = np.array([np.linalg.norm(gyr[a : a + n], axis=1).sum() for a in starts])
    frames = starts[np.argsort(-turning, kind="stable")[:MAX_WINDOWS], None] + np.arange(n)
    return gyr[frames], acc[frames], rate


def _wandering(gyr: Array, acc: Array, rate_hz: float) -> Array:
    """Mean square over g^2 of the wandering of mean specific force, (48,W): per reading M of gyr.

    exp([M w]) = M exp(det(M) [w]) M^T for a signed permutation M, so R_M(t) = M R_+-(t) M^T with R_+ from gyr
    and R_- from -gyr. |M x| = |x| leaves R_+-(t) M^T acc, which sums entries of
    means of R_+-[:, j] acc_k: computed once for all readings.
    """
    n = round(MEAN_S * rate_hz)
    weight = _hann(n)
    starts = range(0, gyr.shape[1] - n + 1, max(1, n // 4))
    means = {}
    for sign in (1.0, -1.0):
        steps = ori.exp(sign * gyr / rate_hz)
        steps[:, 0] = np.eye(3)
        R = np.empty_like(steps)
        R[:, 0] = steps[:, 0]
        for t in range(1, gyr.shape[1]):
            R[:, t] = R[:, t - 1] @ steps[:, t]
        # (P,W,3,3,3): mean over the window at each of P positions of R[i,j] acc_k.
        means[sign] = np.stack([
            np.einsum("t,wtij,wtk->wijk", weight, R[:, a : a + n], acc[:, a : a + n], optimize=True)
            for a in starts
        ])  # fmt: skip
    found = []
    for M in _readings():
        x = np.einsum("pwijk,kj->pwi", means[float(np.round(np.linalg.det(M)))], M)
        found.append(((x - x.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0))
    return np.array(found) / ori.GRAVITY**2


def _against_orientation(
    name: str,
    gyr: Array,
    acc: Array,
    R: Array,
    has: np.ndarray,
    rate_hz: float,
) -> list[Finding]:
    """gyr against the rate of R_world_sensor, and acc, turned by it, against gravity."""
    pair = has[1:] & has[:-1]
    rate = np.zeros_like(gyr)
    rate[1:][pair] = ori.log(np.swapaxes(R[:-1][pair], -1, -2) @ R[1:][pair]) * rate_hz
    eighth = max(1, round(0.125 * rate_hz))
    found = []
    w, g = (_means(np.where(np.r_[False, pair][:, None], x, 0.0), eighth) for x in (rate, gyr))
    if np.sqrt((w**2).sum(axis=1).mean()) > 0.15:
        trials = [*_readings(), np.eye(3) * DEG]
        off = [_relative(w, g @ M.T) for M in trials]
        best = int(np.argmin(off))
        if off[0] > 0.4 and off[best] < 0.5 * off[0]:
            head = f"sensor {name}: gyr is not the rate of its orientation ({off[0]:.0%} off): "
            found.append(_named(name, head, trials[best], "gyr", off[0]))
    wanders = _from_up(R, acc, has, rate_hz)
    better = None if wanders is None else _better(wanders, _readings())
    if better is not None:
        head = (
            f"sensor {name}: turned by its orientation, acc is {better.before_deg:.0f} deg from upright in "
            f"the mean ({better.after_deg:.0f} deg if corrected): "
        )
        found.append(better.told(name, head, "acc"))
    return found


def _from_up(R: Array, acc: Array, has: np.ndarray, rate_hz: float) -> Array | None:
    """Square over g^2 of how far mean R M acc is from gravity, (48,W): per reading M of acc.

    Windows of `MEAN_S` whose samples are there; None where there are too few.
    """
    n, hop = round(MEAN_S * rate_hz), max(1, round(HOP_S * rate_hz))
    weight = _hann(n)
    starts = [a for a in range(0, len(acc) - n + 1, hop) if has[a : a + n].mean() > 0.9]
    if len(starts) < MIN_WINDOWS:
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


def _means(x: Array, n: int) -> Array:
    """Means of consecutive blocks of n rows."""
    m = len(x) // n
    return x[: m * n].reshape(m, n, -1).mean(axis=1)


def _relative(a: Array, b: Array) -> float:
    return float(np.sqrt(((a - b) ** 2).sum() / max((a**2).sum(), 1e-12)))


def _named(name: str, head: str, M: Array, of: str | None, value: float) -> Finding:
    """The finding for the correction M that fits: `of` gyr or acc, or (None) of either."""
    if abs(abs(M).max() - DEG) < 1e-9:
        return Finding("error", name, "gyr-in-deg", head + "gyr is in deg/s, not rad/s", value)
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
