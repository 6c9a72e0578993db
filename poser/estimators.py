"""The online methods by name, for a recording's sensors. torch and osqp are imported once one is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import learned
from learned.registry import specification
from learned.spec import named
from mocap.errors import PoserError, SensorError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocap.estimator import Estimator
    from mocap.orientation import Array
    from mocap.recording import Recording
    from mocap.skeleton import Skeleton

NETWORKS = tuple(learned.NETWORKS)
METHODS = (
    *(
        f"{n}{way}"
        for n, s in learned.NETWORKS.items()
        for way in ("", *(f"-{r}" for r in s.refiners))
    ),
    "hybrid",
)
HYBRIDS = tuple(f"hybrid-{n}" for n in NETWORKS)
FRAMES = tuple(f"frame-{n}" for n in NETWORKS)  # the hybrid without its window
RARE_S = 0.5  # a device that sends more rarely is gone in between


def stand_in(place: str, sensors: Sequence[str]) -> str | None:
    """The sensor that serves for `place`: itself, or another on the same bone (left_forearm: left_wrist)."""
    from mocap import sensors as places

    if place in sensors:
        return place
    joint = places.lookup(place).joint
    others = (n for n in sensors if n in places.PLACES and places.PLACES[n].joint == joint)
    return next(others, None)


def devices_of(network: str, sensors: Sequence[str]) -> tuple[str, ...]:
    """What a network that reads some of its places at a time sees of these where nothing is said: what its
    specification calls everyday (of IMUPoser a watch, a phone in a pocket and earphones, else two watches and
    earphones), or sensors on the same bones; else the first of its places that it is trained on together."""
    spec = specification(network)
    for wanted in spec.everyday:
        found = tuple(stand_in(n, sensors) for n in wanted)
        if all(found):
            return tuple(f for f in found if f)
    have = {n: s for n in spec.places if (s := stand_in(n, sensors))}
    names = list(have)[: spec.most]
    if names and not spec.trained_on(names):  # the last but one is left out first
        parts = [names[:k] + names[k + 1 :] for k in range(len(names) - 2, -1, -1)]
        names = next((part for part in parts if spec.trained_on(part)), names[:1])
    return tuple(have[n] for n in names)


def everyday(
    network: str, sensors: Sequence[str], recording: Recording | None = None
) -> tuple[str, ...]:
    """These sensors where the network can use all that serve it, else `devices_of` them: where nobody chose.

    recording: the one that they are of; without it all are taken for worn at the same time.
    """
    spec = specification(network)
    found = used(network, sensors)
    if recording is None:
        fits = len(found) <= spec.most
    else:
        fits = spec.trained_on(at_once(network, found, recording))
    return tuple(sensors) if fits else devices_of(network, sensors)


def at_once(network: str, found: dict[str, str], recording: Recording) -> dict[str, str]:
    """Of `used`, those that the recording has valid at the same time: the most, and of as many those that
    the network is not trained on.

    A phone that changes pockets is valid in one of them at a time: two columns, one device. Devices whose
    samples take turns in the rows are worn together: each counts until its next sample is due.
    """
    import numpy as np

    trained_on = specification(network).trained_on
    columns = [recording.sensors.index(sensor) for sensor in found.values()]
    worn = np.unique(_spread(recording.ori_valid[:, columns], recording.rate_hz), axis=0)
    sets = [{p: found[p] for p, on in zip(found, row, strict=True) if on} for row in worn]
    return max(sets, key=lambda s: (len(s), not trained_on(s)))


def _spread(valid: NDArray[np.bool_], rate_hz: float) -> NDArray[np.bool_]:
    """valid (T,S), each column's samples lasting as long as they usually lie apart, `RARE_S` at most."""
    import numpy as np

    t = np.arange(len(valid))[:, None]
    last = np.maximum.accumulate(np.where(valid, t, -np.inf), axis=0)
    # Of a column with one sample or none nothing is usual.
    apart = [np.median(np.diff(np.flatnonzero(own))) if own.sum() > 1 else 1.0 for own in valid.T]
    out: NDArray[np.bool_] = t - last < np.minimum(apart, max(1.0, RARE_S * rate_hz))
    return out


def network_of(method: str, network: str | None = None) -> str:
    """The network that a method runs; the hybrid's is `network`, the first where nothing is said.

    Raises PoserError for a method or network that is unknown, or a network that is not the method's.
    """
    name, _, own = method.partition("-")
    if method not in (*METHODS, *HYBRIDS, *FRAMES):
        raise PoserError(f"method {method!r} unknown; known: {', '.join(METHODS)}")
    if network is not None and network not in NETWORKS:
        raise PoserError(f"network {network!r} unknown; known: {', '.join(NETWORKS)}")
    fixed = own if name in ("hybrid", "frame") else name
    if fixed and network not in (None, fixed):
        raise PoserError(f"method {method} runs the network {fixed}, not {network}")
    return fixed or network or NETWORKS[0]


def used(network: str, sensors: Sequence[str]) -> dict[str, str]:
    """Place -> sensor: what the network reads of the sensors there are, in its own order.

    DIP needs all of its six places; IMUPoser takes what there is of its five. Raises SensorError naming what
    is missing.
    """
    spec = specification(network)
    found = {p: s for p in spec.places if (s := stand_in(p, sensors)) is not None}
    missing = [p for p in spec.places if p not in found]
    if spec.needs_all and missing:
        raise SensorError(
            f"{network} needs {', '.join(spec.places)}: there is no {', '.join(missing)}; "
            f"there is: {', '.join(sensors)}"
        )
    if not found:
        raise SensorError(
            f"{network} needs one to {_word(spec.most)} of {', '.join(spec.places)}; "
            f"there is: {', '.join(sensors)}"
        )
    return found


def _word(n: int) -> str:
    return ("no", "one", "two", "three", "four", "five", "six")[n] if n <= 6 else str(n)


def served_words(found: Mapping[str, str]) -> list[str]:
    """A sentence for each place that another sensor serves. found: place -> sensor."""
    pairs = found.items()
    return [f"{s} stands in for {p}, which is on the same bone" for p, s in pairs if s != p]


def network_of_weights(path: Path) -> str:
    """The network that the weights of a file are of, by the description beside them.

    Raises PoserError where one of the two is absent or no such description.
    """
    if not path.exists():
        raise PoserError(f"{path}: no such file")
    if not path.with_suffix(".json").exists():
        raise PoserError(
            f"{path}: its description {path.with_suffix('.json').name} is not beside it; "
            f"poser train --export writes both"
        )
    from learned import checkpoint

    return checkpoint.config_of(path).network


def check_weights(path: Path | None, network: str) -> None:
    """Before anything is read: are they there, with their description, and of the method's network?"""
    if path is not None and (found := network_of_weights(path)) != network:
        raise PoserError(f"{path}: weights of {found}, expected {network}")


def check_devices(network: str, found: dict[str, str], option: str = "--sensors") -> None:
    """The network's devices as worn all at once (of a recording: `at_once`): raises SensorError where it was
    not trained on them.

    option: the argument that chooses others.
    """
    spec = specification(network)
    if not spec.trained_on(found):
        few = len(found) <= spec.most
        why = f"{', '.join(found)} together" if few else f"{len(found)} devices"
        raise SensorError(
            f"{network} is trained on one to {_word(spec.most)} devices at a time, not on {why}: choose with "
            f"{option}, for example {','.join(list(found.values())[:2])}"
        )


def make(
    method: str,
    rate_hz: float,
    sensors: tuple[str, ...],
    *,
    network: str | None = None,
    weights: Path | None = None,
    window: tuple[int, int] | None = None,
    skeleton: Skeleton | None = None,
    joint: NDArray[np.int64] | None = None,
    seat: Array | None = None,
    tracker: Mapping[str, Any] | None = None,
) -> Estimator:
    """The estimator of a method for samples at `rate_hz`; its `sensors` are those of `sensors` that it reads.

    network: the hybrid's. weights: a file (default: the shipped ones). window: frames before and after
    the one answered for, of a network whose window can be chosen (DIP; default: 20,5). skeleton: the
    wearer's body. joint (S,), seat (S,3) m: where `sensors` sit, for the hybrid and for Adam (default:
    the table of places); networks know places by their names alone. tracker: what the hybrid's settings
    (`hybrid.TrackerSettings`) have other than by default. IMUPoser may be given all five
    places: it reads those that are valid at the time (`check_devices` is the caller's). Raises PoserError
    where something does not fit.
    """
    which = network_of(method, network)
    found = used(which, sensors)
    check_window(which, window)
    from learned import runtime
    from mocap import sensors as places

    runtime.one_thread()
    names = tuple(found.values())
    estimator: Estimator = learned.estimator(
        which, rate_hz, names, tuple(found), weights=weights, window=window, skeleton=skeleton
    )
    if method == which:
        return estimator
    read = [list(sensors).index(n) for n in names]
    table_joint, table_seat = places.joints_and_seats(names)
    joint = table_joint if joint is None else joint[read]
    spec, way = specification(which), method.removeprefix(f"{which}-")
    if way in spec.refiners:
        refined: Estimator = named(spec.refiners[way])(estimator, tuple(joint.tolist()))
        return refined
    from hybrid import Tracker, TrackerSettings

    seat = table_seat if seat is None else seat[read]
    changes = {**(tracker or {}), **({"horizon_s": 0.0} if method in FRAMES else {})}
    settings = TrackerSettings.around(estimator, **changes)
    return Tracker(estimator, settings, skeleton=skeleton, joint=joint, seat=seat)


def check_window(network: str, window: tuple[int, int] | None) -> None:
    """Raises PoserError where a window is given and the network's cannot be chosen."""
    spec = specification(network)
    if window is not None and not spec.window_changes:
        free = ", ".join(n for n, s in learned.NETWORKS.items() if s.window_changes)
        frames = sum(spec.window) + 1
        raise PoserError(f"a window can be chosen for {free} alone; {network}'s is {frames} frames")
