"""Whole sequences: from a recording to a `Solution`, in windows where it is long."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from mocap import checked
from mocap.errors import SolveError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.solution import Solution
from sip import initial
from sip import kinematics as kin
from sip.belief import FrameBeliefs, Listener, PoseBelief
from sip.kinematics import ROOT_P
from sip.model import CONSTANTS
from sip.problem import Problem, build, grounded, reference_root
from sip.sensor_kinematics import SensorKinematics
from sip.settings import Settings
from sip.solvers import banded, ipopt
from sip.windows import Part, Stretch, assemble, part_of, windows

Progress = Callable[[float, str], None]
_TEMPERINGS = 3
PAST = 3  # frames that a window is given by the one before it: as far as any term reaches


def solve(
    recording: Recording,
    skeleton: Skeleton | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    belief: PoseBelief | None = None,
) -> Solution:
    """Reference poses for a recording: SIP, or SOP, over the whole sequence.

    skeleton: the body (default: the mean shape). progress(fraction, words) is called from time to time.
    belief: what a network says of each frame's pose; it counts as a further term (`sip.belief`).
    Raises SolveError where no frame has a usable orientation, or the start or the belief is not of this
    length and rate.
    """
    skeleton = Skeleton.default() if skeleton is None else skeleton
    settings = Settings() if settings is None else settings
    checked.instance(recording, Recording, "solve: recording", SolveError)
    checked.instance(skeleton, Skeleton, "solve: skeleton", SolveError)
    checked.instance(settings, Settings, "solve: settings", SolveError)
    if not recording.ori_valid.any():
        raise SolveError("the recording has no valid orientation of any sensor in any frame")
    began = time.perf_counter()
    kinematics = SensorKinematics(skeleton, recording.joint, recording.placement)
    prior = settings.prior.given(kinematics.active, settings.prior_floor)
    heard = None
    if belief is not None:
        if len(belief) != len(recording):
            raise SolveError(
                f"the network's poses have {len(belief)} frames, the recording {len(recording)}"
            )
        heard = Listener(skeleton, kinematics, recording.joint, settings).listen(recording, belief)
    given = None
    if isinstance(settings.start, Motion):
        _check_start(settings.start, recording)
        given = initial.from_motion(settings.start, prior)
    # The overlap is a time: what happens there must have been seen by both windows.
    overlap = round(settings.overlap * max(1.0, recording.rate_hz / 60))
    plan = windows(len(recording), settings.window, min(overlap, settings.window // 2))
    parts: list[Part] = []
    # Blocks of 75 are too small for BLAS threads: waiting for each other they take several times longer.
    with threadpool_limits(1, "blas"):
        for i, w in enumerate(plan):
            where = f"window {i + 1} of {len(plan)}, " if len(plan) > 1 else ""
            tell = share(progress, i, len(plan), where)
            before = parts[-1] if parts else None
            part = _solve_window(
                recording, skeleton, settings, kinematics, given, heard, w, before, tell
            )
            parts.append(part)
    return assemble(recording, skeleton, settings, prior, parts, time.perf_counter() - began)


def _check_start(start: Motion, recording: Recording) -> None:
    """Raise SolveError unless the start has the recording's frames."""
    if len(start) != len(recording):
        raise SolveError(f"the start has {len(start)} frames, the recording {len(recording)}")
    if abs(start.rate_hz - recording.rate_hz) > 1e-6 * recording.rate_hz:
        raise SolveError(
            f"the start runs at {start.rate_hz:g} Hz, the recording at {recording.rate_hz:g} Hz"
        )


def share(progress: Progress | None, i: int, count: int, where: str) -> Progress:
    """Progress of part i of `count` as progress of the whole, its words after `where`."""

    def tell(fraction: float, words: str) -> None:
        if progress:
            progress((i + fraction) / count, where + words)

    return tell


def _solve_window(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    kinematics: SensorKinematics,
    given: tuple[Array, Array] | None,
    heard: FrameBeliefs | None,
    window: Stretch,
    before: Part | None,
    tell: Progress,
) -> Part:
    cold = settings.solver == "ipopt-cold"
    u0 = np.zeros((kinematics.S, CONSTANTS)) if before is None else before.u
    x, R_ref, u, iterations = _start(
        recording, skeleton, settings, kinematics, given, heard, window, u0, tell
    )
    # The last frames that the window before keeps are given: differences reach across the seam.
    past = 0 if before is None else PAST
    piece = recording.slice(window.start - past, window.stop)
    said = heard and heard.slice(window.start - past, window.stop)
    if before is not None:
        k = before.window.keep - before.window.start
        x[:, ROOT_P] += before.x[k, ROOT_P] - x[0, ROOT_P]
        x = np.vstack([before.x[k - past : k], x])
        R_ref = np.concatenate([before.R_ref[k - past : k], R_ref])
    problem = build(piece, skeleton, settings, kinematics, past, said)
    if cold:
        result = ipopt.minimise(
            problem, x, R_ref, u, False, progress=_teller(tell, 0.3, 0.7, "IPOPT")
        )
        iterations += result.iterations
        for _ in range(_judgings(problem)):
            p, problem = result.point, grounded(problem, result.point)
            teller = _teller(tell, 0.7, 1, "IPOPT, feet that stand")
            result = ipopt.minimise(problem, p.x, p.R_ref, p.u, False, progress=teller)
            iterations += result.iterations
    else:
        result = banded.minimise(problem, x, R_ref, u, progress=_teller(tell, 0.3, 0.7, "banded"))
        iterations += result.iterations
        for _ in range(_TEMPERINGS if settings.self_calibration else 0):
            excess = _excess(result.point.u, settings)
            if excess <= 1:
                break
            # Constants as large as these are unlikely: they explain what the body or the prior gets wrong.
            longer = settings.correlation_s * max(2.0, excess**2)
            settings = replace(settings, correlation_s=longer)
            problem = build(piece, skeleton, settings, kinematics, past, said)
            result = banded.minimise(
                problem, x, R_ref, u, progress=_teller(tell, 0.3, 0.7, "banded, tempered")
            )
            iterations += result.iterations
        for _ in range(_judgings(problem)):
            p, problem = result.point, grounded(problem, result.point)
            teller = _teller(tell, 0.6, 0.7, "banded, feet that stand")
            result = banded.minimise(problem, p.x, p.R_ref, p.u, progress=teller)
            iterations += result.iterations
        if settings.solver == "ipopt":
            # IPOPT's barrier starts well from a point that is optimal within the bounds, and only from one.
            p = result.point
            teller = _teller(tell, 0.7, 0.8, "banded, hard limits")
            result = banded.minimise(problem, p.x, p.R_ref, p.u, progress=teller, box=problem.box)
            iterations += result.iterations
            p = result.point
            result = ipopt.minimise(
                problem, p.x, p.R_ref, p.u, True, progress=_teller(tell, 0.8, 1, "IPOPT finish")
            )
            iterations += result.iterations
    return part_of(problem, settings, window, result, iterations)


def _judgings(problem: Problem) -> int:
    """How often what stands is judged anew."""
    return problem.settings.contact_passes if problem.model.has_contact else 0


def _excess(u: Array, settings: Settings) -> float:
    """Largest root mean square over sensors of mounting, heading and bias, in their sigmas.

    A posterior mean varies no more than its prior: above 1 the data are trusted too much.
    """
    parts = ((u[:, :3], settings.sigma_mounting), (u[:, 3], settings.sigma_heading))
    ratios = [
        float(np.sqrt(np.mean(v**2))) / s for v, s in (*parts, (u[:, 4:], settings.sigma_bias))
    ]
    return max(ratios)


def _teller(tell: Progress, start: float, stop: float, name: str) -> banded.Progress:
    """Progress of a solver whose number of iterations is unknown: each step takes a part of the rest."""

    def report(iteration: int, cost: float) -> None:
        share = 1 - 0.85**iteration
        tell(start + (stop - start) * share, f"{name} iteration {iteration}, cost {cost:.4g}")

    return report


def _start(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    kinematics: SensorKinematics,
    given: tuple[Array, Array] | None,
    heard: FrameBeliefs | None,
    window: Stretch,
    u: Array,
    tell: Progress,
) -> tuple[Array, Array, Array, int]:
    """x, R_ref, u where the solve of a window starts, and the iterations that it took.

    given: x and R_ref of the whole recording, if the user has a start.
    """
    if given is not None:
        x, R_ref = (a[window.start : window.stop].copy() for a in given)
        return x, R_ref, u, 0
    prior = settings.prior.given(kinematics.active, settings.prior_floor)
    piece = recording.slice(window.start, window.stop)
    said = heard and heard.slice(window.start, window.stop)
    x, R_ref = initial.from_prior(recording, skeleton, prior, window.start, window.stop)
    if settings.solver == "ipopt-cold":
        if settings.terms == "sop":
            return x, R_ref, u, 0
        sop = build(piece, skeleton, replace(settings, terms="sop"), kinematics, 0, said)
        r = ipopt.minimise(sop, x, R_ref, u, False, progress=_teller(tell, 0, 0.3, "IPOPT SOP"))
        return r.point.x, r.point.R_ref, r.point.u, r.iterations
    factor = max(1, int(piece.rate_hz / settings.coarse_hz))
    if len(piece) < 8 * factor:
        factor = 1
    coarse = initial.coarsened(piece, factor)
    said = said and said.every(factor)
    plain = replace(settings, self_calibration=False)
    iterations = 0
    xc, Rc = x[::factor], R_ref[::factor]
    zero = np.zeros_like(u)
    for terms in ("sop", "sip") if settings.terms == "sip" else ("sop",):
        problem = build(coarse, skeleton, replace(plain, terms=terms), kinematics, 0, said)
        r = banded.minimise(
            problem, xc, Rc, zero, tolerance=1e-3, progress=_teller(tell, 0, 0.3, f"coarse {terms}")
        )
        xc, Rc = r.point.x, r.point.R_ref
        iterations += r.iterations
    xc, Rc = kin.recentre(xc, Rc)
    x, R_ref = initial.refined(xc, Rc, factor, len(piece), reference_root(piece))
    return x, R_ref, u, iterations
