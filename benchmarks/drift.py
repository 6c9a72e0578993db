"""A long session without magnetometer: `python benchmarks/drift.py [--minutes 10] [--deg-s 0.1,0.3]`.

Test motion is played forwards and backwards in a loop, six virtual sensors with the realistic noise. Each
heading then drifts at a rate of its own, at most as fast as said, and each bias walks at random. Rows: the
hybrid around DIP with and without the sensors' constants as states; errors in the first and the last minute,
and the largest heading that is left in, relative to their mean.
"""

from __future__ import annotations

import argparse
import sys
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from common import clips, evenly, machine, row

from hybrid import Tracker, TrackerSettings
from mocap import Motion, dataset, sensors, synthesis
from mocap import orientation as ori
from mocap.estimator import samples
from mocap.evaluation import metrics
from mocap.recording import Recording

RATE_HZ = 60.0
BIAS_WALK = 0.01  # m/s^2 in a second, growing with the root of time


def looped(split: dataset.Split, count: int, seconds: float) -> Motion:
    """Motion of some clips, each forwards and backwards, until there is enough."""
    R, p, found = [], [], [m for _, m in evenly(clips(split, RATE_HZ, 6.0), count)]
    T, k = 0, 0
    while seconds * RATE_HZ > T:
        m = found[k % len(found)]
        there = np.r_[0 : len(m), len(m) - 1 : 0 : -1]
        R.append(m.R_parent_joint[there])
        p.append(m.p_world_root[there])
        T, k = T + len(there), k + 1
    whole = Motion(RATE_HZ, np.concatenate(R), np.concatenate(p), found[0].skeleton)
    return whole.slice(0, round(seconds * RATE_HZ))


def drifting(recording: Recording, deg_s: float, seed: int) -> tuple[Recording, np.ndarray]:
    """The recording with headings that drift, and these (T,S) rad."""
    rng = np.random.default_rng(seed)
    T, S = recording.valid.shape
    time_s = np.arange(T) / RATE_HZ
    heading = np.deg2rad(deg_s) * rng.uniform(-1, 1, size=S) * time_s[:, None]
    turn = ori.rot_y(heading)
    walk = rng.normal(size=(T, S, 3)).cumsum(axis=0) * BIAS_WALK / np.sqrt(RATE_HZ)
    biased = recording.acc_world + (recording.R_world_bone @ walk[..., None])[..., 0]
    return replace(
        recording,
        R_world_bone=turn @ recording.R_world_bone,
        acc_world=(turn @ biased[..., None])[..., 0],
    ), heading


def one(job: tuple[Motion, float, bool, int]) -> str:
    """A row of the table."""
    from poser.estimators import make

    motion, deg_s, constants, seed = job
    noisy = synthesis.recording(motion, sensors.SIX, synthesis.NOISES["realistic"], seed)
    recording, heading = drifting(noisy, deg_s, seed)
    network = make("dip", RATE_HZ, sensors.SIX)
    base = TrackerSettings.around(network)
    tracker = Tracker(network, replace(base, cost=replace(base.cost, self_calibration=constants)))
    state, minute = tracker.init(), round(60 * RATE_HZ)
    poses: dict[str, deque] = {"first": deque(maxlen=minute), "last": deque(maxlen=minute)}
    for sample in samples(recording):
        state, pose = tracker.step(state, sample)
        if pose is not None:
            if len(poses["first"]) < minute:
                poses["first"].append(pose)
            poses["last"].append(pose)
    cells: list[str] = []
    for part in poses.values():
        R = np.stack([q.R_parent_joint for q in part])
        p = np.stack([q.p_world_root for q in part])
        first = round(part[0].time_s * RATE_HZ)
        truth = motion.slice(first, first + len(part))
        m = metrics.evaluate(Motion(RATE_HZ, R, p, truth.skeleton, truth.start_s), truth)
        cells += [f"{m.sip_deg:.1f} / {m.angular_deg:.1f} / {m.position_cm:.1f}"]
    left = "-"
    if constants:
        found = np.array([tracker.facts(state)["heading_deg"][n] for n in sensors.SIX])
        apart = np.rad2deg(heading[-1]) - found
        left = f"{np.abs(apart - apart.mean()).max():.1f}"
    return row((deg_s, "states" if constants else "zero", *cells, left), WIDTHS)


WIDTHS = (8, 10, 22, 22, 18)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--deg-s", default="0,0.1,0.3", help="largest drift of a heading")
    parser.add_argument("--split", default="test", choices=("validation", "test"))
    parser.add_argument("--clips", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    print(machine())
    motion = looped(args.split, args.clips, 60 * args.minutes)
    rates = [float(x) for x in args.deg_s.split(",")]
    jobs = [(motion, rate, constants, args.seed) for rate in rates for constants in (True, False)]
    print(f"{args.minutes:g} minutes; sip_deg / angular_deg / position_cm")
    print(row(("deg/s", "constants", "first minute", "last minute", "heading left, deg"), WIDTHS))
    with ProcessPoolExecutor(args.jobs) as pool:
        for line in pool.map(one, jobs):
            print(line, flush=True)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
