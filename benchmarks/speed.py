"""Speed and memory of the offline optimizer: `make bench`.

    python benchmarks/speed.py              the solver ways on 1,000 frames, medians of five
    python benchmarks/speed.py --length     seconds per 1,000 frames against length (to 10 minutes)
    python benchmarks/speed.py --sensors    the same against the number of sensors
    python benchmarks/speed.py --memory     peak memory of a 30-minute recording

60 Hz, six sensors, realistic noise, the built-in motion repeated. Each way of --ways runs in turn, so that a
change of the machine's speed meets all of them.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time

import numpy as np
from common import machine, row

import sip
from mocap import Recording, Skeleton, sensors, synthesis
from mocap.solution import Solution
from mocap.synthesis import motions

RATE_HZ = 60.0


def recorded(frames: int, names: tuple[str, ...] = sensors.SIX) -> Recording:
    motion = motions.builtin(RATE_HZ, frames / RATE_HZ)
    return synthesis.recording(motion, names, synthesis.Noise(), 0)


def timed(recording: Recording, settings: sip.Settings) -> tuple[float, Solution]:
    """Seconds of the whole call, and what it returned."""
    began = time.perf_counter()
    solution = sip.solve(recording, settings=settings)
    return time.perf_counter() - began, solution


def median_s(recording: Recording, solver: str, runs: int) -> float:
    """Median of several solves."""
    settings = sip.Settings(solver=solver)  # type: ignore[arg-type]
    return statistics.median(timed(recording, settings)[0] for _ in range(runs))


def ways(runs: int) -> None:
    """1,000 frames by each way; IPOPT cold starts from the SOP solution."""
    recording = recorded(1000)
    sop = sip.solve(recording, settings=sip.Settings(terms="sop", solver="banded")).motion
    variants = {
        "banded": sip.Settings(solver="banded"),
        "ipopt (default)": sip.Settings(),
        "ipopt-cold from SOP": sip.Settings(solver="ipopt-cold", start=sop),
    }
    seen: dict[str, list[tuple[float, Solution]]] = {name: [] for name in variants}
    for _ in range(runs):
        for name, settings in variants.items():
            seen[name].append(timed(recording, settings))
    widths = (22, 10, 10, 10, 12, 12, 16)
    head = (
        "1,000 frames, SIP",
        "median s",
        "min s",
        "max s",
        "iterations",
        "cost",
        "gradient, sigmas",
    )
    print(row(head, widths))
    for name, results in seen.items():
        s = [r[0] for r in results]
        figures = (f"{statistics.median(s):.1f}", f"{min(s):.1f}", f"{max(s):.1f}")
        last = results[0][1]
        end = (last.iterations, f"{last.total_cost:.4f}", f"{last.gradient_norm:.1e}")
        print(row((name, *figures, *end), widths))


def lengths(solver: str, runs: int) -> None:
    """Seconds per 1,000 frames from 4 s to 10 minutes, medians; 10 minutes once."""
    print(row(("frames", "s", "s per 1,000"), (8, 10, 12)))
    for frames in (250, 1000, 4000, 12000, 36000):
        s = median_s(recorded(frames), solver, runs if frames <= 4000 else 1)
        print(row((frames, f"{s:.1f}", f"{1000 * s / frames:.2f}"), (8, 10, 12)), flush=True)


def counts(solver: str, runs: int) -> None:
    """Seconds per 1,000 frames against the number of sensors, medians."""
    print(row(("sensors", "s", "unknowns a frame"), (8, 10, 18)))
    full = sensors.SUIT
    for names in (("head",), sensors.FIVE[:3], sensors.FIVE, sensors.SIX, full[:10], full):
        recording = recorded(1000, names)
        s = median_s(recording, solver, runs)
        body = Skeleton.default()
        joints = {j for i in recording.joint for j in body.ancestors(int(i))}
        print(row((len(names), f"{s:.1f}", 3 + 3 * len(joints)), (8, 10, 18)), flush=True)


def memory(minutes: float, solver: str) -> None:
    """Peak resident memory of the whole process over a long recording."""
    recording = recorded(int(minutes * 60 * RATE_HZ))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    began = time.perf_counter()
    solution = sip.solve(recording, settings=sip.Settings(solver=solver))  # type: ignore[arg-type]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    seams = np.array(solution.report.get("seam_deg", [0.0]))
    print(
        f"{minutes:g} minutes, {len(recording)} frames, {solver}: {time.perf_counter() - began:.0f} s, "
        f"peak {peak:.2f} GiB ({before:.2f} before the solve), {len(seams)} seams: median "
        f"{np.median(seams):.2f} deg, worst {seams.max():.2f} deg"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--length", action="store_true")
    parser.add_argument("--sensors", action="store_true")
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--solver", default="banded", choices=("banded", "ipopt"))
    args = parser.parse_args()
    print(machine())
    if args.length:
        lengths(args.solver, args.runs)
    if args.sensors:
        counts(args.solver, args.runs)
    if args.memory:
        memory(args.minutes, args.solver)
    if not (args.length or args.sensors or args.memory):
        ways(args.runs)


if __name__ == "__main__":
    main()
