"""On whose errors the hybrid's covariance is best fitted: `python benchmarks/covariance.py [--clips N]`.

IMUPoser's errors on the validation clips of a few people. Each person's clips are refined with the covariance
of the other people's errors, with that of motion that the network has learnt from (scaled, see
`training.deviations.pooled`), and with the mean of both; beside them the network and its ten Adam steps.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from common import clips, evenly, machine, row, told
from methods import IMUPOSER_HZ, IMUPOSER_S, Run, imuposer_runs

import hybrid
from learned import checkpoint
from learned.imuposer.adam import AdamEstimator
from learned.imuposer.deviations import imuposer_covariances
from learned.imuposer.model import Imuposer
from learned.imuposer.specification import COMBINATIONS
from learned.registry import specification
from learned.training import deviations
from learned.training.validation import Windowed, cut_for, recordings
from mocap import Motion, dataset, sensors
from mocap.estimator import Estimator, replay
from mocap.evaluation import metrics

NAMES = ("sip_deg", "angular_deg", "position_cm", "global_deg", "instrumented_deg", "jitter")
TRAINING_STEP = 2  # every so many of the training clips


def windows(given: list[dataset.Clip], most: int | None) -> Windowed:
    return cut_for(
        "imuposer", recordings("imuposer", ((c.name, c.motion(None)) for c in given)), most
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clips", type=int, help="evenly over the validation clips (default: all)")
    parser.add_argument("--windows", type=int, help="that a covariance is fitted on")
    parser.add_argument("--weights", type=Path, help="default: the shipped ones")
    args = parser.parse_args()
    print(machine())
    model = checkpoint.load(args.weights or checkpoint.shipped("imuposer"), "imuposer")
    assert isinstance(model, Imuposer)
    held = dataset.select("validation", ("cmu",))
    people = sorted({c.subject for c in held})
    others = {s: windows([c for c in held if c.subject != s], args.windows) for s in people}
    seen = windows(dataset.select("train", ("cmu",))[::TRAINING_STEP], args.windows)
    with torch.inference_mode(False), torch.no_grad():
        learnt = imuposer_covariances(model, seen)
        of = {s: imuposer_covariances(model, w) for s, w in others.items()}
    ways: dict[str, dict[str, list[np.ndarray]]] = {}
    for s in people:
        pairs = [(of[s][k], learnt[k]) for k in range(len(COMBINATIONS))]
        made = {
            "other people": [a for a, _ in pairs],
            "training clips": [c * (a.trace() / c.trace()) for a, c in pairs],
            "both": [deviations.pooled(a, c) for a, c in pairs],
        }
        ways[s] = {way: [deviations.shrunk(c).numpy() for c in C] for way, C in made.items()}
    settings = hybrid.TrackerSettings(**specification("imuposer").tracker)
    found: dict[tuple[str, str], list[list[float]]] = {}

    def tell(s: str, way: str, motion: Motion, run: Run) -> None:
        m = metrics.evaluate(motion, run.truth, recording=run.recording, seen=run.recording.sensors)
        found.setdefault((way, s), []).append([getattr(m, n) for n in NAMES])

    longest = 5.0 + IMUPOSER_S
    tried = evenly(clips("validation", IMUPOSER_HZ, longest), args.clips)
    print(f"validation split, {told(tried)}")
    for i, (name, clip) in enumerate(tried):
        s = dataset.subject_of(name)
        for run in imuposer_runs(name, clip, model):
            network = run.playback(np.eye(72))
            joints = tuple(sensors.lookup(n).joint for n in run.recording.sensors)
            tell(s, "network", run.poses, run)
            refined: dict[str, Estimator] = {"Adam": AdamEstimator(network, joints)} | {
                way: hybrid.Tracker(run.playback(C[run.number]), settings)
                for way, C in ways[s].items()
            }
            for way, estimator in refined.items():
                tell(s, way, replay(estimator, run.recording).motion, run)
        print(f"\r{i + 1}/{len(tried)}   ", end="", file=sys.stderr)
    print(file=sys.stderr)
    widths = (16, 9, *[17] * len(NAMES))
    print(row(("covariance of", "subject", *NAMES), widths))
    for (way, s), values in found.items():
        print(row((way, s, *(f"{x:.2f}" for x in np.mean(values, axis=0))), widths))


if __name__ == "__main__":
    main()
