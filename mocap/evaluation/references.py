"""A motion beside a recording as what is true of it: at the same time, frame for frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from mocap import timeline
from mocap.errors import PoserError
from mocap.findings import Finding
from mocap.motion import Motion
from mocap.recording import Recording

ON_TIME = 1e-3  # of a frame: rounding of times
ROUNDED = 1e-3  # of a rate, as `Frame Time: 0.01667` does
APART_DEG = 45.0  # median angle between bones and sensors of which a motion may be another's


def with_reference(
    recording: Recording, motion: Motion, timed: bool = True, source: str = "the motion"
) -> tuple[Recording, list[Finding]]:
    """The recording with the motion as its reference, brought to its frames, and what is worth knowing of it.

    timed: the motion's `start_s` is on the recording's clock; else frame 0 lies on frame 0 of a recording
    that lasts as long. source: what errors and findings call the motion. What it does not cover is cut off.
    Findings: "reference-cut", "reference-replaced", "reference-apart". Raises PoserError where they have no
    two frames in common, or last differently and are not timed.
    """
    if not timed:
        if len(motion) == len(recording) and abs(motion.rate_hz / recording.rate_hz - 1) < ROUNDED:
            # The same frames: other systems' files round the time of a frame, which adds up.
            motion = replace(motion, rate_hz=recording.rate_hz)
        same_time(recording, motion, f"{source} does not state its time, so both must last as long")
        motion = replace(motion, start_s=recording.start_s)
    timeline.shared({source: motion, "the recording": recording})
    a, b = _covered(recording, motion)
    if b - a < 2:
        raise PoserError(
            f"{source} covers {timeline.words(motion)}, the recording {timeline.words(recording)}: fewer "
            f"than two frames of the recording are in both"
        )
    kept = recording.slice(a, b)
    found = []
    if len(kept) < len(recording):
        details = {"of": timeline.span(recording), "kept": timeline.span(kept), "source": source}
        found.append(Finding("warning", None, "reference-cut", float(len(kept)), details))
    if recording.reference is not None:
        found.append(Finding("warning", None, "reference-replaced"))
    made = replace(kept, reference=_at(motion, kept))
    return made, found + _apart(made, source)


def same_time(recording: Recording, reference: Motion, why: str) -> None:
    """Raises PoserError, with `why`, where they differ by more than a frame in length."""
    lasts = [len(x) / x.rate_hz for x in (recording, reference)]
    if abs(lasts[0] - lasts[1]) > 1.5 / min(recording.rate_hz, reference.rate_hz):
        raise PoserError(f"lasts {lasts[0]:.2f} s, the reference {lasts[1]:.2f} s: {why}")


def _covered(recording: Recording, motion: Motion) -> tuple[int, int]:
    """The recording's frames from the motion's first frame to its last: the first, and the one after them."""
    first, last = (
        (t - recording.start_s) * recording.rate_hz
        for t in (motion.start_s, motion.start_s + (len(motion) - 1) / motion.rate_hz)
    )
    a, b = int(np.ceil(first - ON_TIME)), int(np.floor(last + ON_TIME)) + 1
    return max(0, a), min(len(recording), b)


def _at(motion: Motion, recording: Recording) -> Motion:
    """The motion at the times of a recording's frames."""
    at_s = np.arange(len(recording)) / recording.rate_hz + (recording.start_s - motion.start_s)
    made = motion.sampled(at_s, recording.rate_hz)
    return replace(made, start_s=recording.start_s)  # which rounding has left


def _apart(made: Recording, source: str) -> list[Finding]:
    """A warning where the motion's bones lie far from what the sensors measured."""
    assert made.reference is not None
    bones, valid = made.reference.R_world_joint[:, made.joint], made.ori_valid
    if not valid.any():
        return []
    R = np.swapaxes(bones[valid], -1, -2) @ made.R_world_bone[valid]
    apart = float(np.median(np.rad2deg(np.linalg.norm(ori.log(R), axis=-1))))
    if apart <= APART_DEG:
        return []
    return [
        Finding("warning", None, "reference-apart", apart, {"apart_deg": apart, "source": source})
    ]
