"""What the terms' own gradients and matrices save against those that the base makes of their stencils.

Both in one run, in turns, on a window of the built-in recording; ms a call, medians. A term keeps a way of
its own where the ratio says so. Run: python benchmarks/terms.py [--seconds 4] [--repeat 30]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from mocap import sensors, synthesis
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from sip import PoseBelief, Settings, initial
from sip.belief import Listener
from sip.problem import build, grounded
from sip.sensor_kinematics import SensorKinematics
from sip.solvers.band import Band
from sip.terms.acceleration import Acceleration
from sip.terms.base import Point, Stencil, Term
from sip.terms.contact import Contact
from sip.terms.network import NetworkPose


def acceleration(term: Acceleration, point: Point) -> Stencil:
    J, G = term._jacobian(point)
    M, S = term.weight.shape[:2]
    J = J.reshape(len(J), 3 * S, -1)
    robust = term._robust(term.residual(point))[..., None]
    weight = np.broadcast_to(term.weight / np.sqrt(robust), (M, S, 3)).reshape(M, 3 * S)
    blocks = {0: J[:-2], 1: -2 * J[1:-1], 2: J[2:]}
    return Stencil(blocks, weight=weight, of_sensors=G, constants=slice(3, 7))


def network(term: NetworkPose, point: Point) -> Stencil:
    slopes = np.swapaxes(term._slopes(point), 2, 3) * term.belief.scale.reshape(
        len(point.x), -1, 3, 1
    )
    T, a = slopes.shape[:2]
    J = np.zeros((T, a, 3, a, 3))
    J[:, np.arange(a), :, np.arange(a)] = slopes.swapaxes(0, 1)
    L = np.broadcast_to(term.belief.L, (T, 3 * a, 3 * a))
    return Stencil({0: np.swapaxes(L, 1, 2) @ J.reshape(T, 3 * a, 3 * a)}, term.columns)


def contact(term: Contact, point: Point) -> Stencil:
    J = term._slopes(point)
    J = J.reshape(len(J), 3 * term.soles.P, -1)
    weight = np.repeat(term.weight, 3, axis=2).reshape(len(term.weight), -1)
    return Stencil({0: -J[:-1], 1: J[1:]}, weight=weight)


STENCILS: dict[str, Callable[..., Stencil]] = {
    "acceleration": acceleration,
    "contact": contact,
    "network": network,
}


def plain(term: Term) -> Term:
    """The same term, with nothing but its stencil."""
    stencil = STENCILS.get(term.name)
    if stencil is None:
        return term
    made = type("Plain", (Term,), {"name": term.name, "reach": term.reach})()
    made.stencil = partial(stencil, term)
    return made


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--repeat", type=int, default=30)
    args = parser.parse_args()
    truth = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    recording = synthesis.recording(truth, sensors.SIX, synthesis.Noise(), rng=0)
    for calibrating in (False, True):
        settings, body = Settings(self_calibration=calibrating), Skeleton.default()
        kinematics = SensorKinematics(body, recording.joint, recording.placement)
        said = PoseBelief(truth.R_parent_joint, np.eye(72) * 0.02)
        listener = Listener(body, kinematics, recording.joint, settings)
        problem = build(recording, body, settings, kinematics, 0, listener.listen(recording, said))
        x, R_ref = initial.from_motion(truth, problem.prior)
        point = problem.point(x, R_ref, np.zeros((problem.S, 7)))
        problem = grounded(problem, point)
        print(f"{len(recording)} frames, self-calibration {'on' if calibrating else 'off'}")
        for term in problem.terms:
            _time(problem, point, term, args.repeat)
    return 0


def _time(problem: object, point: Point, term: Term, repeat: int) -> None:
    T, n, S = problem.T, problem.n, problem.S  # type: ignore[attr-defined]
    band = Band.zeros(T, problem.reach, n, problem.border)  # type: ignore[attr-defined]
    grad, grad_u, v = np.zeros((T, n)), np.zeros((S, 7)), term.residual(point)
    ways = {"own": term, "base": plain(term)}
    spent: dict[tuple[str, str], list[float]] = {}
    for _ in range(repeat):
        for name, one in ways.items():
            point.kept.clear()
            term.residual(point)
            for what, call in (
                ("pullback", lambda one=one: one.pullback(point, v, grad, grad_u)),
                ("hessian", lambda one=one: one.hessian(point, band)),
            ):
                start = time.perf_counter()
                call()
                spent.setdefault((name, what), []).append(time.perf_counter() - start)
    ms = {k: 1e3 * float(np.median(s)) for k, s in spent.items()}
    for what in ("pullback", "hessian"):
        own, base = ms["own", what], ms["base", what]
        ratio = f", base {base:7.3f} ms, ratio {base / own:.2f}" if term.name in STENCILS else ""
        print(f"  {term.name:16} {what:8} {own:7.3f} ms{ratio}")


if __name__ == "__main__":
    raise SystemExit(main())
