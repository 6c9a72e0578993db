"""Motions and recordings on one clock: what they cover together, and the part of one that another covers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from mocap.errors import PoserError

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import Recording

Name = TypeVar("Name", Path, str)
Timed = TypeVar("Timed", "Motion", "Recording")


def span(x: Motion | Recording) -> tuple[float, float]:
    """Time of the first frame and of the end of the last one, s."""
    return x.start_s, x.start_s + x.seconds


def words(x: Motion | Recording) -> str:
    """`46 to 56 s`."""
    return seconds(*span(x))


def seconds(begin: float, end: float) -> str:
    """The same of two times in s."""
    return f"{round(begin, 3):g} to {round(end, 3):g} s"


def cut(x: Timed, begin: float, end: float) -> Timed:
    """The frames from `begin` to before `end`, s, to the nearest frame."""
    a, b = frames(x, begin, end)
    return x if (a, b) == (0, len(x)) else x.slice(a, b)


def frames(x: Motion | Recording, begin: float, end: float) -> tuple[int, int]:
    """The first of the frames from `begin` to before `end`, s, to the nearest, and the one after them."""
    a, b = (round((t - x.start_s) * x.rate_hz) for t in (begin, end))
    return max(0, a), min(len(x), b)


def shared(named: Mapping[Name, Motion | Recording]) -> tuple[float, float]:
    """Begin and end, s, of what all of them cover. Raises PoserError where that is less than a frame."""
    begin = max(span(x)[0] for x in named.values())
    end = min(span(x)[1] for x in named.values())
    if end - begin < (1 - 1e-6) / min(x.rate_hz for x in named.values()):
        covers = ", ".join(f"{path} covers {words(x)}" for path, x in named.items())
        raise PoserError(f"{covers}: they have no time in common")
    return begin, end


def during(motion: Motion, recording: Recording) -> Motion:
    """The part of `motion` at the time of `recording`.

    Raises PoserError where more than a frame of that time is missing.
    """
    begin, end = span(recording)
    frame = (1 + 1e-6) / min(motion.rate_hz, recording.rate_hz)
    first, last = span(motion)
    if first > begin + frame or last < end - frame:
        raise PoserError(
            f"covers {words(motion)}, but {words(recording)} is wanted: --from and --to choose what "
            f"it covers"
        )
    return cut(motion, begin, end)


def placed(motion: Motion, timed: bool, whole: Recording, window: Recording, first: int) -> Motion:
    """The part of `motion` that goes with a window of a recording.

    By its time where that is known (`timed`: its file states one); else of a motion as long as the whole
    recording, the frames from `first` (the window's first) on. A motion of another length is left as it is.
    """
    if timed:
        return during(motion, window)
    if len(window) == len(whole):
        return motion
    motion = motion.resampled(whole.rate_hz)
    if abs(len(motion) - len(whole)) <= 1:
        return motion.slice(first, first + len(window))
    return motion
