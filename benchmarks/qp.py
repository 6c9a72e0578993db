"""Time of the hybrid's frame: `python benchmarks/qp.py [--seconds 20]`.

Six sensors and IMUPoser's combinations at their rates, realistic noise, around a stand-in network that knows
the truth and errs by 8 degrees per joint and axis, slowly changing. qp: `LimbQP.solve`, with its own check.
asked: share of frames in which a bound is active and OSQP is asked, and the time of these alone (--error 25
makes them many). step: the whole `Tracker.step`, in which the stand-in takes no time to speak of.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from common import machine, row

from hybrid import Tracker, TrackerSettings
from hybrid.limb_qp import LimbQP, QPSolution
from mocap import Motion, sensors, synthesis
from mocap import orientation as ori
from mocap.estimator import Pose, Sample, samples
from mocap.synthesis import motions

CASES = (
    (60.0, sensors.SIX),
    (25.0, sensors.FIVE),
    (25.0, ("left_wrist", "right_pocket", "head")),
    (25.0, ("right_pocket",)),
)
ERROR_DEG = 8.0
CORRELATION_S = 0.5


clock = time.perf_counter


class StandIn:
    """A network in name: the truth with an error of first order, at once."""

    look_ahead_frames = 0

    def __init__(self, truth: Motion, names: tuple[str, ...], error_deg: float = ERROR_DEG) -> None:
        self.rate_hz, self.sensors = truth.rate_hz, names
        rng = np.random.default_rng(0)
        x = rng.normal(size=(len(truth), 24, 3))
        keep = np.exp(-1 / (CORRELATION_S * truth.rate_hz))
        for t in range(1, len(x)):
            x[t] = keep * x[t - 1] + np.sqrt(1 - keep**2) * x[t]
        self._R = truth.R_parent_joint @ ori.exp(np.deg2rad(error_deg) * x)
        self._std = np.full((24, 3), np.deg2rad(error_deg))

    def init(self) -> int:
        """Frames seen."""
        return 0

    def step(self, state: int, sample: Sample) -> tuple[int, Pose | None]:
        """The pose of this very frame."""
        return state + 1, Pose(sample.time_s, self._R[state], np.zeros(3), self._std)


class Timed(LimbQP):
    """A QP that notes how long each solve took and how many iterations."""

    def __init__(self, n: int) -> None:
        super().__init__(n)
        self.seconds: list[float] = []
        self.iterations: list[int] = []

    def solve(self, *args: Any) -> QPSolution:
        """As `LimbQP.solve`."""
        began = clock()
        answer = super().solve(*args)
        self.seconds.append(clock() - began)
        self.iterations.append(answer.iterations)
        return answer


def measure(
    rate_hz: float, names: tuple[str, ...], seconds: float, error_deg: float
) -> tuple[object, ...]:
    """One row of the table."""
    truth = motions.builtin(rate_hz, seconds)
    recording = synthesis.recording(truth, names, synthesis.Noise(), 0)
    tracker = Tracker(StandIn(truth, names, error_deg), TrackerSettings(horizon_s=0.0))
    qp = Timed(tracker.refinement.kinematics.n)
    tracker.refinement.qp = qp
    state, steps = tracker.init(), []
    for sample in samples(recording):
        began = clock()
        state, _ = tracker.step(state, sample)
        steps.append(clock() - began)
    asked = np.array(qp.iterations) > 0
    of_osqp = np.array(qp.seconds)[asked]
    figures = [
        f"{1e3 * np.percentile(x, q):.3f}" if len(x) else "-"
        for x in (qp.seconds, of_osqp, steps)
        for q in (50, 99)
    ]
    figures.append(f"{100 * asked.mean():.1f} %")
    label = "+".join(names) if len(names) < 4 else f"{len(names)} sensors"
    return (label, f"{rate_hz:g}", qp.n, *figures, max(qp.iterations), state.fallbacks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--error", type=float, default=ERROR_DEG, help="of the stand-in, deg")
    parser.add_argument(
        "--cpu", action="store_true", help="processor time, where others use the machine too"
    )
    args = parser.parse_args()
    global clock
    clock = time.thread_time if args.cpu else time.perf_counter
    print(machine(), "(processor time)" if args.cpu else "")
    widths = (30, 6, 9, 10, 10, 10, 10, 10, 10, 8, 14, 10)
    header = (
        "sensors",
        "Hz",
        "unknowns",
        "qp ms p50",
        "p99",
        "OSQP's p50",
        "p99",
        "step p50",
        "p99",
        "asked",
        "iterations max",
        "fallbacks",
    )
    print(row(header, widths))
    for rate_hz, names in CASES:
        print(row(measure(rate_hz, names, args.seconds, args.error), widths), flush=True)


if __name__ == "__main__":
    main()
