"""Whole sequences: from a recording to a `Solution`, in windows where it is long."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from mocap import orientation as ori
from mocap.errors import SolveError
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.solution import Solution
from sip import banded, initial, ipopt
from sip import kinematics as kin
from sip.band import factored
from sip.banded import Result
from sip.kinematics import BODY, ROOT_P, ROOT_W
from sip.prior import Conditioned
from sip.problem import CONSTANTS, Problem, SensorKinematics, build, overcount, reference_root
from sip.settings import Settings
from sip.terms.calibration import SensorConstants

Progress = Callable[[float, str], None]
_TEMPERINGS = 3
FAR_RAD = np.deg2rad(150.0)
PAST = 3  # frames that a window is given by the one before it: as far as any term reaches


@dataclass(frozen=True)
class Window:
    """Frames start..stop-1 are solved together; those from `keep` on are replaced by the next window's."""

    start: int
    stop: int
    keep: int


def windows(frames: int, size: int, overlap: int) -> list[Window]:
    """Windows of equal size, at most `size` frames, each reaching `overlap` frames into the next."""
    if frames <= size:
        return [Window(0, frames, frames)]
    count = int(np.ceil((frames - overlap) / (size - overlap)))
    cuts = np.linspace(0, frames - overlap, count + 1).round().astype(int)
    cuts[-1] = frames
    return [Window(int(a), int(min(b + overlap, frames)), int(b)) for a, b in pairwise(cuts)]


def solve(
    recording: Recording,
    skeleton: Skeleton | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Reference poses for a recording: SIP, or SOP, over the whole sequence.

    skeleton: the body (default: the mean shape). progress(fraction, words) is called from time to time.
    Raises SolveError where no frame has a usable orientation, or the start is not of this length and rate.
    """
    skeleton, settings = skeleton or Skeleton.default(), settings or Settings()
    if not recording.ori_valid.any():
        raise SolveError("the recording has no valid orientation of any sensor in any frame")
    began = time.perf_counter()
    kinematics = SensorKinematics(skeleton, recording.joint, recording.placement)
    prior = settings.prior.given(kinematics.active, settings.prior_floor)
    given = None
    if isinstance(settings.start, Motion):
        _check_start(settings.start, recording)
        given = initial.from_motion(settings.start, prior)
    # The overlap is a time: what happens there must have been seen by both windows.
    overlap = round(settings.overlap * max(1.0, recording.rate_hz / 60))
    plan = windows(len(recording), settings.window, min(overlap, settings.window // 2))
    parts: list[_Part] = []
    # Blocks of 75 are too small for BLAS threads: waiting for each other they take several times longer.
    with threadpool_limits(1, "blas"):
        for i, w in enumerate(plan):
            where = f"window {i + 1} of {len(plan)}, " if len(plan) > 1 else ""
            tell = share(progress, i, len(plan), where)
            before = parts[-1] if parts else None
            part = _solve_window(recording, skeleton, settings, kinematics, given, w, before, tell)
            parts.append(part)
    return _assemble(recording, skeleton, settings, prior, parts, time.perf_counter() - began)


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


@dataclass
class _Part:
    """A solved window: x and R_ref of its frames (past not included), and what is reported."""

    window: Window
    x: Array
    R_ref: Array
    u: Array
    u_std: Array | None
    costs: dict[str, float]
    residuals: dict[str, Array]
    iterations: int
    status: str
    converged: bool
    gradient_norm: float
    std: Array | None


def _solve_window(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    kinematics: SensorKinematics,
    given: tuple[Array, Array] | None,
    window: Window,
    before: _Part | None,
    tell: Progress,
) -> _Part:
    cold = settings.solver == "ipopt-cold"
    u0 = np.zeros((kinematics.S, CONSTANTS)) if before is None else before.u
    x, R_ref, u, iterations = _start(
        recording, skeleton, settings, kinematics, given, window, u0, tell
    )
    # The last frames that the window before keeps are given: differences reach across the seam.
    past = 0 if before is None else PAST
    piece = recording.slice(window.start - past, window.stop)
    if before is not None:
        k = before.window.keep - before.window.start
        x[:, ROOT_P] += before.x[k, ROOT_P] - x[0, ROOT_P]
        x = np.vstack([before.x[k - past : k], x])
        R_ref = np.concatenate([before.R_ref[k - past : k], R_ref])
    problem = build(piece, skeleton, settings, kinematics, fixed=past)
    if cold:
        result = ipopt.minimise(
            problem, x, R_ref, u, False, progress=_teller(tell, 0.3, 1, "IPOPT")
        )
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
            problem = build(problem.recording, skeleton, settings, kinematics, fixed=problem.fixed)
            result = banded.minimise(
                problem, x, R_ref, u, progress=_teller(tell, 0.3, 0.7, "banded, tempered")
            )
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
    return _part(problem, settings, window, result, iterations)


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
    window: Window,
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
    x, R_ref = initial.from_prior(recording, skeleton, prior, window.start, window.stop)
    if settings.solver == "ipopt-cold":
        if settings.terms == "sop":
            return x, R_ref, u, 0
        sop = build(piece, skeleton, replace(settings, terms="sop"), kinematics)
        r = ipopt.minimise(sop, x, R_ref, u, False, progress=_teller(tell, 0, 0.3, "IPOPT SOP"))
        return r.point.x, r.point.R_ref, r.point.u, r.iterations
    factor = max(1, int(piece.rate_hz / settings.coarse_hz))
    if len(piece) < 8 * factor:
        factor = 1
    coarse = initial.coarsened(piece, factor)
    plain = replace(settings, self_calibration=False)
    iterations = 0
    xc, Rc = x[::factor], R_ref[::factor]
    zero = np.zeros_like(u)
    for terms in ("sop", "sip") if settings.terms == "sip" else ("sop",):
        problem = build(coarse, skeleton, replace(plain, terms=terms), kinematics)
        r = banded.minimise(
            problem, xc, Rc, zero, tolerance=1e-3, progress=_teller(tell, 0, 0.3, f"coarse {terms}")
        )
        xc, Rc = r.point.x, r.point.R_ref
        iterations += r.iterations
    xc, Rc = kin.recentre(xc, Rc)
    x, R_ref = initial.refined(xc, Rc, factor, len(piece), reference_root(piece))
    return x, R_ref, u, iterations


def _part(
    problem: Problem, settings: Settings, window: Window, result: Result, iterations: int
) -> _Part:
    p, f = result.point, problem.fixed
    residuals: dict[str, list[Array]] = {}
    costs: dict[str, float] = {}
    stop = f + window.keep - window.start
    for term in problem.terms:
        r = term.residual(p)
        if term.name != SensorConstants.name:
            # Each frame counts once, in the window that keeps it: residual i reaches frame i + reach.
            r = r[max(f - term.reach, 0) : max(stop - term.reach, 0)]
        residuals.setdefault(term.name, []).append(r)
        costs[term.name] = costs.get(term.name, 0.0) + term.loss(r)
    flat = {k: v[0] if len(v) == 1 else np.concatenate(v, axis=1) for k, v in residuals.items()}
    std = u_std = None
    if settings.uncertainty or settings.self_calibration:
        factor = factored(problem.hessian(p))
        if settings.self_calibration:
            # The corner of the inverse is the inverse of the Schur complement.
            variance = np.diag(factor.corner_inverse()).reshape(-1, CONSTANTS)
            u_std = np.sqrt(overcount(problem.recording.rate_hz, settings) * variance)
        if settings.uncertainty:
            blocks = factor.inverse_blocks()[f:]
            root = np.einsum("tii->ti", blocks[:, ROOT_W, ROOT_W])
            body = problem.prior.complete_variance(blocks[:, BODY, BODY])
            std = np.sqrt(np.hstack([root, body])).reshape(-1, 24, 3)
    return _Part(
        window, p.x[f:], p.R_ref[f:], p.u, u_std, costs, flat, iterations,
        result.status, result.converged, result.gradient_norm, std,
    )  # fmt: skip


def _seam(a: _Part, b: _Part) -> float:
    """Largest over frames of the mean angle over joints, in rad, by which two windows' overlap differs.

    Local angles of the root and the active joints, in the first half of the overlap: what lies there
    was solved twice with something behind it.
    """
    k = a.window.keep - a.window.start
    n = (len(a.x) - k + 1) // 2
    if n <= 0:
        return 0.0
    R = []
    for p, i in ((a, k), (b, 0)):
        x = p.x[i : i + n]
        root = p.R_ref[i : i + n] @ ori.exp(x[:, ROOT_W])
        body = ori.exp(x[:, BODY].reshape(n, (x.shape[1] - 6) // 3, 3))
        R.append(np.concatenate([root[:, None], body], axis=1))
    return float(ori.angle_between(*R).mean(axis=1).max())


def _assemble(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    prior: Conditioned,
    parts: list[_Part],
    seconds: float,
) -> Solution:
    def joined(get: Callable[[_Part], Array]) -> Array:
        return np.concatenate([get(p)[: p.window.keep - p.window.start] for p in parts])

    x, R_ref = joined(lambda p: p.x), joined(lambda p: p.R_ref)
    R_root = R_ref @ ori.exp(x[:, ROOT_W])
    theta = prior.complete(x[:, BODY])
    p_root = x[:, ROOT_P] - x[0, ROOT_P]
    motion = kin.unpack(p_root, R_root, theta, recording.rate_hz, skeleton)
    cost: dict[str, float] = {}
    for part in parts:
        for name, value in part.costs.items():
            cost[name] = cost.get(name, 0.0) + value
    report: dict[str, Any] = {"windows": len(parts)}
    if len(parts) > 1:
        seams = [_seam(a, b) for a, b in pairwise(parts)]
        report["seam_deg"] = np.rad2deg(seams).tolist()
    residuals = {
        name: np.concatenate([p.residuals[name] for p in parts if name in p.residuals])
        for name in parts[0].residuals
    }
    worst = max(parts, key=lambda p: (not p.converged, p.gradient_norm))
    # Past this angle the rotation vector's own singularity is near: the start was bad, or a sensor is.
    apart = np.linalg.norm(residuals["orientation"], axis=-1) * settings.sigma_orientation
    far = (apart > FAR_RAD).sum(axis=0)
    report["samples_beyond_150_deg"] = {
        name: int(n) for name, n in zip(recording.sensors, far, strict=True) if n
    }
    status = worst.status
    if settings.terms == "sip" and not recording.acc_valid.any():
        status += "; no sensor has an acceleration, so this is SOP"
    if far.any():
        status += f"; {far.sum()} samples end over 150 deg from the measurement: " + ", ".join(
            report["samples_beyond_150_deg"]
        )
    return Solution(
        motion,
        cost,
        residuals,
        _sigmas(recording, residuals),
        sum(p.iterations for p in parts),
        seconds,
        status,
        all(p.converged for p in parts),
        joined(lambda p: p.std) if parts[0].std is not None else None,  # type: ignore[arg-type, return-value]
        worst.gradient_norm,
        _constants(recording, parts) if settings.self_calibration else None,
        report,
    )


def _sigmas(recording: Recording, residuals: dict[str, Array]) -> dict[str, float]:
    """Root mean square of each term's whitened residuals; of sensors, over what was measured."""
    out = {}
    for name, r in residuals.items():
        # The residual of a sample that is missing is exactly zero.
        used = r[np.abs(r).sum(axis=-1) > 0] if name in ("orientation", "acceleration") else r
        out[name] = float(np.sqrt(np.mean(used**2))) if used.size else 0.0
    return out


def _constants(recording: Recording, parts: list[_Part]) -> dict[str, dict[str, Any]]:
    """Self-calibrated constants per sensor, in rad and m/s^2.

    Over several windows: means by frames, with the standard deviations of a window (no smaller, since
    what misleads one may mislead all).
    """
    weight = np.array([len(p.x) for p in parts], float)
    u = np.average([p.u for p in parts], axis=0, weights=weight)
    variance = [p.u_std**2 for p in parts if p.u_std is not None]
    std = np.sqrt(np.average(variance, axis=0, weights=weight))
    return {
        name: {
            "mounting_rad": u[s, :3].tolist(),
            "heading_rad": float(u[s, 3]),
            "bias_mps2": u[s, 4:].tolist(),
            "std": std[s].tolist(),
        }
        for s, name in enumerate(recording.sensors)
    }
