"""A term of your own in SIP: a goniometer on each knee, worn instead of the sensors on the shanks.

A term is a sum of squares of residuals in sigmas. This one adds, for every frame and knee,

    (theta_x(t) - measured(t))^2 / sigma^2,

theta_x the bending of the knee, which is the first component of its rotation vector and an unknown of the
problem. Run: python examples/own_term.py [--seconds 6]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

import sip
from mocap import Motion, Recording, synthesis
from mocap import orientation as ori
from mocap.evaluation import metrics
from mocap.orientation import Array
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from sip.kinematics import BODY
from sip.sensor_kinematics import SensorKinematics
from sip.terms.base import Point, Stencil, Term

KNEES = ("left_knee", "right_knee")
WORN = ("left_thigh", "right_thigh", "left_forearm", "right_forearm", "head", "pelvis")
SHANKS = ("left_shank", "right_shank")
SIGMA = np.deg2rad(3.0)


class Goniometer(Term):
    """Residual (T,K): (x - angle) / sigma of the columns `columns` of the unknowns; angle (T,K) rad."""

    name = "goniometer"
    reach = 0  # each residual is of the unknowns of one frame alone

    def __init__(self, columns: list[int], angle: Array, sigma: float) -> None:
        self.columns, self.angle, self.sigma = columns, angle, sigma

    def residual(self, point: Point) -> Array:
        return (point.x[:, self.columns] - self.angle) / self.sigma

    def stencil(self, point: Point) -> Stencil:
        """Residual k is of column k alone, and its derivative there is 1 / sigma in every frame."""
        slope = np.ones((1, len(self.columns)))
        return Stencil({0: slope}, self.columns, 1 / self.sigma, diagonal=True)


@dataclass(frozen=True)
class Measured:
    """What the goniometers measured: time_s (T,), angle (T,2) rad. The solver calls it for each window."""

    time_s: Array
    angle: Array

    def __call__(self, recording: Recording, kinematics: SensorKinematics) -> Goniometer:
        names = Skeleton.default().names
        columns = [BODY.start + 3 * kinematics.active.index(names.index(k)) for k in KNEES]
        t = recording.start_s + np.arange(len(recording)) / recording.rate_hz
        angle = np.stack([np.interp(t, self.time_s, a) for a in self.angle.T], axis=1)
        return Goniometer(columns, angle, SIGMA)


def bending(motion: Motion) -> Array:
    """Of both knees, (T,2) rad."""
    joints = [motion.skeleton.names.index(k) for k in KNEES]
    return ori.log(motion.R_parent_joint[:, joints])[..., 0]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=6.0, help="of the built-in motion")
    args = parser.parse_args(argv)

    truth = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    recording = synthesis.recording(truth, (*WORN, *SHANKS), synthesis.Noise(), rng=0)
    # Shank sensors that measured nothing: the joints above sensors are the unknowns, knees among them.
    valid = np.array(recording.valid)
    valid[:, -len(SHANKS) :] = False
    recording = replace(recording, valid=valid)
    noise = SIGMA * np.random.default_rng(0).normal(size=(len(truth), 2))
    measured = Measured(np.arange(len(truth)) / truth.rate_hz, bending(truth) + noise)

    for words, extra in (("without", ()), ("with", (measured,))):
        settings = sip.Settings(solver="banded", extra=extra)
        solution = sip.solve(recording, settings=settings)
        m = metrics.evaluate(solution.motion, truth)
        off = np.rad2deg(np.abs(bending(solution.motion) - bending(truth)).mean())
        print(f"{words} goniometers: knees {off:.1f} deg off, joints {m.position_cm:.1f} cm")
    print("root mean square of the residual, sigmas: ", end="")
    print(f"{np.sqrt((solution.residuals['goniometer'] ** 2).mean()):.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
