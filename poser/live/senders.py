"""What a sender does wrong, told from what arrives: findings out, sentences in `sender_words`.

A still sensor sends zeros, for gravity is not in `a`. Where one sends something else, each known mistake says
what that would be (`_predictions`), and the one that fits most sensors is named. Mistakes of the orientation
that leave zeros show when the wearer turns about: the trunk then stays upright under the right reading alone.
A device's clock shows its unit by its pace beside ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap import orientation as ori
from mocap.findings import Finding
from mocap.orientation import Array
from poser.live.assembler import Row

REST_S = 1.0  # still for so long is at rest
STILL_DEG = 6.0  # of a sensor's orientations then from their mean, rms: soft tissue wobbles by 4
LOOK_S = 0.25  # from one look to the next
MOST = 0.7  # m/s^2 of a sound sensor at rest: cheap accelerometers are off by half of it
FAR = 3.0  # m/s^2 that nothing explains away
FIT = 0.2  # of g, or of 1 where the unit is g: how near a mistake's prediction has to be
MOSTLY = 2 / 3  # of the sensors have to agree where the size alone is no proof
ABOUT_DEG = 100.0  # whoever has turned so far has turned about, and not bent
LYING_DEG = 60.0  # of a trunk as it was sent
UPRIGHT_DEG = 20.0  # of the same trunk, read rightly
LEAST_ROWS = 10  # of the 10 a second that are kept
KEPT_S = 60.0
PACE = 5.0  # times as fast as ours, or as slow: no drift, another unit
UNITS = (1e3, 1e6, 1e9)  # ms, us and ns in a s
TRUNK = frozenset(("pelvis", "head", "lower_back", "upper_back", "sternum"))
_UP = np.array([0.0, 1.0, 0.0])
_UNITS = {"m/s^2": ori.GRAVITY, "g": 1.0}


def at_rest(names: Sequence[str], R: Array, acc: Array, up: str) -> list[Finding]:
    """What a = acc (S,3) of still sensors with orientations R (S,3,3) says of their senders.

    Both in the y-up world, as `Row` has them. up: the senders' vertical axis as the receiver was told. NaN in
    `acc`: a sensor that sends none.
    """
    size = np.linalg.norm(acc, axis=1)
    has = np.isfinite(size)
    wrong = has & (size > MOST)
    if not wrong.any():
        return []
    best, what = np.zeros(len(names), bool), ("", "")
    for code, unit, expected in _predictions(R, up):
        g = _UNITS[unit]
        with np.errstate(invalid="ignore"):
            fits = wrong & (np.linalg.norm(acc - g * expected, axis=1) < FIT * g)
        if unit != "g":
            fits &= size > FAR
        elif fits.sum() < MOSTLY * has.sum():
            continue
        if fits.sum() > best.sum():
            best, what = fits, (code, unit)
    found = []
    if best.any():
        found.append(_finding("error", what[0], names, best, has, acc, unit=what[1], up=up))
    left = wrong & ~best & (size > FAR)
    if left.any():
        found.append(_finding("warning", "acc-at-rest", names, left, has, acc))
    return found


def _predictions(R: Array, up: str) -> list[tuple[str, str, Array]]:
    """Code, unit, and what a sensor at rest would send (S,3), in units of g, after the turn to y-up."""
    up_other = np.array([0.0, 0.0, 1.0 if up == "y" else -1.0])
    turn = ori.R_YUP_ZUP if up == "z" else np.eye(3)  # of what was sent
    up_sent = turn.T @ _UP
    sent = turn.T @ R
    force = np.swapaxes(R, -1, -2) @ _UP

    def other(true: Array) -> Array:
        """Of a sender that turns specific force by what it sends instead of by the true orientation."""
        own = np.einsum("sji,j->si", true, up_sent)
        return np.einsum("sij,sj->si", R, own) - _UP

    mistakes = [
        ("gravity-left-in", np.broadcast_to(_UP, force.shape)),
        ("gravity-reversed", np.broadcast_to(-_UP, force.shape)),
        ("other-up-left-in", np.broadcast_to(up_other, force.shape)),
        ("axes-exchanged", np.broadcast_to(up_other - _UP, force.shape)),
        ("sensor-axes", force @ turn.T),
        *((code, other(read(sent))) for code, read in _READINGS.items()),
    ]
    return [(code, unit, found) for unit in _UNITS for code, found in mistakes]


def _xyzw(R: Array) -> Array:
    """What was meant where x, y, z, w was sent and taken for w, x, y, z."""
    return ori.from_quat(ori.to_quat(R), scalar_first=False)


def _transposed(R: Array) -> Array:
    return np.swapaxes(R, -1, -2)


_READINGS = {"quaternion-order": _xyzw, "quaternion-inverse": _transposed}


def turned_about(R: Array, R_rest: Array, up: str) -> list[Finding]:
    """What orientations R (T,S,3,3) of a trunk's sensors say, beside R_rest (S,3,3) of when it stood.

    Turned about, a trunk is as upright as before: R R_rest^T leaves up where it is. Where as it was sent it
    lies, and under another reading every sensor stays upright, that reading is meant.
    """
    turn = ori.R_YUP_ZUP if up == "z" else np.eye(3)
    sent, rest = turn.T @ R, turn.T @ R_rest
    angle = np.degrees(ori.angle_between(R_rest, R))  # the same under every reading
    rows = angle > ABOUT_DEG
    if R.shape[1] < 2 or (rows.sum(axis=0) < LEAST_ROWS).any():
        return []
    if max(_tilts(R, R_rest, _UP, rows)) < LYING_DEG:
        return []
    up_other = np.array([0.0, 0.0, 1.0]) if up == "y" else _UP
    readings = [
        *((code, read(sent), read(rest), turn.T @ _UP) for code, read in _READINGS.items()),
        ("other-up", sent, rest, up_other),
    ]
    fit = [
        code for code, read, at, axis in readings if max(_tilts(read, at, axis, rows)) < UPRIGHT_DEG
    ]
    if not fit:
        return []
    return [Finding("error", None, "trunk-lies", None, {"readings": fit, "up": up})]


def _tilts(R: Array, R_rest: Array, up: Array, rows: NDArray[np.bool_]) -> list[float]:
    """Of each sensor the median angle in deg of R R_rest^T up to up, over its rows."""
    now = np.einsum("tsij,skj,k->tsi", R, R_rest, up)
    tilt = np.degrees(np.arccos(np.clip(now @ up, -1, 1)))
    return [float(np.median(tilt[rows[:, s], s])) for s in range(R.shape[1])]


def clocks(paces: Mapping[str, float | None], refused: int = 0) -> list[Finding]:
    """What clocks say that run `pace` s in one of ours, one finding for all that run alike.

    refused: messages whose time was too large.
    """
    found = [Finding("error", None, "clock-too-large", refused)] if refused >= LEAST_ROWS else []
    alike: dict[float, list[str]] = {}
    for name, pace in paces.items():
        if pace is not None and not 1 / PACE < pace < PACE:
            alike.setdefault(_unit(pace), []).append(name)
    return found + [
        Finding("error", None, "clock-unit", pace, {"sensors": who, "all": len(who) == len(paces)})
        for pace, who in alike.items()
    ]


def _unit(pace: float) -> float:
    """How many of its units of time make a second; of a pace that no unit explains its first two digits."""
    return next((u for u in UNITS if u / 2 < pace < 2 * u), float(f"{pace:.1e}"))


def _finding(
    severity: str, code: str, names: Sequence[str], of: NDArray[np.bool_], has: NDArray[np.bool_],
    acc: Array, **more: str,
) -> Finding:  # fmt: skip
    who = [n for n, is_of in zip(names, of, strict=True) if is_of]
    details = {"sensors": who, "all": bool(of[has].all()), **more}
    size = float(np.median(np.linalg.norm(acc[of], axis=1)))
    return Finding("error" if severity == "error" else "warning", None, code, size, details)


class Watchman:
    """Looks at rows as they come, devices in the order of `names`; tells each finding once.

    trunk: which of them are on pelvis, back, chest or head. up: see `at_rest`.
    """

    def __init__(self, names: Sequence[str], trunk: Sequence[bool], rate_hz: float, up: str = "y"):
        self._names, self._up, self._rate_hz = tuple(names), up, rate_hz
        self._trunk = np.flatnonzero(trunk)
        self._recent: list[Row] = []
        self._kept: list[Array] = []
        self._rest: Array | None = None
        self._seen = 0
        self._judged: set[str] = set()
        self._told: set[str] = set()

    def take(self, row: Row, standing: bool) -> list[Finding]:
        """The next row. standing: the wearer is still waited for to stand in a pose."""
        length = max(3, round(REST_S * self._rate_hz))
        self._recent = [*self._recent[-length + 1 :], row]
        self._seen += 1
        found: list[Finding] = []
        if len(self._trunk) > 1 and self._seen % max(1, round(self._rate_hz / 10)) == 0:
            self._kept.append(row.R_world_sensor[self._trunk])
            del self._kept[: -round(KEPT_S * 10)]
        if self._seen % max(1, round(LOOK_S * self._rate_hz)) == 0 and len(self._recent) == length:
            found = self._at_rest(standing)
        if self._seen % max(1, round(self._rate_hz)) == 0:
            found += self._turned()
        new = [f for f in found if f.code not in self._told]
        self._told.update(f.code for f in new)
        return new

    def _at_rest(self, standing: bool) -> list[Finding]:
        """Of the devices that are heard, once all of them are still; again once another one is heard."""
        valid = np.mean([r.valid for r in self._recent], axis=0) > 0.8
        names = {n for n, is_heard in zip(self._names, valid, strict=True) if is_heard}
        if not names or not (standing or self._rest is None or names - self._judged):
            return []
        R = np.array([r.R_world_sensor for r in self._recent])[:, valid]
        means = np.array([ori.mean(x[np.isfinite(x).all((-1, -2))]) for x in R.swapaxes(0, 1)])
        off = np.degrees(ori.angle_between(means, R))
        if np.sqrt(np.nanmean(off**2, axis=0)).max() > STILL_DEG:
            return []
        rest = np.full((len(self._names), 3, 3), np.nan)
        rest[valid] = means
        self._rest = rest[self._trunk]
        self._judged |= names
        acc = np.array([r.acc_world for r in self._recent])[:, valid]
        acc[:, ~np.isfinite(acc).any(axis=(0, 2))] = 0.0  # sent by none: nothing to judge
        told = [n for n, is_heard in zip(self._names, valid, strict=True) if is_heard]
        return at_rest(told, means, np.nanmedian(acc, axis=0), self._up)

    def _turned(self) -> list[Finding]:
        if self._rest is None or not self._kept:
            return []
        R, heard = np.array(self._kept), np.isfinite(self._rest).all((-1, -2))
        R = R[:, heard]
        whole = np.isfinite(R).all((1, 2, 3))
        return turned_about(R[whole], self._rest[heard], self._up) if whole.any() else []
