"""An estimator of one's own in the hybrid: no network, but poses kept in memory.

The pose is the mean of N remembered ones, each weighted by how well its sensors' orientations relative to
the pelvis, Q = R_pelvis^T R_sensor, agree with those measured:

    w_k = exp(-sum_s |Q_s - Q_ks|^2 / 4 h^2) / (their sum)        R_j = project(sum_k w_k R_kj)

How the remembered poses differ is how far the mean is to be trusted: std_rad. The hybrid needs no more, and
turns the bones with sensors to where they were measured. Hips and shoulders need not gain: std_rad does not
say that errors along a limb lean against each other, as `Pose.covariance` would (docs/hybrid.md).
Run: python examples/own_estimator.py [--seconds 5]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field

import numpy as np

from hybrid import Tracker
from mocap import estimator, sensors, synthesis
from mocap import orientation as ori
from mocap.estimator import Pose, Sample
from mocap.evaluation import metrics
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.console import table
from sip.prior import shipped


@dataclass
class Remembered:
    """2000 poses of the training motion, read through the six sensors. The state: R_world_bone (S,3,3)
    measured last, so that a sensor that is lost keeps its orientation."""

    rate_hz: float
    width_deg: float = 12.0  # h
    floor_deg: float = 6.0  # of std_rad: no remembered pose is this very one
    sensors: tuple[str, ...] = sensors.SIX
    look_ahead_frames: int = 0
    poses: np.ndarray = field(default_factory=lambda: shipped().poses)  # (N,69) rad

    def __post_init__(self) -> None:
        self.R = np.tile(np.eye(3), (len(self.poses), 24, 1, 1))
        self.R[:, 1:] = ori.exp(self.poses.reshape(-1, 23, 3))
        joint, _ = sensors.joints_and_seats(self.sensors)
        self.Q = self.relative(Skeleton.default().rotations(self.R)[:, joint])

    def relative(self, R_world_bone: np.ndarray) -> np.ndarray:
        """R_pelvis^T R_sensor, flattened to (...,9 S)."""
        pelvis = R_world_bone[..., self.sensors.index("pelvis"), :, :]
        Q = np.swapaxes(pelvis, -1, -2)[..., None, :, :] @ R_world_bone
        return Q.reshape(*Q.shape[:-3], -1)

    def init(self) -> np.ndarray:
        return np.tile(np.eye(3), (len(self.sensors), 1, 1))

    def step(self, state: np.ndarray, sample: Sample) -> tuple[np.ndarray, Pose]:
        has = sample.valid & np.isfinite(sample.R_world_bone).all((-1, -2))
        state = np.where(has[:, None, None], sample.R_world_bone, state)
        d = np.square(self.Q - self.relative(state)).sum(axis=-1)
        w = np.exp((d.min() - d) / (4 * np.deg2rad(self.width_deg) ** 2))
        mean = np.einsum("k,kjab->jab", w / w.sum(), self.R)
        R = ori.project(mean)
        # |R_k - R|^2 = 6 - 2 tr(R^T R_k) = 2 angle^2 for small angles, over three axes.
        spread = (3 - np.einsum("jab,jab->j", R, mean)) / 3
        std = np.sqrt(spread.clip(0) + np.deg2rad(self.floor_deg) ** 2)
        R[0] = state[self.sensors.index("pelvis")]
        return state, Pose(sample.time_s, R, np.zeros(3), np.tile(std[:, None], 3))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5.0, help="of the built-in motion")
    args = parser.parse_args(argv)

    motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    recording = synthesis.recording(motion, sensors.SIX, synthesis.Noise(), rng=0)

    own = Remembered(recording.rate_hz)
    rows = []
    for name, method in (("remembered poses", own), ("hybrid around them", Tracker(own))):
        run = estimator.replay(method, recording)
        m = metrics.evaluate(run.motion, recording.reference, recording=recording)
        figures = (m.instrumented_deg, m.sip_deg, m.position_cm, m.jitter)
        ms = f"{1e3 * np.median(run.frame_s):.1f}"
        rows.append((name, *(f"{f:.1f}" for f in figures), ms, str(run.fallbacks)))
        for note, count in run.notes.items():
            print(f"{name}, {count} of {len(run.motion)} frames: {note}")
    heads = ("instr. deg", "SIP deg", "position cm", "jitter 100 m/s^3", "p50 ms", "fallbacks")
    table(("estimator", *heads), rows)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
