"""Hours of input through the tracker: `python benchmarks/endurance.py --hours 10 -o state.pickle`.

The built-in motion in a loop and trouble all the time: the realistic noise's losses, and now and then NaN, an
unplugged sensor, two exchanged ones, zero matrices, a jump of the clock. --network stand-in (that of `qp.py`)
or dip: six sensors at 60 Hz; imuposer: three devices at 25 Hz. Counts frames without a usable pose (the goal
is none) and fallbacks by reason, and tells resident memory each tenth of the way. With -o the state is saved
every minute of input, and a later call goes on from there. --horizon 0:
the single frame instead of the window.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import resident_mb
from qp import StandIn

from hybrid import Tracker, TrackerSettings
from mocap import Recording, sensors, synthesis
from mocap import orientation as ori
from mocap.estimator import Estimator, Pose, Sample, samples
from mocap.formats._files import write_aside
from mocap.synthesis import motions
from poser.estimators import devices_of, make

TROUBLES = ("nan", "unplugged", "exchanged", "zero", "clock")
EVERY_S, LASTS_S = 7.0, 0.5


class Looped(StandIn):
    """The stand-in over a motion that repeats."""

    def step(self, state: int, sample: Sample) -> tuple[int, Pose | None]:
        """The pose of this frame, modulo the motion's length."""
        _, pose = super().step(state % len(self._R), sample)
        return state + 1, pose


def troubled(rows: list[Sample], rate_hz: float, first: int) -> Iterator[Sample]:
    """Endless samples from frame `first` on; what is broken depends on the frame alone."""
    every, lasts = int(EVERY_S * rate_hz), int(LASTS_S * rate_hz)
    k = first
    while True:
        sample = rows[k % len(rows)]
        R, acc, t = np.array(sample.R_world_bone), np.array(sample.acc_world), k / rate_hz
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
    parser.add_argument("--network", default="stand-in", choices=("stand-in", "dip", "imuposer"))
    parser.add_argument("--horizon", type=float, help="s, of the window (default: the tracker's)")
    parser.add_argument("-o", "--output", type=Path, help="where the state is kept")
    args = parser.parse_args()
    rate, names = (
        (25.0, devices_of("imuposer", sensors.FIVE))
        if args.network == "imuposer"
        else (60.0, sensors.SIX)
    )
    truth = motions.builtin(rate)
    recording: Recording = synthesis.recording(truth, names, synthesis.Noise(), 0)
    changes = {} if args.horizon is None else {"horizon_s": args.horizon}
    tracker: Estimator = (
        Tracker(Looped(truth, names), TrackerSettings(**changes))
        if args.network == "stand-in"
        else make("hybrid", rate, names, network=args.network, tracker=changes)
    )
    done, missing, state = 0, 0, tracker.init()
    if args.output and args.output.exists():
        # Our own file: whoever passes another one runs what is in it.
        done, missing, state = pickle.loads(args.output.read_bytes())
    before, total = done, round(args.hours * 3600 * rate)
    minute, tenth = int(60 * rate), max(1, total // 10)
    stream = troubled(list(samples(recording)), rate, done)
    ms: deque[float] = deque(maxlen=100_000)
    while done < total:
        sample = next(stream)
        began = time.perf_counter()
        state, pose = tracker.step(state, sample)
        ms.append(1e3 * (time.perf_counter() - began))
        missing += done >= tracker.look_ahead_frames and not usable(pose)
        done += 1
        if done % tenth == 0 or done == before + minute:
            print(f"{done / rate / 3600:.2f} h: {resident_mb():.1f} MB", flush=True)
        if done % minute == 0 and args.output:
            with write_aside(args.output) as path:
                Path(path).write_bytes(pickle.dumps((done, missing, state)))
    print(f"{done} frames ({done / rate / 3600:.2f} h), {missing} without a usable pose")
    if ms:
        print(
            f"{np.median(ms):.2f} ms a frame, p99 {np.percentile(ms, 99):.2f}, the latest {len(ms)}"
        )
    print(json.dumps(dict(state.counts), indent=1))


if __name__ == "__main__":
    main()
