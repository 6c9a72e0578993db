"""Hours of input through the tracker: `python benchmarks/endurance.py --hours 10 -o state.pickle`.

The built-in motion in a loop, six sensors at 60 Hz, the stand-in network of `qp.py`, and trouble all the
time: the realistic noise's losses, and now and then NaN, an unplugged sensor, two exchanged ones, zero
matrices, a jump of the clock. Counts frames without a usable pose (the goal is none). With -o the state is
saved every minute of input, and a later call goes on from there.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from qp import StandIn

from hybrid import Tracker
from mocap import Recording, sensors, synthesis
from mocap import orientation as ori
from mocap.estimator import Pose, Sample, samples
from mocap.formats._files import write_aside
from poser import motions

RATE_HZ = 60.0
TROUBLES = ("nan", "unplugged", "exchanged", "zero", "clock")
EVERY_S, LASTS_S = 7.0, 0.5


class Looped(StandIn):
    """The stand-in over a motion that repeats."""

    def step(self, state: int, sample: Sample) -> tuple[int, Pose | None]:
        """The pose of this frame, modulo the motion's length."""
        _, pose = super().step(state % len(self._R), sample)
        return state + 1, pose


def troubled(rows: list[Sample], first: int) -> Iterator[Sample]:
    """Endless samples from frame `first` on; what is broken depends on the frame alone."""
    every, lasts = int(EVERY_S * RATE_HZ), int(LASTS_S * RATE_HZ)
    k = first
    while True:
        sample = rows[k % len(rows)]
        R, acc, t = np.array(sample.R_world_bone), np.array(sample.acc_world), k / RATE_HZ
        valid = sample.valid
        episode, at = divmod(k, every)
        s = episode % len(R)
        kind = TROUBLES[episode % len(TROUBLES)] if at < lasts else ""
        if kind == "nan":
            R[s], acc[s] = np.nan, np.nan
        elif kind == "unplugged":
            valid = valid & (np.arange(len(R)) != s)
        elif kind == "exchanged":
            R[[s, s - 1]], acc[[s, s - 1]] = R[[s - 1, s]], acc[[s - 1, s]]
        elif kind == "zero":
            R[:], acc[:] = 0, 0
        elif kind == "clock":
            t += 3.0
        yield replace(sample, time_s=t, R_world_bone=R, acc_world=acc, valid=valid)
        k += 1


def usable(pose: Pose | None) -> bool:
    """Finite and orthonormal."""
    return (
        pose is not None
        and bool(np.isfinite(pose.p_world_root).all())
        and bool(ori.is_rotation(pose.R_parent_joint, 1e-6).all())
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("-o", "--output", type=Path, help="where the state is kept")
    args = parser.parse_args()
    truth = motions.builtin(RATE_HZ)
    recording: Recording = synthesis.recording(truth, sensors.SIX, synthesis.Noise(), 0)
    tracker = Tracker(Looped(truth, sensors.SIX))
    done, missing, state = 0, 0, tracker.init()
    if args.output and args.output.exists():
        # Our own file: whoever passes another one runs what is in it.
        done, missing, state = pickle.loads(args.output.read_bytes())
    began, before, total = time.perf_counter(), done, round(args.hours * 3600 * RATE_HZ)
    minute = int(60 * RATE_HZ)
    stream = troubled(list(samples(recording)), done)
    while done < total:
        state, pose = tracker.step(state, next(stream))
        missing += not usable(pose)
        done += 1
        if done % minute == 0 and args.output:
            with write_aside(args.output) as path:
                Path(path).write_bytes(pickle.dumps((done, missing, state)))
            print(f"\r{done / minute:.0f} min, {missing} without a pose", end="", file=sys.stderr)
    seconds = time.perf_counter() - began
    print(f"{done} frames ({done / RATE_HZ / 3600:.2f} h), {missing} without a usable pose")
    print(f"{1e3 * seconds / max(done - before, 1):.3f} ms per frame in this run")
    print(json.dumps(dict(state.counts), indent=1))


if __name__ == "__main__":
    main()
