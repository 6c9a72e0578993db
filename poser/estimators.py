"""The online methods by name, for a recording's sensors. torch and osqp are imported once one is made."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.errors import PoserError, SensorError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocap.estimator import Estimator
    from mocap.orientation import Array
    from mocap.recording import Recording
    from mocap.skeleton import Skeleton

METHODS = ("dip", "imuposer", "imuposer-adam", "hybrid")
NETWORKS = ("dip", "imuposer")
MOST_DEVICES = 3  # that IMUPoser is trained on at a time
RARE_S = 0.5  # a device that sends more rarely is gone in between
# The hybrid's settings around each network, beside the defaults: what IMUPoser gets wrong changes faster, and
# one to three devices do not tell how spine and pelvis share an error. By validation clips:
# `benchmarks/methods.py --split validation --part imuposer --tracker JSON`.
TRACKER: dict[str, dict[str, Any]] = {
    "dip": {},
    "imuposer": {"step_sigma_deg": 80.0, "spine": False},
}
_EVERYDAY = (("left_wrist", "right_pocket", "head"), ("left_wrist", "right_wrist", "head"))


def stand_in(place: str, sensors: Sequence[str]) -> str | None:
    """The sensor that serves for `place`: itself, or another on the same bone (left_forearm: left_wrist)."""
    from mocap import sensors as places

    if place in sensors:
        return place
    joint = places.lookup(place).joint
    others = (n for n in sensors if n in places.PLACES and places.PLACES[n].joint == joint)
    return next(others, None)


def devices_of(sensors: Sequence[str]) -> tuple[str, ...]:
    """What IMUPoser sees of these where nothing is said: a watch, a phone in a pocket and earphones, else two
    watches and earphones (or sensors on the same bones); else what there is of IMUPoser's five places,
    at most three."""
    from mocap import sensors as places

    for wanted in _EVERYDAY:
        found = tuple(stand_in(n, sensors) for n in wanted)
        if all(found):
            return tuple(f for f in found if f)
    have = {n: s for n in places.FIVE if (s := stand_in(n, sensors))}
    names = list(have)[:MOST_DEVICES]
    if names == ["left_pocket", "right_pocket", "head"]:  # not among IMUPoser's combinations
        names = ["left_pocket", "head"]
    return tuple(have[n] for n in names)


def everyday(sensors: Sequence[str], recording: Recording | None = None) -> tuple[str, ...]:
    """These sensors where IMUPoser can use all that serve it, else `devices_of` them: where nobody chose.

    recording: the one that they are of; without it all are taken for worn at the same time.
    """
    found = used("imuposer", sensors)
    if recording is None:
        fits = len(found) <= MOST_DEVICES
    else:
        fits = trained_on(at_once(found, recording))
    return tuple(sensors) if fits else devices_of(sensors)


def at_once(found: dict[str, str], recording: Recording) -> dict[str, str]:
    """Of `used`, those that the recording has valid at the same time: the most, and of as many those that
    IMUPoser is not trained on.

    A phone that changes pockets is valid in one of them at a time: two columns, one device. Devices whose
    samples take turns in the rows are worn together: each counts until its next sample is due.
    """
    import numpy as np

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


def trained_on(places: Collection[str]) -> bool:
    """Whether IMUPoser is trained on devices at these places together: three at most, and not both pockets
    with the head (its Fig. 3)."""
    return len(places) <= MOST_DEVICES and set(places) != {"left_pocket", "right_pocket", "head"}


def network_of(method: str, network: str | None = None) -> str:
    """dip or imuposer: the network that a method runs; the hybrid's is `network`, dip where nothing is said.

    Raises PoserError for a method or network that is unknown, or a network that is not the method's.
    """
    name, _, own = method.partition("-")
    if method not in (*METHODS, "hybrid-dip", "hybrid-imuposer"):
        raise PoserError(f"method {method!r} unknown; known: {', '.join(METHODS)}")
    if network is not None and network not in NETWORKS:
        raise PoserError(f"network {network!r} unknown; known: {', '.join(NETWORKS)}")
    fixed = own if name == "hybrid" else name
    if fixed and network not in (None, fixed):
        raise PoserError(f"method {method} runs the network {fixed}, not {network}")
    return fixed or network or "dip"


def used(network: str, sensors: Sequence[str]) -> dict[str, str]:
    """Place -> sensor: what the network reads of the sensors there are, in its own order.

    DIP needs all of `six`; IMUPoser takes what there is of `five`. Raises SensorError naming what is missing.
    """
    from mocap import sensors as places

    wanted = places.SIX if network == "dip" else places.FIVE
    found = {p: s for p in wanted if (s := stand_in(p, sensors)) is not None}
    missing = [p for p in wanted if p not in found]
    if network == "dip" and missing:
        raise SensorError(
            f"dip needs {', '.join(wanted)}: there is no {', '.join(missing)}; "
            f"there is: {', '.join(sensors)}"
        )
    if not found:
        raise SensorError(
            f"imuposer needs one to three of {', '.join(wanted)}; there is: {', '.join(sensors)}"
        )
    return found


def served_words(found: Mapping[str, str]) -> list[str]:
    """A sentence for each place that another sensor serves. found: place -> sensor."""
    pairs = found.items()
    return [f"{s} stands in for {p}, which is on the same bone" for p, s in pairs if s != p]


def network_of_weights(path: Path) -> str:
    """dip or imuposer: what the weights of a file are of, by the description beside them.

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


def check_devices(found: dict[str, str], option: str = "--sensors") -> None:
    """IMUPoser's devices as worn all at once (of a recording: `at_once`): raises SensorError where it was not
    trained on them.

    option: the argument that chooses others.
    """
    if not trained_on(found):
        few = len(found) <= MOST_DEVICES
        why = "both pockets and the head together" if few else f"{len(found)} devices"
        raise SensorError(
            f"imuposer is trained on one to three devices at a time, not on {why}: choose with {option}, "
            f"for example {','.join(list(found.values())[:2])}"
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
) -> Estimator:
    """The estimator of a method for samples at `rate_hz`; its `sensors` are those of `sensors` that it reads.

    network: the hybrid's. weights: a file (default: the shipped ones). window: DIP's frames before and
    after (default: 20,5). skeleton: the wearer's body. joint (S,), seat (S,3) m: where `sensors` sit, for the
    hybrid and for Adam (default: the table of places); networks know places by their names alone. IMUPoser
    may be given all five places: it reads those that are valid at the time (`check_devices` is the caller's).
    Raises PoserError where something does not fit.
    """
    which = network_of(method, network)
    found = used(which, sensors)
    if window is not None and which != "dip":
        raise PoserError("a window can be chosen for dip alone; imuposer's is 125 frames")
    from learned import checkpoint, online, runtime
    from learned.models import Dip, Imuposer
    from mocap import sensors as places

    runtime.one_thread()
    model = checkpoint.load(weights or checkpoint.shipped(which), which)
    names, precision = tuple(found.values()), runtime.fastest()
    estimator: Estimator
    if isinstance(model, Dip):
        estimator = online.dip(model, rate_hz, window or (20, 5), names, skeleton, precision)
    else:
        assert isinstance(model, Imuposer)
        place = tuple(places.FIVE.index(p) for p in found)
        estimator = online.imuposer(model, rate_hz, names, place, skeleton, precision)
    if method not in ("imuposer-adam", "hybrid", "hybrid-dip", "hybrid-imuposer"):
        return estimator
    read = [list(sensors).index(n) for n in names]
    table_joint, table_seat = places.joints_and_seats(names)
    joint = table_joint if joint is None else joint[read]
    if method == "imuposer-adam":
        from learned.imuposer.adam import AdamEstimator

        return AdamEstimator(estimator, tuple(joint.tolist()))
    from hybrid import Tracker, TrackerSettings

    seat = table_seat if seat is None else seat[read]
    settings = TrackerSettings(**TRACKER[which])
    return Tracker(estimator, settings, skeleton=skeleton, joint=joint, seat=seat)
