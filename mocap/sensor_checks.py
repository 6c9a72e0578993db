"""What one sensor's own data betray: units, reversed or exchanged axes, clipping.

The test of axes needs no orientation. Between two calm moments of a sensor gyr is integrated; gravity,
carried along, must come out as acc has it at the second. A reversed axis, a left-handed triad or a
wrong unit makes the two disagree, and of the 48 signed permutations of the axes (or the factor pi/180)
the one that restores agreement is named. Reversing axes of acc by D is the same to this test as
reversing those of gyr by -det(D) D: where both readings are possible, both are said.
Reversing all axes of acc alone cannot be seen without an orientation from elsewhere.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
from scipy.ndimage import uniform_filter1d

from mocap import orientation as ori
from mocap.findings import Finding
from mocap.fusion import bridged
from mocap.orientation import Array
from mocap.recording import RawRecording

CALM_S = 0.25  # a calm moment: acc hardly changes for this long and is as long as gravity
CALM_ACC = 0.5  # m/s^2
APART_S = 5.0  # calm moments further apart than this are not compared: gyr drifts
MAX_PAIRS, MIN_PAIRS = 40, 5
TURNED = 0.5  # rad of rotation between them, at least, or every reading agrees
DEG = np.pi / 180
# Disagreement of gravity above which a reversed axis is believed; and exchanged axes, of which
# there are so many that one of them fits by chance more easily.
BAD_DEG, BAD_EXCHANGED_DEG = 13.0, 25.0
SURE_DEG = 25.0  # above which it is an error and not only a warning
FAST, FASTEST = 20.0, 60.0  # rad/s: people seldom turn faster; no usual gyroscope measures faster
GOOD_DEG = 8.0  # what a right reading reaches: gyr bias, and acc that is not quite calm
SURE_SIGMAS = 4.0  # of the mean gain of another reading over its windows
GRAVITY_RANGE = (9.3, 10.3)  # m/s^2: more than bias and scale of any usual sensor
RESTLESS = 0.5  # m/s^2: the sensor never rests, so a small excess says nothing
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
    if 8.3 <= g <= 11.3:
        if deviation > RESTLESS:
            return []
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


def _readings() -> list[Array]:
    """The 48 signed permutations of three axes, the identity first, simplest next."""
    found = []
    for p in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), p] = signs
            found.append(M)
    return sorted(found, key=lambda M: 9 - int((np.eye(3) == M).sum()))


def _axes(
    name: str, gyr: Array, acc: Array, ok: np.ndarray, raw: RawRecording, s: int
) -> list[Finding]:
    """Units and axes of gyr, and of acc against it; against R_world_sensor where there is one."""
    readings = _readings()
    if raw.R_world_sensor is not None:
        R = raw.R_world_sensor[:, s]
        has = ok & np.isfinite(R).all((-1, -2))
        if has.sum() > raw.rate_hz:
            return _against_orientation(name, gyr, acc, R, has, raw.rate_hz, readings)
    fast = float(np.percentile(np.linalg.norm(gyr, axis=1), 99.5))
    if fast > FASTEST:
        head = f"sensor {name}: turns at {fast:.0f} rad/s, faster than gyroscopes can measure: "
        return [_named(name, head, np.eye(3) * DEG, None, fast)]
    pairs = _calm_pairs(gyr, acc, ok, raw.rate_hz)
    if pairs is None:
        return []
    dt = 1.0 / raw.rate_hz
    plain = float(_disagreement([np.eye(3)], *pairs, dt)[0])
    if plain < BAD_DEG:
        return []
    trials = [np.eye(3) * DEG] * (fast > FAST) + readings[1:]
    off = _disagreement(trials, *pairs, dt)
    # Of readings that do about equally well, the simplest: they are sorted.
    best = int(np.flatnonzero(off <= 1.15 * off.min() + 0.5)[0])
    doubt = BAD_DEG if np.abs(np.diag(trials[best])).all() else BAD_EXCHANGED_DEG
    if plain < doubt or off[best] > min(0.3 * plain, GOOD_DEG):
        return []
    head = (
        f"sensor {name}: between calm moments gyr turns gravity by {plain:.0f} deg against acc "
        f"({off[best]:.0f} deg if corrected): "
    )
    found = _named(name, head, trials[best], None, plain)
    return [found if plain > SURE_DEG else replace(found, severity="warning")]


def _calm_pairs(
    gyr: Array, acc: Array, ok: np.ndarray, rate_hz: float
) -> tuple[Array, Array, Array] | None:
    """Movements between neighbouring calm moments: gyr (W,n,3), up before and up after (W,3).

    Movements shorter than n are filled up with zero rates. None where there are too few.
    """
    n = max(3, round(CALM_S * rate_hz))
    mean = uniform_filter1d(acc, n, axis=0)
    spread = np.sqrt(np.maximum(uniform_filter1d(acc**2, n, axis=0) - mean**2, 0).sum(axis=1))
    size = np.linalg.norm(mean, axis=1)
    limit = max(CALM_ACC, 2 * float(np.percentile(spread, 5)))
    calm = (spread < limit) & (np.abs(size - np.median(size[spread < limit])) < CALM_ACC) & ok
    frames = np.flatnonzero(calm)
    starts, stops = frames[:-1], frames[1:]
    moved = (stops - starts > n // 2) & (stops - starts < APART_S * rate_hz)
    starts, stops = starts[moved], stops[moved]
    turned = np.array(
        [
            np.linalg.norm(_means(gyr[a:b], n // 2), axis=1).sum()
            for a, b in zip(starts, stops, strict=True)
        ]
    ) * (n // 2 / rate_hz)
    use = np.argsort(turned)[::-1][:MAX_PAIRS]
    use = use[turned[use] > TURNED]
    if len(use) < MIN_PAIRS:
        return None
    longest = int((stops[use] - starts[use]).max())
    rates = np.zeros((len(use), longest, 3))
    for k, (a, b) in enumerate(zip(starts[use], stops[use], strict=True)):
        rates[k, : b - a] = gyr[a + 1 : b + 1]
    up = mean / np.maximum(size, 1e-9)[:, None]
    return rates, up[starts[use]], up[stops[use]]


def _disagreement(
    readings: list[Array], gyr: Array, before: Array, after: Array, dt: float
) -> Array:
    """Angle (H,) in deg between `after` and `before` turned by each reading of gyr (W,n,3).

    The 70th percentile over the movements: not each of them turns about the axis in question.
    """
    angles = []
    for M in readings:
        steps = ori.exp(gyr @ M.T * dt)
        R = np.broadcast_to(np.eye(3), (len(gyr), 3, 3))
        for k in range(gyr.shape[1]):
            R = R @ steps[:, k]
        cos = np.clip(np.einsum("wi,wij,wj->w", before, R, after), -1, 1)
        angles.append(float(np.degrees(np.percentile(np.arccos(cos), 70))))
    return np.array(angles)


def _against_orientation(
    name: str,
    gyr: Array,
    acc: Array,
    R: Array,
    has: np.ndarray,
    rate_hz: float,
    readings: list[Array],
) -> list[Finding]:
    """gyr against the rate of R_world_sensor, acc against its vertical (half-second means)."""
    n = max(1, round(0.5 * rate_hz))
    pair = has[1:] & has[:-1]
    rate = np.zeros_like(gyr)
    rate[1:][pair] = ori.log(np.swapaxes(R[:-1][pair], -1, -2) @ R[1:][pair]) * rate_hz
    quarter = max(1, n // 4)
    found = []
    w, g = (_means(np.where(np.r_[False, pair][:, None], x, 0.0), quarter) for x in (rate, gyr))
    if np.sqrt((w**2).sum(axis=1).mean()) > 0.15:
        off = [_relative(w, g @ M.T) for M in [*readings, np.eye(3) * DEG]]
        best = int(np.argmin(off))
        if off[0] > 0.4 and off[best] < 0.5 * off[0]:
            M = [*readings, np.eye(3) * DEG][best]
            head = f"sensor {name}: gyr is not the rate of its orientation ({off[0]:.0%} off): "
            found.append(_named(name, head, M, "gyr", off[0]))
    up, f = _means(np.where(has[:, None], np.nan_to_num(R[:, 1, :]), 0.0), n), _means(acc, n)
    left = np.array([np.sum((up * ori.GRAVITY - f @ M.T) ** 2, axis=1) for M in readings])
    off = np.sqrt(left.mean(axis=1)) / ori.GRAVITY
    # Of readings that do about equally well, the simplest: they are sorted.
    best = int(np.flatnonzero(off <= 1.1 * off.min())[0])
    if off[best] < 0.85 * off[0] and _steady(left[0] - left[best]):
        head = f"sensor {name}: acc does not point up in its orientation ({off[0]:.0%} off): "
        found.append(_named(name, head, readings[best], "acc", off[0]))
    return found


def _means(x: Array, n: int) -> Array:
    """Means of consecutive blocks of n rows."""
    m = len(x) // n
    return x[: m * n].reshape(m, n, -1).mean(axis=1)


def _steady(gain: Array) -> bool:
    """Whether the mean of gains (W,) lies above zero by `SURE_SIGMAS` of its standard errors."""
    return bool(gain.mean() > SURE_SIGMAS * gain.std(ddof=1) / np.sqrt(len(gain)))


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
