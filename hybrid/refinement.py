"""One frame: the network's pose and the frame's measurements in, the refined pose out.

    minimise  sum over tasks |e + J dv|^2  +  |dv|^2 / sigma_step^2
    subject to joint limits and joint rates (a box in the rotation vectors)

The standard tasks (`hybrid.tasks`):

    sum_s |Log(R_meas^T R_s) + Jlog3 R_s^T J_s dv|^2 / sigma_ori^2
    sum_s w_s |p_s + Jp_s dv - p_pred_s|^2 / P_s                       gated, Huber
    |Log(R_net^T R) + J_r^-1 dv|^2_{Lambda_net}

linearised at R = R_net Exp(xi) Exp(phi step): xi the refinement of the frame before, step its last change,
phi = exp(-dt / step_memory_s). What the network gets wrong changes slowly, so one step a frame follows it,
and the damping holds the refinement back, not the pose. The momentum makes a low-pass of second order of
it: of what sensors shake, a third reaches the pose that a first-order one of the same lag would let through.

The network's own tremble is taken off its pose first (`smoothed`): a window that starts anew every frame
answers a little differently every frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf, dtrtri

from hybrid import limits, rotations, tasks
from hybrid.joint_box import box, in_rotation_vectors
from hybrid.limb_qp import LimbQP, QPSolution
from hybrid.network_errors import NetworkErrors
from hybrid.point_kinematics import Kinematics
from hybrid.settings import TrackerSettings
from hybrid.tasks.task import Frame, Residual, Task, normal_equations
from hybrid.worn import Worn, free_joints
from mocap.errors import ShapeError
from mocap.estimator import NO_MEASUREMENT, Pose, Sample
from mocap.orientation import Array
from mocap.skeleton import Skeleton

ROOT_OFFSET_S = 0.5  # memory of the root's correction while a worn pelvis sensor is lost
NOT_CONVERGED = "the QP did not converge"


@dataclass(frozen=True, eq=False)
class Memory:
    """What one frame hands to the next.

    xi, step (F,3) rad: refinement of the free joints, R_net Exp(xi), and the tangent step that led there
    from the frame before. root (3,) rad: Log(R_net^T R_measured) of the root.
    R_free (F,3,3): the refined rotations, or None at a start. tasks: each task's own state.
    R_net (24,3,3), turn (24,3) rad/s: the network's pose, smoothed, and how fast it turns; None at a start.
    """

    xi: Array
    step: Array
    root: Array
    R_free: Array | None
    tasks: tuple[Any, ...]
    R_net: Array | None = None
    turn: Array | None = None


@dataclass(frozen=True, eq=False)
class Refined:
    """R_parent_joint (24,3,3), std_rad (24,3) or None, what happened. reason: why it is the network's
    pose; empty when it is refined. events: counts of what was left out. qp: the QP's answer.
    """

    R_parent_joint: Array
    std_rad: Array | None
    reason: str
    events: Mapping[str, int]
    qp: QPSolution | None


class Charts(NamedTuple):
    """Rotation vectors (F,3) rad of the free joints at the linearisation: xi from the network's, theta
    of the joint, proposed by the network, back to the frame before (None at a start).
    """

    xi: Array
    theta: Array
    proposed: Array
    back: Array | None


def smoothed(
    R_before: Array, turn: Array, R_now: Array, dt: float, memory_s: float
) -> tuple[Array, Array]:
    """The critically damped g-h filter on rotations: R (J,3,3) and turning rates (J,3) rad/s.

    Predicted: R_before Exp(turn dt); innovation i = Log(predicted^T R_now); R = predicted Exp(g i),
    turn + h i / dt, with theta = exp(-dt / memory_s), g = 1 - theta^2, h = (1 - theta)^2
    (Brookner 1998, 1.2.6). It follows a constant rate without lag.
    """
    theta = math.exp(-dt / memory_s)
    ahead = R_before @ rotations.exp(turn * dt)
    i = rotations.log(ahead.mT @ R_now)
    return ahead @ rotations.exp((1 - theta**2) * i), turn + (1 - theta) ** 2 * i / dt


class TaskFailed(Exception):
    """A task raised; the argument is the reason for the note."""


class Refinement:
    """The constants of a sensor set: kinematics, QP, limits. All that changes is in `Memory`.

    frame_tasks: what makes the cost; default, `hybrid.tasks.standard` of the settings.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        joint: np.ndarray,
        seat: Array,
        settings: TrackerSettings,
        frame_tasks: Sequence[Task] | None = None,
    ) -> None:
        self.settings = settings
        joint = np.asarray(joint, int)
        free = free_joints(skeleton, joint, settings.spine)
        self.worn = Worn(skeleton, joint, np.asarray(seat, float), free)
        self.tasks = tasks.standard(settings) if frame_tasks is None else tuple(frame_tasks)
        self._free = list(free)
        self.kinematics = Kinematics(skeleton, joint, seat, free)
        self.qp = LimbQP(3 * len(free)) if free else None
        self._errors = NetworkErrors(settings, free)
        lower, upper = limits.ranges()
        self._lower, self._upper = lower[self._free], upper[self._free]
        self._limited = np.array([j != 0 for j in free], bool)[:, None]
        self._rate, self._step = np.deg2rad([settings.rate_limit_deg_s, settings.step_sigma_deg])
        self._identity = np.eye(3 * len(free))
        self._nothing = np.zeros((3 * len(free),) * 2), np.zeros(3 * len(free))

    @property
    def free(self) -> tuple[int, ...]:
        """The joints that may move."""
        return self.worn.free

    @property
    def pelvis(self) -> int | None:
        """The sensor at the pelvis, where one is worn."""
        return self.worn.pelvis

    def start(self) -> Memory:
        """Nothing remembered."""
        F = len(self.free)
        states = tuple(task.start(self.worn) for task in self.tasks)
        return Memory(np.zeros((F, 3)), np.zeros((F, 3)), np.zeros(3), None, states)

    def refine(
        self, memory: Memory, pose: Pose, sample: Sample, dt: float
    ) -> tuple[Memory, Refined]:
        """Refine the network's `pose` by the `sample` of its own time, dt s after the frame before.

        The pose must be orthonormal, valid samples finite and orthonormal, dt positive.
        """
        R_net, turn = self._smoothed(memory, pose, dt)
        seen = sample.valid & np.isfinite(sample.R_world_bone).all((-1, -2))
        kept = R_net.copy()
        root = self._measured_root(R_net, sample, seen, memory, dt)
        memory = replace(memory, root=root, R_net=kept, turn=turn)
        unseen = "" if seen.any() else NO_MEASUREMENT
        if self.qp is None:
            return memory, Refined(R_net, pose.std_rad, unseen, {}, None)
        R, R_free = R_net.copy(), R_net[self._free]
        coast = math.exp(-dt / self.settings.step_memory_s) * memory.step
        before, onward = rotations.exp(np.array([memory.xi, coast]))
        ahead = before @ onward
        R[self._free] = R_now = R_free @ ahead
        charts = self._charts(ahead, R_free, R_now, memory)
        at = self.kinematics.at(R)
        errors = self._errors.of(pose)
        frame = Frame(self.worn, at, sample, seen, pose, charts.xi, *errors, dt)
        events: dict[str, int] = {}
        answer = None
        try:
            terms, states = self._evidence(frame, memory.tasks, events)
            H, g = normal_equations(terms) if terms else self._nothing
            answer, dv = self._solve(self.qp, H, g, charts, dt)
            memory = replace(memory, tasks=states)
            if not answer.ok:
                return self._unrefined(memory, R_net, pose, NOT_CONVERGED, events, answer)
            memory = replace(memory, tasks=self._followed(frame, states, dv, events))
        except TaskFailed as e:
            return self._unrefined(memory, R_net, pose, str(e), events, answer)
        after = ahead @ rotations.exp(dv)
        R = R.copy()  # the one before belongs to the frame's kinematics
        R[self._free] = R_now = R_free @ after
        xi, step = rotations.log(np.array([after, before.mT @ after]))
        memory = replace(memory, xi=xi, step=step, R_free=R_now)
        return memory, Refined(R, self._deviation(pose, H), unseen, events, answer)

    def _unrefined(
        self,
        memory: Memory,
        R_net: Array,
        pose: Pose,
        reason: str,
        events: Mapping[str, int],
        answer: QPSolution | None,
    ) -> tuple[Memory, Refined]:
        """The network's pose under the measured root, and the refinement begun anew."""
        still = np.zeros_like(memory.xi)
        R_net[1:] = pose.R_parent_joint[1:]
        memory = replace(memory, xi=still, step=still, R_free=R_net[self._free])
        return memory, Refined(R_net, pose.std_rad, reason, events, answer)

    def _smoothed(self, memory: Memory, pose: Pose, dt: float) -> tuple[Array, Array]:
        """The network's pose (24,3,3) without its tremble and its turning rates (24,3) rad/s."""
        memory_s = self.settings.network_memory_s
        if memory_s > 0 and memory.R_net is not None and memory.turn is not None:
            return smoothed(memory.R_net, memory.turn, pose.R_parent_joint, dt, memory_s)
        R = np.array(pose.R_parent_joint)
        return R, np.zeros((len(R), 3))

    def _measured_root(
        self, R_net: Array, sample: Sample, seen: np.ndarray, memory: Memory, dt: float
    ) -> Array:
        """Put the pelvis sensor's rotation into R_net; returns the correction, for `Memory.root`.

        While the sensor is lost its last correction of the network's root fades out.
        """
        if self.pelvis is None:
            return memory.root
        if seen[self.pelvis]:
            R = sample.R_world_bone[self.pelvis]
            correction = pin.log3(R_net[0].T @ R)
            R_net[0] = R
            return correction
        correction = memory.root * math.exp(-dt / ROOT_OFFSET_S)
        R_net[0] = R_net[0] @ rotations.exp(correction)
        return correction

    def _evidence(
        self, frame: Frame, states: tuple[Any, ...], events: dict[str, int]
    ) -> tuple[list[Residual], tuple[Any, ...]]:
        """All terms at this frame and the tasks' states after it; adds to `events`."""
        terms, after = [], []
        for task, state in zip(self.tasks, states, strict=True):
            try:
                term, state, counts = task.evidence(frame, state)
                if term is not None and np.shape(term.J) != (len(term.e), len(self._identity)):
                    raise ShapeError(f"J is {np.shape(term.J)} for a residual of {len(term.e)}")
            except Exception as e:  # code that may not be ours: the frame gets a pose
                raise _failed(task, e) from e
            if term is not None:
                terms.append(term)
            after.append(state)
            _count(events, counts)
        return terms, tuple(after)

    def _followed(
        self, frame: Frame, states: tuple[Any, ...], dv: Array, events: dict[str, int]
    ) -> tuple[Any, ...]:
        """The tasks' states after the solve; adds to `events`."""
        after = []
        for task, state in zip(self.tasks, states, strict=True):
            try:
                state, counts = task.follow(frame, state, dv)
            except Exception as e:
                raise _failed(task, e) from e
            after.append(state)
            _count(events, counts)
        return tuple(after)

    def _charts(self, ahead: Array, R_free: Array, R_now: Array, memory: Memory) -> Charts:
        """All logarithms that this frame's problem needs, in one call; of the free joints (F,3,3) each."""
        if memory.R_free is None:
            xi, theta, proposed = rotations.log(np.array([ahead, R_now, R_free]))
            return Charts(xi, theta, proposed, None)
        back = R_now.mT @ memory.R_free
        return Charts(*rotations.log(np.array([ahead, R_now, R_free, back])))

    def _solve(
        self, qp: LimbQP, H: Array, g: Array, charts: Charts, dt: float
    ) -> tuple[QPSolution, Array]:
        """The QP's answer in rotation-vector steps, and the same as tangent steps dv (F,3).

        H, g: the evidence in tangent steps; the damping comes on top of it.
        """
        theta = charts.theta
        # The root's rotation vector has no limits and may pass the half turn: its chart is its tangent,
        # as that of a joint at rest.
        B = rotations.right_jacobian(theta * self._limited)
        centre, reach = np.zeros_like(theta), np.inf
        if charts.back is not None:
            centre[:] = np.linalg.solve(B, charts.back[..., None])[..., 0]
            reach = self._rate * dt
        low, high = box(theta, charts.proposed, self._lower, self._upper, centre, reach)
        damped = H + self._identity / (self._step**2 * dt)
        H, g = in_rotation_vectors(damped, g, B)
        answer = qp.solve(H, g, low.ravel(), high.ravel())
        return answer, _times(B, answer.x.reshape(theta.shape))

    def _deviation(self, pose: Pose, H: Array) -> Array | None:
        """(24,3) rad: for the free joints sqrt(diag(H^-1)), for the others the network's.

        H (n,n): the evidence of network and sensors in tangent steps, so that the deviation is one of
        Log(R_estimated^T R_true). The damping is not in it: it says how fast the answer may move.
        """
        if pose.std_rad is None:
            return None
        factor, bad = dpotrf(H)  # H = U^T U, so H^-1 = U^-1 U^-T
        if bad:
            return pose.std_rad
        inverse = dtrtri(factor)[0]
        out = np.array(pose.std_rad, float)
        out[self._free] = np.sqrt(np.vecdot(inverse, inverse)).reshape(-1, 3)
        return out


def _times(M: Array, v: Array) -> Array:
    """M v (F,3) of matrices (F,3,3) and vectors (F,3)."""
    return (M @ v[..., None])[..., 0]


def _failed(task: Task, e: Exception) -> TaskFailed:
    """The error that names the task and what it raised."""
    return TaskFailed(f"task {task.name} failed ({type(e).__name__})")


def _count(events: dict[str, int], counts: Mapping[str, int]) -> None:
    """Add counts to events, in place."""
    for name, times in counts.items():
        events[name] = events.get(name, 0) + times
