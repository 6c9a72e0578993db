"""Where `poser solve` starts: the prior, a network's poses, or a motion file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import learned
from mocap.errors import PoserError
from poser import files
from poser.console import UsageError, progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mocap.estimator import Replay
    from mocap.motion import Motion
    from mocap.recording import Recording
    from mocap.skeleton import Skeleton
    from sip import PoseBelief, Settings, Start

NETWORKS = tuple(learned.NETWORKS)
KNOWN = ("prior", "horizon", *NETWORKS)


def names(text: str) -> list[str]:
    """The starts that --start names. A file whose name holds a comma is one start. UsageError if none."""
    if text in KNOWN or Path(text).exists():
        return [text]
    found = [part.strip() for part in text.split(",")]
    if not all(found):
        raise UsageError(f"argument --start: an empty name in {text!r}")
    return list(dict.fromkeys(found))


def motions(
    names: Sequence[str],
    path: Path,
    whole: Recording,
    window: Recording,
    first: int,
    body: Skeleton,
    settings: Settings,
) -> dict[str, Start]:
    """The starts of these names: "horizon" is two, forward and backward in time, beside the prior."""
    found: dict[str, Start] = {}
    for name in names:
        if name == "horizon":
            import sip

            with progress(f"horizon on {path.name}") as tell, files.about(path):
                found |= {"prior": "prior", **sip.passes(window, body, settings, tell)}
        else:
            found[name] = motion(name, path, whole, window, first, body)
    return found


def motion(
    name: str, path: Path, whole: Recording, window: Recording, first: int, body: Skeleton
) -> Start:
    """What the solver takes for one name: "prior", or poses for every frame of `window`.

    path: where the recording `whole` came from. first: the number of the window's first frame in it.
    """
    if name == "prior":
        return "prior"
    if name in NETWORKS:
        return _tracked(name, path, window).motion.on(body)
    return _of_file(Path(name), whole, window, first)


def network(sensors: Sequence[str]) -> str:
    """The network that knows these sensors: dip where it has all of `six`, else imuposer."""
    from mocap import sensors as places
    from poser.estimators import stand_in

    return "dip" if all(stand_in(place, sensors) for place in places.SIX) else "imuposer"


def belief(name: str, path: Path, window: Recording) -> PoseBelief:
    """What a network says of every frame of `window`, and how sure it is; path: where it came from."""
    import sip

    if not learned.specification(name).needs_all:
        from poser.estimators import everyday

        window = window.select(everyday(name, window.sensors, window))
    found = _tracked(name, path, window)
    if found.covariance is None:
        raise PoserError(f"{path}: {name} does not say how sure it is of each frame")
    return sip.PoseBelief(found.motion.R_parent_joint, found.covariance)


def _tracked(name: str, path: Path, window: Recording) -> Replay:
    """A network's poses for a recording that came from `path`."""
    from poser import tracking

    with progress(f"{name} on {path.name}") as tell, files.about(path):
        return tracking.track(window, name, name, progress=tell).run


def _of_file(path: Path, whole: Recording, window: Recording, first: int) -> Motion:
    """A motion file at the recording's rate: by its time where it states one, else of the whole recording or
    of the window.
    """
    from mocap import timeline
    from mocap.formats import native

    found, frames = files.motion(path).resampled(whole.rate_hz), len(window)
    with files.about(path):
        found = timeline.placed(found, native.states_start(path), whole, window, first)
    if len(found) != frames:
        raise PoserError(
            f"{path}: {len(found)} frames at {whole.rate_hz:g} Hz, expected as many as the "
            f"recording has: {frames}"
        )
    return found
