"""The built problem: cost, gradient and Gauss-Newton matrix of a model on some evidence.

Building and solving are two steps; the solvers (`sip.solvers.banded`, `sip.solvers.ipopt`) see only this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip import kinematics as kin
from sip.belief import FrameBeliefs
from sip.model import CONSTANTS, Evidence, Model
from sip.prior import Conditioned
from sip.sensor_kinematics import SensorKinematics
from sip.settings import Settings
from sip.solvers.band import Band
from sip.solvers.box import Box
from sip.terms.base import Point, Term
from sip.terms.smoothness import LinearSmoothness, RootSmoothness


@dataclass
class Problem:
    """A sequence, as seen by a solver.

    x (T,n) with R_ref (T,3,3) as in `sip.kinematics`; u (S,7) sensor constants (zero unless
    `self_calibration`). fixed: the first frames of x that are given, not solved for (a window's past).
    """

    model: Model
    evidence: Evidence
    terms: list[Term]
    fixed: int = 0

    @property
    def T(self) -> int:
        return len(self.evidence)

    @property
    def S(self) -> int:
        return self.model.kinematics.S

    @property
    def settings(self) -> Settings:
        return self.model.settings

    @property
    def prior(self) -> Conditioned:
        return self.model.prior

    @property
    def n(self) -> int:
        """Unknowns per frame."""
        return self.model.kinematics.n

    @property
    def border(self) -> int:
        """Number of unknowns that live through the whole sequence."""
        return self.model.border

    @cached_property
    def box(self) -> Box:
        """The joint limits as bounds; what is given is not bounded."""
        lower = np.full((self.T, self.n), -np.inf)
        upper = np.full((self.T, self.n), np.inf)
        lower[self.fixed :, kin.BODY] = self.prior.lower
        upper[self.fixed :, kin.BODY] = self.prior.upper
        return Box(lower, upper)

    @cached_property
    def reach(self) -> int:
        """Frames that a term reaches at most: the number of block diagonals below the main one."""
        return max(t.reach for t in self.terms)

    @property
    def dense_reach(self) -> int:
        """Frames apart that any two unknowns may couple (accelerations), beyond constant terms."""
        return max(
            t.reach for t in self.terms if not isinstance(t, LinearSmoothness | RootSmoothness)
        )

    def point(self, x: Array, R_ref: Array, u: Array, jacobian: bool = True) -> Point:
        """The kinematics at these unknowns."""
        out = self.model.kinematics.evaluate(x, R_ref, self.evidence.R, u, jacobian)
        return Point(x, R_ref, u, *out)

    def cost(self, point: Point) -> float:
        """The total."""
        return self.total(self.residuals(point))

    def total(self, residuals: list[Array]) -> float:
        """The cost of whitened residuals of each term."""
        return sum(t.loss(r) for t, r in zip(self.terms, residuals, strict=True))

    def pullback(self, point: Point, residuals: list[Array]) -> tuple[Array, Array]:
        """J^T W v for v per term: (T,n) (zero for fixed frames) and (g,)."""
        grad, grad_u = np.zeros((self.T, self.n)), np.zeros((self.S, CONSTANTS))
        for term, v in zip(self.terms, residuals, strict=True):
            term.pullback(point, v, grad, grad_u)
        grad[: self.fixed] = 0
        return grad, grad_u.ravel()[: self.border]

    def residuals(self, point: Point) -> list[Array]:
        """Whitened residuals of each term."""
        return [t.residual(point) for t in self.terms]

    def gradient(self, point: Point) -> tuple[Array, Array]:
        """d cost/dx (T,n) (zero for fixed frames) and d cost/du (g,)."""
        return self.pullback(point, self.residuals(point))

    def hessian(self, point: Point) -> Band:
        """The Gauss-Newton matrix with the robust weights; fixed frames have the identity."""
        known, c = self.model.constant(self.T, self.reach)
        band = Band(c.blocks.copy(), c.border.copy(), c.corner.copy())
        for term in self.terms:
            if term not in known:
                term.hessian(point, band)
        f = self.fixed
        if f:
            for d in range(self.reach + 1):
                # Every block with a column or row before frame f couples to a constant.
                band.blocks[:f, d] = 0
            band.blocks[:f, 0] = np.eye(self.n)
            band.border[:f] = 0
        return band


def build(
    recording: Recording,
    skeleton: Skeleton,
    settings: Settings,
    kinematics: SensorKinematics | None = None,
    fixed: int = 0,
    belief: FrameBeliefs | None = None,
) -> Problem:
    """The problem of this recording. Terms as in the design's table; SOP has no acceleration term."""
    k = kinematics or SensorKinematics(skeleton, recording.joint, recording.placement)
    model = Model(skeleton, settings, k, recording.rate_hz, belief is not None)
    evidence = Evidence.of(recording, belief)
    extra = [make(recording, k) for make in settings.extra]
    terms = model.terms(evidence) + [t for t in extra if t.reach < len(recording)]
    return Problem(model, evidence, terms, fixed)


def grounded(problem: Problem, point: Point) -> Problem:
    """The same problem with what stands judged by the poses at `point`."""
    model, evidence = problem.model, problem.evidence
    evidence = replace(evidence, stands=model.standing(point.x, point.R_ref))
    known = {t.name for t in model.terms(evidence)}
    extra = [t for t in problem.terms if t.name not in known]
    return replace(problem, evidence=evidence, terms=model.terms(evidence) + extra)


def reference_root(recording: Recording) -> Array | None:
    """R_ref (T,3,3): the pelvis measurement, slerped over gaps; None where no pelvis sensor works."""
    at = np.flatnonzero(recording.joint == 0)
    if not len(at):
        return None
    s = at[0]
    ok = recording.ori_valid[:, s]
    if not ok.any():
        return None
    times = np.arange(len(recording), dtype=float)
    return ori.interpolate(times[ok], recording.R_world_bone[ok, s], times)
