"""A motion beside a recording as what is true of it: at the same time, frame for frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mocap import timeline as clock
from mocap.errors import FormatError, PoserError
from poser.console import note

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import Recording

ON_TIME = 1e-3  # of a frame: rounding of times
ROUNDED = 1e-3  # of a rate, as `Frame Time: 0.01667` does
APART_DEG = 45.0  # median angle between bones and sensors of which a motion may be another's


def with_reference(path: Path, recording: Recording, source: Path, motion: Motion) -> Recording:
    """The recording with the motion, of the file `source`, as its reference, brought to its frames.

    By their times where the file states one, else frame 0 on frame 0 of a recording that lasts as long. What
    the motion does not cover is cut off, with a note. Raises PoserError where they have no two frames in
    common.
    """
    from mocap.formats import native

    if not native.states_start(source):
        if len(motion) == len(recording) and abs(motion.rate_hz / recording.rate_hz - 1) < ROUNDED:
            # The same frames: other systems' files round the time of a frame, which adds up.
            motion = replace(motion, rate_hz=recording.rate_hz)
        same_time(
            path, recording, motion, f"{source} does not state its time, so both must last as long"
        )
        motion = replace(motion, start_s=recording.start_s)
    clock.shared({source: motion, path: recording})
    a, b = _covered(recording, motion)
    if b - a < 2:
        raise PoserError(
            f"{source} covers {clock.words(motion)}, {path} {clock.words(recording)}: fewer than two frames "
            f"of the recording are in both"
        )
    kept = recording.slice(a, b)
    if len(kept) < len(recording):
        note(
            f"{path}: of its {clock.words(recording)}, {clock.words(kept)} are in {source} and kept"
        )
    if recording.reference is not None:
        note(f"{path}: the reference motion that it holds is replaced")
    made = replace(kept, reference=_at(motion, kept))
    _note_apart(path, made, source)
    return made


def same_time(path: Path, recording: Recording, reference: Motion, why: str) -> None:
    """Raises FormatError, with `why`, where they differ by more than a frame in length."""
    lasts = [len(x) / x.rate_hz for x in (recording, reference)]
    if abs(lasts[0] - lasts[1]) > 1.5 / min(recording.rate_hz, reference.rate_hz):
        raise FormatError(path, f"lasts {lasts[0]:.2f} s, the reference {lasts[1]:.2f} s: {why}")


def _covered(recording: Recording, motion: Motion) -> tuple[int, int]:
    """The recording's frames from the motion's first frame to its last: the first, and the one after them."""
    import numpy as np

    first, last = (
        (t - recording.start_s) * recording.rate_hz
        for t in (motion.start_s, motion.start_s + (len(motion) - 1) / motion.rate_hz)
    )
    a, b = int(np.ceil(first - ON_TIME)), int(np.floor(last + ON_TIME)) + 1
    return max(0, a), min(len(recording), b)


def _at(motion: Motion, recording: Recording) -> Motion:
    """The motion at the times of a recording's frames."""
    import numpy as np

    at_s = np.arange(len(recording)) / recording.rate_hz + (recording.start_s - motion.start_s)
    made = motion.sampled(at_s, recording.rate_hz)
    return replace(made, start_s=recording.start_s)  # which rounding has left


def _note_apart(path: Path, made: Recording, source: Path) -> None:
    """A note where the motion's bones lie far from what the sensors measured."""
    import numpy as np

    from mocap import orientation as ori

    assert made.reference is not None
    bones, valid = made.reference.R_world_joint[:, made.joint], made.ori_valid
    if not valid.any():
        return
    R = np.swapaxes(bones[valid], -1, -2) @ made.R_world_bone[valid]
    apart = float(np.median(np.rad2deg(np.linalg.norm(ori.log(R), axis=-1))))
    if apart > APART_DEG:
        note(
            f"{path}: its sensors are {apart:.0f} deg (median) from the bones of {source}: is it the motion "
            f"of this recording, and does it face the same way?"
        )
