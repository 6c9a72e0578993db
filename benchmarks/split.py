"""Accuracy on the fixed split: `python benchmarks/split.py [--split test] [-o results.json]`.

The first 15 s of every clip of the split with 2 s or more of trusted motion (`common.clips`), 60 Hz, six
virtual sensors; clean and with the realistic noise. SOP and SIP differ in the acceleration term alone.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import clips, keep, machine, row, seed_of, told

import sip
from mocap import Motion, dataset, sensors, synthesis
from mocap.evaluation import metrics, noskill
from sip.prior import shipped

NAMES = ("sip_deg", "angular_deg", "position_cm", "root_deg", "jitter", "jitter_reference")
METHODS = (
    "mean-pose", "nearest-pose", "sop", "sip", "sip+calibration", "sip from truth", "sip from dip",
)  # fmt: skip


def solved(
    method: str, recording: synthesis.Recording, truth: Motion, solver: str
) -> tuple[Motion, dict[str, float]]:
    """The motion that a method makes of a recording; of a solve, its cost, iterations and seconds."""
    prior = shipped()
    if method == "mean-pose":
        return noskill.mean_pose(recording, prior.mean), {}
    if method == "nearest-pose":
        return noskill.nearest_pose(recording, prior.poses), {}
    settings = sip.Settings(terms="sop" if method == "sop" else "sip", solver=solver)
    if method == "sip+calibration":
        settings = replace(settings, self_calibration=True)
    if method == "sip from truth":
        settings = replace(settings, start=truth)
    if method == "sip from dip":
        from poser.tracking import track

        settings = replace(settings, start=track(recording, "dip", "dip").run.motion)
    found = sip.solve(recording, settings=settings)
    solve = {
        "cost": sum(found.cost.values()), "iterations": found.iterations, "seconds": found.seconds,
    }  # fmt: skip
    return found.motion, solve


def one(job: tuple[str, Motion, str, str, str]) -> dict[str, object]:
    """Metrics of one clip, noise and method."""
    name, motion, noise, method, solver = job
    recording = synthesis.recording(motion, sensors.SIX, synthesis.NOISES[noise], seed_of(name))
    found, solve = solved(method, recording, motion, solver)
    m = metrics.evaluate(found, motion)
    figures = {k: getattr(m, k) for k in NAMES}
    return {"clip": name, "noise": noise, "method": method} | figures | solve


def table(results: list[dict[str, object]], noise: str) -> str:
    """Means over clips, and per subject."""
    widths = (16, 8, *[12] * len(NAMES))
    out = [row(("method", "clips", *NAMES), widths)]
    rows = [r for r in results if r["noise"] == noise]
    subjects = sorted({dataset.subject_of(str(r["clip"])) for r in rows})
    for method in dict.fromkeys(str(r["method"]) for r in rows):
        mine = [r for r in rows if r["method"] == method]
        for label, part in [(method, mine)] + [
            (f"  subject {s}", [r for r in mine if dataset.subject_of(str(r["clip"])) == s])
            for s in subjects
        ]:
            means = [f"{np.mean([float(r[k]) for r in part]):.2f}" for k in NAMES]  # type: ignore[arg-type]
            out.append(row((label, len(part), *means), widths))
    return "\n".join(out)


def starts(results: list[dict[str, object]], noise: str) -> str:
    """How the default start fares against the others, clip by clip."""
    by = {(str(r["method"]), str(r["clip"])): r for r in results if r["noise"] == noise}
    out = []
    for other in ("sip from truth", "sip from dip"):
        pairs = {
            c: (by["sip", c], r) for (m, c), r in by.items() if m == other and ("sip", c) in by
        }
        if not pairs:
            continue
        ratio = {c: a["sip_deg"] / b["sip_deg"] for c, (a, b) in pairs.items()}  # type: ignore[operator]
        cost = np.array([b["cost"] / a["cost"] for a, b in pairs.values()])  # type: ignore[operator]
        worse = {c: round(float(r), 2) for c, r in ratio.items() if r > 1.25}
        better = {c: round(float(r), 2) for c, r in ratio.items() if r < 0.8}
        steps = [np.mean([float(p[k]["iterations"]) for p in pairs.values()]) for k in (0, 1)]  # type: ignore[arg-type]
        out.append(
            f"default start against {other}: sip_deg ratio median "
            f"{np.median(list(ratio.values())):.3f}, above 1.25 in {len(worse)} of {len(pairs)} clips "
            f"{worse}, under 0.8 in {len(better)} {better}; cost of {other} over the default's: median "
            f"{np.median(cost):.4f}, lower by 1 % or more in {(cost < 0.99).sum()}, higher in "
            f"{(cost > 1.01).sum()}; iterations {steps[0]:.1f} against {steps[1]:.1f}"
        )
    both = {
        c: (by["sip", c], r) for (m, c), r in by.items() if m == "sip from dip" and ("sip", c) in by
    }
    if both:
        kept = [min(pair, key=lambda r: r["cost"]) for pair in both.values()]  # type: ignore[arg-type,return-value]
        means = {k: np.mean([float(r[k]) for r in kept]) for k in ("sip_deg", "position_cm")}  # type: ignore[arg-type]
        out.append(
            f"the cheaper of the default's and DIP's: sip_deg {means['sip_deg']:.2f}, "
            f"position_cm {means['position_cm']:.2f}"
        )
    return "\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="test", choices=("validation", "test"))
    parser.add_argument("--solver", default="banded", choices=("banded", "ipopt"))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--noise", default="realistic,none")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    found = clips(args.split)
    jobs = [
        (name, motion, noise, method, args.solver)
        for noise in args.noise.split(",")
        for method in args.methods.split(",")
        for name, motion in found
    ]
    results = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for i, result in enumerate(pool.map(one, jobs)):
            results.append(result)
            print(f"\r{i + 1}/{len(jobs)} {result['clip']}   ", end="", file=sys.stderr)
    print(file=sys.stderr)
    print(machine())
    for noise in args.noise.split(","):
        print(f"\n{args.split} split, {told(found)}, noise {noise}, solver {args.solver}")
        print(table(results, noise))
        print(starts(results, noise))
    if args.output:
        keep(args.output, results)


if __name__ == "__main__":
    main()
