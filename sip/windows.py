"""Windows of a long sequence, what is kept of each when it is solved, and the `Solution` made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.solution import Solution
from sip import kinematics as kin
from sip.kinematics import BODY, ROOT_P, ROOT_W
from sip.model import CONSTANTS, overcount
from sip.prior import Conditioned
from sip.problem import Problem
from sip.settings import Settings
from sip.solvers.band import factored
from sip.solvers.banded import Result
from sip.terms.calibration import SensorConstants

FAR_RAD = np.deg2rad(150.0)


@dataclass(frozen=True)
class Stretch:
    """Frames start..stop-1 are solved together; those from `keep` on are replaced by the next window's."""

    start: int
    stop: int
    keep: int


def windows(frames: int, size: int, overlap: int) -> list[Stretch]:
    """Windows of equal size, at most `size` frames, each reaching `overlap` frames into the next."""
    if frames <= size:
        return [Stretch(0, frames, frames)]
    count = int(np.ceil((frames - overlap) / (size - overlap)))
    cuts = np.linspace(0, frames - overlap, count + 1).round().astype(int)
    cuts[-1] = frames
    return [Stretch(int(a), int(min(b + overlap, frames)), int(b)) for a, b in pairwise(cuts)]


@dataclass
class Part:
    """A solved window: x and R_ref of its frames (past not included), and what is reported."""

    window: Stretch
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


def part_of(
    problem: Problem, settings: Settings, window: Stretch, result: Result, iterations: int
) -> Part:
    """What is kept of a solved window: costs and residuals of the frames that no later window replaces, and
    the posterior's standard deviations where they are asked for.
    """
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
            u_std = np.sqrt(overcount(problem.model.rate_hz, settings) * variance)
        if settings.uncertainty:
            blocks = factor.inverse_blocks()[f:]
            root = np.einsum("tii->ti", blocks[:, ROOT_W, ROOT_W])
            body = problem.prior.complete_variance(blocks[:, BODY, BODY])
            std = np.sqrt(np.hstack([root, body])).reshape(-1, 24, 3)
    return Part(
        window, p.x[f:], p.R_ref[f:], p.u, u_std, costs, flat, iterations,
        result.status, result.converged, result.gradient_norm, std,
    )  # fmt: skip


def _seam(a: Part, b: Part) -> float:
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


def assemble(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    prior: Conditioned,
    parts: list[Part],
    seconds: float,
) -> Solution:
    """The windows' frames one after the other as a `Solution`; status and gradient are the worst window's.

    The motion starts at the origin: nothing measures where the person stands.
    """

    def joined(get: Callable[[Part], Array]) -> Array:
        return np.concatenate([get(p)[: p.window.keep - p.window.start] for p in parts])

    x, R_ref = joined(lambda p: p.x), joined(lambda p: p.R_ref)
    R_root = R_ref @ ori.exp(x[:, ROOT_W])
    theta = prior.complete(x[:, BODY])
    p_root = x[:, ROOT_P] - x[0, ROOT_P]
    rate, start_s = recording.rate_hz, recording.start_s
    motion = kin.unpack(p_root, R_root, theta, rate, skeleton, start_s)
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


def _constants(recording: Recording, parts: list[Part]) -> dict[str, dict[str, Any]]:
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
