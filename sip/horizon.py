"""The same cost over a window that moves along with time: one Gauss-Newton step a frame.

A third way to solve the built problem, beside `sip.solvers.banded` and `sip.solvers.ipopt`. The frame that
leaves the window is eliminated: what it knew becomes a quadratic on the frames that follow it and on the
sensors' constants (`sip.terms.arrival`). A window as long as the recording, iterated, has the answer of
`sip.solve`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap import checked
from mocap import orientation as ori
from mocap.errors import SolveError
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip.belief import Listener, PoseBelief
from sip.initial import root_of_sensors
from sip.kinematics import BODY, ROOT_P, ROOT_W
from sip.model import CONSTANTS, Evidence, Model, overcount
from sip.problem import Problem
from sip.sensor_kinematics import SensorKinematics
from sip.settings import DEG, Settings
from sip.solvers.band import Band, Factor, NotPositiveDefinite
from sip.terms.arrival import Arrival, eliminated, of_constants
from sip.terms.base import Point, Term

_LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e4
_STEP_ROOT, _STEP_ANGLE = 1.0, 0.2  # m, rad: units of the damping, as in `sip.solvers.banded`
_CARRIED_ON = 0.7  # of the body's last change, expected once more


@dataclass(frozen=True)
class HorizonSettings:
    """seconds: length of the window. memory_s: what has left it counts less by 1/e in this time
    (infinite: for ever). steps: of Gauss-Newton a frame; until the window is full, `growing_steps`.
    walk_*: how far a sensor's mounting (rad), heading (rad) and bias (m/s^2) wander in one second, one
    sigma, growing with the root of time; they count where the settings say self_calibration.
    """

    seconds: float = 0.4
    memory_s: float = 0.8
    steps: int = 1
    growing_steps: int = 3
    walk_mounting: float = 0.1 * DEG
    walk_heading: float = 1.0 * DEG
    walk_bias: float = 0.005

    def __post_init__(self) -> None:
        checked.settings(self, infinite=("memory_s",), error=SolveError)
        for name in ("seconds", "memory_s"):
            if not getattr(self, name) > 0:
                raise SolveError(
                    f"HorizonSettings: {name} must be positive, got {getattr(self, name)!r}"
                )
        for name in ("steps", "growing_steps"):
            if getattr(self, name) < 1:
                raise SolveError(
                    f"HorizonSettings: {name} must be 1 or more, got {getattr(self, name)!r}"
                )


@dataclass(frozen=True, eq=False)
class HorizonState:
    """All that one frame hands to the next; pickle it to go on later.

    evidence, point: of the window's frames, oldest first. frames: seen so far. damping: of the steps.
    doubt (S,), heard (S,): sums, fading over `network_memory_s`, of how far the network is from the sensors
    and of how often that was seen. cost: after the last step, in sigmas squared. factor: of the last step
    since the newest frame came; never kept longer.
    """

    evidence: Evidence | None = None
    point: Point | None = None
    arrival: Arrival | None = None
    frames: int = 0
    damping: float = 0.1
    doubt: Array = field(default_factory=lambda: np.zeros(0))
    heard: Array = field(default_factory=lambda: np.zeros(0))
    cost: float = 0.0
    factor: Factor | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Without what the next frame does not look at."""
        return vars(self) | {"factor": None}

    def __len__(self) -> int:
        return 0 if self.evidence is None else len(self.evidence)


@dataclass(frozen=True, eq=False)
class HorizonPose:
    """The pose of one frame of the window: R_parent_joint (24,3,3), p_world_root (3,) m, and where asked for
    std_rad (24,3) of the joints' rotation vectors.
    """

    R_parent_joint: Array
    p_world_root: Array
    std_rad: Array | None = None


class Horizon:
    """The constants of a body with sensors; all that changes is in `HorizonState`.

    joint (S,), placement (S,3) m: where the sensors sit. listening: whether a network's poses are given.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        joint: NDArray[np.int64],
        placement: Array,
        rate_hz: float,
        settings: Settings | None = None,
        how: HorizonSettings | None = None,
        listening: bool = False,
    ):
        settings, self.how = settings or Settings(), how or HorizonSettings()
        self.kinematics = SensorKinematics(skeleton, joint, placement)
        # A window that everything draws to the origin would never leave it: damping alone holds its place.
        self.model = Model(skeleton, settings, self.kinematics, rate_hz, listening, False)
        self.joint = np.asarray(joint, int)
        pelvis = np.flatnonzero(self.joint == 0)
        self.pelvis: int | None = int(pelvis[0]) if len(pelvis) else None
        self.listener = Listener(skeleton, self.kinematics, self.joint, settings)
        probe = Evidence.blank(64, self.kinematics.S)
        if self.model.has_contact:
            probe = replace(probe, stands=np.zeros((64, self.model.soles.P)))
        self.reaches = sorted({t.reach for t in self.model.frame_terms(probe)})
        self.reach = self.reaches[-1]
        self.size = max(round(self.how.seconds * rate_hz), self.reach + 2)
        self.kept = float(np.exp(-1 / (self.how.memory_s * rate_hz)))
        walk = np.r_[[self.how.walk_mounting] * 3, self.how.walk_heading, [self.how.walk_bias] * 3]
        per_frame = walk**2 / rate_hz / overcount(rate_hz, settings)
        self.walk = np.tile(per_frame, self.kinematics.S) if self.model.border else np.zeros(0)
        self._units = np.r_[np.full(3, _STEP_ROOT), np.full(self.kinematics.n - 3, _STEP_ANGLE)]

    def init(self) -> HorizonState:
        """Nothing seen yet."""
        S = self.kinematics.S
        return HorizonState(doubt=np.zeros(S), heard=np.zeros(S))

    def step(
        self, state: HorizonState, frame: Evidence, belief: PoseBelief | None = None, age: int = 0
    ) -> HorizonState:
        """The state after one more frame, and after the Gauss-Newton steps that it is worth.

        frame: its evidence, one frame long. belief: what the network says about the frame `age` frames
        before it, one frame long. Frames before the first that has any orientation tell nothing and are left
        out. Raises SolveError where no finite cost can be had.
        """
        if not len(state) and not frame.ori_valid.any():
            return state
        state = self.grounded(self._entered(replace(state, factor=None), frame))
        full = len(state) == self.size
        steps = self.how.steps if full else self.how.growing_steps
        if belief is None or age >= len(state) or not belief.valid[0]:
            return self._after(state, steps)
        first = not state.heard.any()
        state = self._listened(state, belief, len(state) - 1 - age)
        here = self._after(state, steps)
        if not first or full:
            return here
        # Its first word may lie in a better valley than the prior's mean, where the window began.
        there = self._after(self._posed(state, belief), steps)
        return min(here, there, key=self.cost)

    def grounded(self, state: HorizonState) -> HorizonState:
        """The state in which what stands is judged by the poses as they are."""
        evidence, point = state.evidence, state.point
        if evidence is None or point is None or not self.model.has_contact:
            return state
        stands = self.model.standing(point.x, point.R_ref)
        return replace(state, evidence=replace(evidence, stands=stands))

    def cost(self, state: HorizonState) -> float:
        """The window's, in sigmas squared."""
        assert state.point is not None
        return self.problem(state).cost(state.point)

    def _after(self, state: HorizonState, steps: int) -> HorizonState:
        for _ in range(steps):
            state = self.improved(state)
        return state

    def _posed(self, state: HorizonState, belief: PoseBelief) -> HorizonState:
        """The state with the network's pose in every frame of the window."""
        evidence, point = state.evidence, state.point
        assert evidence is not None and point is not None
        x = point.x.copy()
        angles = ori.log(belief.R_parent_joint[0, list(self.kinematics.active)]).ravel()
        x[:, BODY] = angles
        return replace(state, point=self._at(x, point.R_ref, point.u, evidence))

    def problem(self, state: HorizonState) -> Problem:
        """The window's, as any solver takes it."""
        assert state.evidence is not None and state.arrival is not None
        terms: list[Term] = [*self.model.frame_terms(state.evidence), state.arrival]
        return Problem(self.model, state.evidence, terms)

    def improved(self, state: HorizonState) -> HorizonState:
        """The state after one damped Gauss-Newton step; it stays where that would not lower the cost."""
        problem, point = self.problem(state), state.point
        assert point is not None
        residuals = problem.residuals(point)
        cost = problem.total(residuals)
        if not np.isfinite(cost):
            raise SolveError("the window's cost is not finite")
        grad, grad_u = problem.pullback(point, residuals)
        try:
            factor = self._factor(problem, point, state.damping)
        except NotPositiveDefinite:
            return replace(state, damping=min(state.damping * 10, _MOST_DAMPING), factor=None)
        dx, du = factor.solve(-grad, -grad_u)
        u = point.u + du.reshape(-1, CONSTANTS) if len(du) else point.u
        trial = problem.point(point.x + dx, point.R_ref, u)
        after = problem.cost(trial)
        if not after <= cost:
            damping = min(state.damping * 8, _MOST_DAMPING)
            return replace(state, damping=damping, cost=cost, factor=factor)
        damping = max(state.damping / 4, _LEAST_DAMPING)
        return replace(state, point=trial, damping=damping, cost=after, factor=factor)

    def _factor(self, problem: Problem, point: Point, damping: float) -> Factor:
        return Factor(problem.hessian(point), damping / self._units**2, damping)

    def pose(self, state: HorizonState, lag: int = 0, deviation: bool = False) -> HorizonPose:
        """That of the frame `lag` frames before the newest, or of the oldest there is."""
        assert state.point is not None
        t = max(len(state) - 1 - lag, 0)
        x, R_ref = state.point.x[t], state.point.R_ref[t]
        R = np.empty((24, 3, 3))
        R[0] = R_ref @ ori.exp(x[ROOT_W])
        R[1:] = ori.exp(self.model.prior.complete(x[None, BODY]).reshape(23, 3))
        return HorizonPose(R, x[ROOT_P].copy(), self._deviation(state, t) if deviation else None)

    def _deviation(self, state: HorizonState, t: int) -> Array:
        assert state.point is not None
        factor = state.factor
        if factor is None:
            factor = self._factor(self.problem(state), state.point, 1e-6)
        block = factor.inverse_block(t)
        body = self.model.prior.complete_variance(block[None, BODY, BODY])[0]
        return np.sqrt(np.concatenate([np.diag(block)[ROOT_W], body])).reshape(24, 3)

    def _entered(self, state: HorizonState, frame: Evidence) -> HorizonState:
        """The state with one more frame, guessed, and without the oldest where the window is full."""
        if self.model.listening and frame.belief is None:
            frame = replace(frame, belief=self.listener.nothing(1))
        frames = state.frames + 1
        if state.evidence is None or state.point is None:
            u = np.zeros((self.kinematics.S, CONSTANTS))
            point = self._at(*self._first(frame), u, frame)
            sigma = np.tile(self.model.constants_sigma, self.kinematics.S)
            arrival = of_constants(sigma, u, self.model.border, self.kinematics.n)
            return replace(state, evidence=frame, point=point, arrival=arrival, frames=frames)
        if len(state) == self.size:
            state = self.without_oldest(state)
        assert state.evidence is not None and state.point is not None
        guess = self._at(*self._guess(state, frame), state.point.u, frame)
        evidence, point = state.evidence.then(frame), state.point.then(guess)
        return replace(state, evidence=evidence, point=point, frames=frames)

    def _at(self, x: Array, R_ref: Array, u: Array, frame: Evidence) -> Point:
        out = self.kinematics.evaluate(x, R_ref, frame.R, u, True)
        return Point(x, R_ref, u, *out)

    def _first(self, frame: Evidence) -> tuple[Array, Array]:
        x = np.zeros((1, self.kinematics.n))
        x[:, BODY] = self.model.prior.mean
        R = self._measured_root(frame)
        if R is None:
            R = root_of_sensors(frame, self.joint, self.model.skeleton, self.model.prior.prior)
        return x, R

    def _measured_root(self, frame: Evidence) -> Array | None:
        if self.pelvis is None or not frame.ori_valid[0, self.pelvis]:
            return None
        return frame.R[:, self.pelvis]

    def _guess(self, state: HorizonState, frame: Evidence) -> tuple[Array, Array]:
        """x (1,n) and R_ref (1,3,3) of the frame that follows: root and body move on."""
        point = state.point
        assert point is not None
        x, last = point.x[-1:].copy(), point.R_ref[-1]
        if len(point.x) > 1:
            x[:, ROOT_P] += point.x[-1:, ROOT_P] - point.x[-2:-1, ROOT_P]
            x[:, BODY] += _CARRIED_ON * (point.x[-1:, BODY] - point.x[-2:-1, BODY])
        R = self._measured_root(frame)
        if R is None:
            R = (last @ ori.exp(x[0, ROOT_W]))[None]
            x[:, ROOT_W] = 0
        return x, R

    def without_oldest(self, state: HorizonState) -> HorizonState:
        """The state without the oldest frame, which the arrival cost now stands for."""
        evidence, point, arrival = state.evidence, state.point, state.arrival
        assert evidence is not None and point is not None and arrival is not None
        frames = self.reach + 1
        H, g = self._of_first(evidence.slice(0, frames), point.slice(0, frames), arrival)
        x = point.x[:frames]
        arrival = eliminated(H, g, frames, x, point.u, self.kept, self.walk)
        rest = len(evidence)
        return replace(
            state, evidence=evidence.slice(1, rest), point=point.slice(1, rest), arrival=arrival
        )

    def _of_first(self, evidence: Evidence, point: Point, arrival: Arrival) -> tuple[Array, Array]:
        """Gauss-Newton matrix and gradient, dense, of all terms that the first frame has a part in."""
        T, n, border = self.reach + 1, self.kinematics.n, self.model.border
        known = self._first_constant
        band = Band(known.blocks.copy(), known.border.copy(), known.corner.copy())
        grad, grad_u = np.zeros((T, n)), np.zeros((self.kinematics.S, CONSTANTS))
        for reach in self.reaches:
            # As many frames as a term reaches hold one residual of it: that of the first frame.
            some, here = evidence.slice(0, reach + 1), point.slice(0, reach + 1)
            part = Band(band.blocks[: reach + 1], band.border[: reach + 1], band.corner)
            for term in self.model.frame_terms(some, reach):
                if not term.constant:
                    term.hessian(here, part)
                term.pullback(here, term.residual(here), grad[: reach + 1], grad_u)
        arrival.hessian(point, band)
        arrival.pullback(point, arrival.residual(point), grad, grad_u)
        return band.dense(), np.concatenate([grad.ravel(), grad_u.ravel()[:border]])

    @cached_property
    def _first_constant(self) -> Band:
        """That part of the matrix in `_of_first` which is the same everywhere; not to be written to."""
        n = self.kinematics.n
        band = Band.zeros(self.reach + 1, self.reach, n, self.model.border)
        blank = Point(np.zeros((self.reach + 1, n)), *[np.zeros(0)] * 4)
        for term in (t for t in self.model.body if t.constant):
            many = term.reach + 1
            part = Band(band.blocks[:many], band.border[:many], band.corner)
            term.hessian(blank.slice(0, many), part)
        return band

    def _listened(self, state: HorizonState, belief: PoseBelief, t: int) -> HorizonState:
        """The state with the network's word about frame t of the window."""
        evidence = state.evidence
        assert evidence is not None and evidence.belief is not None
        R, ok = evidence.R[t : t + 1], evidence.ori_valid[t : t + 1]
        ratio, there = self.listener.disagreement(belief, R, ok)
        memory = self.model.settings.network_memory_s * self.model.rate_hz
        fade = float(np.exp(-1 / memory))
        doubt, heard = fade * state.doubt + ratio[0] * there[0], fade * state.heard + there[0]
        mean = doubt / np.maximum(heard, 1e-9)
        inflation = self.listener.inflation(mean[None], (heard[None] > 0.5).astype(float))
        said = self.listener.of(belief, inflation)
        b = evidence.belief
        joined = b.slice(0, t).then(said).then(b.slice(t + 1, len(b)))
        evidence = replace(evidence, belief=joined)
        return replace(state, evidence=evidence, doubt=doubt, heard=heard)


def run(
    horizon: Horizon,
    recording: Recording,
    lag: int,
    belief: PoseBelief | None = None,
    age: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Array, Array]:
    """A recording, frame by frame: R_parent_joint (T,24,3,3) and p_world_root (T,3) m, each frame's as it was
    `lag` frames later.

    belief: of the recording's frames; each is heard `age` frames later. Frames before the first with any
    orientation get that one's pose. progress(fraction, words) is called from time to time.
    """
    T = len(recording)
    evidence = Evidence.of(recording)
    state = horizon.init()
    R, p = np.empty((T, 24, 3, 3)), np.empty((T, 3))
    first = int(recording.ori_valid.any(axis=1).argmax())
    for t in range(first, T + lag):
        if t < T:
            said = belief.slice(t - age, t - age + 1) if belief is not None and t >= age else None
            state = horizon.step(state, evidence.slice(t, t + 1), said, age)
            if progress and t % 10 == 0:
                progress(t / T, f"frame {t} of {T}")
        if t >= lag + first:
            pose = horizon.pose(state, min(lag, T - 1 - (t - lag)))
            R[t - lag], p[t - lag] = pose.R_parent_joint, pose.p_world_root
    R[:first], p[:first] = R[first], p[first]
    return R, p
