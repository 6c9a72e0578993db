"""What self-calibration recovers: `python benchmarks/selfcalibration.py`.

Per quantity the root mean square over sensors and clips of what was drawn (the error without calibration)
and of what is left after it, against the length of the recording; then per sensor at full length. A heading
common to all sensors turns the whole person and cannot be seen: headings count relative to their mean.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from common import clips, machine, row, seed_of, told

import sip
from mocap import Motion, sensors, synthesis
from mocap.evaluation import metrics

SECONDS = (2.0, 4.0, 15.0)
QUANTITIES = ("mounting twist deg", "mounting swing deg", "heading deg", "bias m/s^2")
# The long axis of each sensor's bone: rotation about it is twist, the rest swing.
LONG = {"forearm": 0, "shank": 1, "head": 1, "pelvis": 1}


def parts(mounting: np.ndarray, heading: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """(4,S): twist, swing (per axis), heading relative to the mean, in deg, and bias (per axis)."""
    axis = [LONG[name.split("_")[-1]] for name in sensors.SIX]
    twist = np.array([m[a] for m, a in zip(mounting, axis, strict=True)])
    swing = np.array([np.delete(m, a) for m, a in zip(mounting, axis, strict=True)])
    heading = heading - heading.mean()
    return np.stack(
        [
            np.rad2deg(np.abs(twist)),
            np.rad2deg(np.sqrt(np.mean(swing**2, axis=1))),
            np.rad2deg(np.abs(heading)),
            np.sqrt(np.mean(bias**2, axis=1)),
        ]
    )


def one(job: tuple[str, Motion, float]) -> tuple[float, np.ndarray, np.ndarray, list[float]]:
    """Errors (4,S) before and after, and sip_deg and position_cm without and with calibration."""
    name, motion, seconds = job
    motion = motion.slice(0, int(seconds * motion.rate_hz))
    recording = synthesis.recording(motion, sensors.SIX, synthesis.Noise(), seed_of(name))
    plain = sip.solve(recording, settings=sip.Settings(solver="banded"))
    own = sip.solve(recording, settings=sip.Settings(solver="banded", self_calibration=True))
    assert own.sensors is not None
    assert recording.noise is not None
    found = [own.sensors[s] for s in sensors.SIX]
    truth = [
        np.array(recording.noise[k]) for k in ("mounting_rotvec", "heading_mean_rad", "acc_bias")
    ]
    estimate = [
        np.array([f[k] for f in found]) for k in ("mounting_rad", "heading_rad", "bias_mps2")
    ]
    left = [t - e for t, e in zip(truth, estimate, strict=True)]
    scores = [metrics.evaluate(s.motion, motion) for s in (plain, own)]
    return (
        seconds,
        parts(*truth),
        parts(*left),
        [v for m in scores for v in (m.sip_deg, m.position_cm)],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="validation", choices=("validation", "test"))
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    found = clips(args.split)
    jobs = [(n, m, s) for s in SECONDS for n, m in found if m.seconds >= s or s == SECONDS[-1]]
    with ProcessPoolExecutor(args.jobs) as pool:
        results = []
        for i, r in enumerate(pool.map(one, jobs)):
            results.append(r)
            print(f"\r{i + 1}/{len(jobs)}", end="", file=sys.stderr)
    print(file=sys.stderr)
    print(machine())
    print(f"{args.split} split, {told(found)}")
    widths = (9, 7, *[22] * 4, 16, 16)
    heads = (*QUANTITIES, "sip_deg", "position_cm")
    print(row(("seconds <=", "clips", *heads), widths))
    for seconds in SECONDS:
        mine = [r for r in results if r[0] == seconds]
        rms = [np.sqrt(np.mean([r[k] ** 2 for r in mine], axis=(0, 2))) for k in (1, 2)]
        scores = np.mean([r[3] for r in mine], axis=0)
        cells = [f"{a:.2f} -> {b:.2f}" for a, b in zip(*rms, strict=True)]
        cells += [f"{scores[0]:.1f} -> {scores[2]:.1f}", f"{scores[1]:.1f} -> {scores[3]:.1f}"]
        print(row((f"{seconds:g}", len(mine), *cells), widths))
    print("\nper sensor, full length")
    print(row(("", "", *QUANTITIES), widths))
    mine = [r for r in results if r[0] == SECONDS[-1]]
    before, after = (np.sqrt(np.mean([r[k] ** 2 for r in mine], axis=0)) for k in (1, 2))
    for s, name in enumerate(sensors.SIX):
        cells = [f"{before[q, s]:.2f} -> {after[q, s]:.2f}" for q in range(4)]
        print(row((name[:9], "", *cells), widths))


if __name__ == "__main__":
    main()
