"""The live loop in Python, with an estimator of your own.

An estimator is two functions over explicit state: init() -> state, step(state, sample) -> (state, pose).
This one turns each instrumented joint as measured; a real one (`learned.estimator`) is driven alike.
Run: python examples/live_loop.py [--seconds 3]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from mocap import sensors, synthesis
from mocap.estimator import Pose, Sample
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.live import loop
from poser.live.samples import RecordingSource

BODY = Skeleton.default()


@dataclass
class AsMeasured:
    """Joints with a sensor take its rotation, all others follow their parents."""

    rate_hz: float
    sensors: tuple[str, ...]
    look_ahead_frames: int = 0

    def init(self) -> np.ndarray:
        """The state: the last rotations R_world_bone (S,3,3)."""
        return np.tile(np.eye(3), (len(self.sensors), 1, 1))

    def step(self, state: np.ndarray, sample: Sample) -> tuple[np.ndarray, Pose]:
        state = np.where(sample.valid[:, None, None], sample.R_world_bone, state)
        joints = [sensors.lookup(name).joint for name in self.sensors]
        R_world = np.tile(np.eye(3), (24, 1, 1))
        for j, parent in enumerate(BODY.parents):
            if j in joints:
                R_world[j] = state[joints.index(j)]
            elif parent >= 0:
                R_world[j] = R_world[parent]
        return state, Pose(sample.time_s, BODY.local_rotations(R_world), np.zeros(3))


class Printer:
    """A sink: anything with a name, write(pose) and close()."""

    name = "printer"
    written = 0

    def write(self, pose: Pose) -> None:
        if self.written % 30 == 0:
            _, p = BODY.forward(pose.R_parent_joint, pose.p_world_root)
            print(f"{pose.time_s:5.2f} s: left wrist at {np.round(p[20], 2)} m")
        self.written += 1

    def close(self) -> dict[str, int]:
        return {"written": self.written}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="of the built-in motion")
    args = parser.parse_args()

    # Virtual sensors; speed=None replays as fast as it goes, 1.0 at the recording's own pace.
    motion = motions.builtin(seconds=args.seconds)
    recording = synthesis.recording(motion, sensors.SIX, synthesis.Noise(), rng=0)
    source = RecordingSource(recording, speed=4.0)

    report, sinks = loop.Report(), [Printer()]
    source.open()
    try:
        loop.run(source, AsMeasured(source.rate_hz, source.sensors), sinks, BODY, report)
    finally:
        loop.close(source, sinks, report)
    p50, p99 = (report.lag.quantile_ms(q) for q in (0.5, 0.99))
    print(f"{report.frames} poses, latency {p50:.1f} ms in the middle, {p99:.1f} ms for 99 of 100")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
