"""One frame: the network's pose and the frame's measurements in, the refined pose out.

    minimise  sum_s |Log(R_meas^T R_s) + Jlog3 R_s^T J_s dv|^2 / sigma_ori^2
            + sum_s w_s |p_s + Jp_s dv - p_pred_s|^2 / P_s                       gated, Huber
            + |Log(R_net^T R) + J_r^-1 dv|^2_{Lambda_net}
            + |dv|^2 / sigma_step^2
    subject to joint limits and joint rates (a box in the rotation vectors)

linearised at R = R_net Exp(xi) Exp(phi step): xi the refinement of the frame before, step its last change,
phi = exp(-dt / step_memory_s). What the network gets wrong changes slowly, so one step a frame follows it,
and the damping holds the refinement back, not the pose. The momentum makes a low-pass of second order of
it: of what sensors shake, a third reaches the pose that a first-order one of the same lag would let through.

The network's own tremble is taken off its pose first (`smoothed`): a window that starts anew every frame
answers a little differently every frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf, dtrtri

from hybrid import limits, motion_filter, rotations, tasks
from hybrid.kinematics import Configuration, Kinematics
from hybrid.limb_qp import Answer, LimbQP
from hybrid.settings import TrackerSettings
from mocap.estimator import NO_MEASUREMENT, Pose, Sample
from mocap.orientation import Array
from mocap.skeleton import Skeleton

TRUNK = (0, 3, 6, 9)
ROOT_OFFSET_S = 0.5  # memory of the root's correction while a worn pelvis sensor is lost
NOT_CONVERGED = "the QP did not converge"


@dataclass(frozen=True, eq=False)
class Memory:
    """What one frame hands to the next.

    xi, step (F,3) rad: refinement of the free joints, R_net Exp(xi), and the tangent step that led there
    from the frame before. root (3,) rad: Log(R_net^T R_measured) of the root.
    R_free (F,3,3): the refined rotations, or None at a start. motion: the sensors' filters, p relative to
    the pelvis sensor. refused_s (S,): for how long each filter's predictions have been refused.
    R_net (24,3,3), turn (24,3) rad/s: the network's pose, smoothed, and how fast it turns; None at a start.
    """

    xi: Array
    step: Array
    root: Array
    R_free: Array | None
    motion: motion_filter.SensorMotion
    refused_s: Array
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
    qp: Answer | None


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


def free_joints(skeleton: Skeleton, joint: np.ndarray, spine: bool) -> tuple[int, ...]:
    """The joints from each sensor's bone up to the trunk; with `spine` on through the trunk.

    The root is among them where no sensor sits on it. A sensor on the trunk frees what is below it.
    """
    free: set[int] = set()
    for j in joint:
        above = skeleton.ancestors(int(j))
        keep = spine or int(j) in TRUNK
        free.update(k for k in above if k and (keep or k not in TRUNK))
    if 0 not in joint:
        free.add(0)
    return tuple(sorted(free))


class Refinement:
    """The constants of a sensor set: kinematics, QP, limits. All that changes is in `Memory`."""

    def __init__(
        self, skeleton: Skeleton, joint: np.ndarray, seat: Array, settings: TrackerSettings
    ) -> None:
        self.settings = settings
        self.joint = np.asarray(joint, int)
        at_root = np.flatnonzero(self.joint == 0)
        self.pelvis: int | None = int(at_root[0]) if len(at_root) else None
        self.free = free_joints(skeleton, self.joint, settings.spine)
        self._free = list(self.free)
        self.kinematics = Kinematics(skeleton, self.joint, seat, self.free)
        self.qp = LimbQP(3 * len(self.free)) if self.free else None
        lower, upper = limits.ranges()
        self._lower, self._upper = lower[self._free], upper[self._free]
        self._limited = np.array([j != 0 for j in self.free], bool)[:, None]
        self._scale, self._plain = (
            np.tile(np.broadcast_to(np.asarray(x, float), 24)[self._free], (3, 1)).T
            for x in (settings.network_scale, np.deg2rad(settings.network_sigma_deg))
        )
        self._floor, self._ceiling, self._sigma, self._rate, self._step = np.deg2rad(
            [
                settings.network_floor_deg,
                settings.network_ceiling_deg,
                settings.orientation_sigma_deg,
                settings.rate_limit_deg_s,
                settings.step_sigma_deg,
            ]
        )
        self._identity = np.eye(3 * len(self.free))
        self._limbs = self.joint != 0
        # The covariance seen last and what follows from it: a cache, nothing that a frame hands on.
        self._known: tuple[Array, tuple[Array, Array] | None] | None = None

    def start(self) -> Memory:
        """Nothing remembered."""
        F, S = len(self.free), len(self.joint)
        return Memory(
            np.zeros((F, 3)),
            np.zeros((F, 3)),
            np.zeros(3),
            None,
            motion_filter.stopped(S),
            np.zeros(S),
        )

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
        motion = self._predicted(memory.motion, sample, dt)
        memory = replace(memory, root=root, motion=motion, R_net=kept, turn=turn)
        unseen = "" if seen.any() else NO_MEASUREMENT
        if self.qp is None:
            return memory, Refined(R_net, pose.std_rad, unseen, {}, None)
        R, R_free = R_net.copy(), R_net[self._free]
        coast = math.exp(-dt / self.settings.step_memory_s) * memory.step
        before, onward = rotations.exp(np.array([memory.xi, coast]))
        ahead = before @ onward
        R[self._free] = R_now = R_free @ ahead
        at = self.kinematics.at(R)
        charts = self._charts(ahead, R_free, R_now, memory)
        terms, refused, events = self._terms(at, charts.xi, memory, pose, sample, seen)
        H, g = tasks.normal_equations(terms)
        answer, dv = self._solve(self.qp, H, g, charts, dt)
        if not answer.ok:
            still = np.zeros_like(memory.xi)
            R_net[1:] = pose.R_parent_joint[1:]
            memory = replace(memory, xi=still, step=still, R_free=R_net[self._free])
            return memory, Refined(R_net, pose.std_rad, NOT_CONVERGED, events, answer)
        after = ahead @ rotations.exp(dv)
        R[self._free] = R_now = R_free @ after
        xi, step = rotations.log(np.array([after, before.mT @ after]))
        motion, refused_s, events["filter restarted"] = self._follow(
            memory, at, dv, refused, sample, dt
        )
        memory = replace(memory, xi=xi, step=step, R_free=R_now, motion=motion, refused_s=refused_s)
        return memory, Refined(R, self._deviation(pose, H), unseen, events, answer)

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

    def _predicted(
        self, motion: motion_filter.SensorMotion, sample: Sample, dt: float
    ) -> motion_filter.SensorMotion:
        if self.pelvis is None or not self.settings.positions:
            return motion
        acc = np.where(sample.valid[:, None], sample.acc_world, np.nan)
        return motion_filter.predict(motion, acc - acc[self.pelvis], dt, self.settings.filter_noise)

    def _terms(
        self,
        at: Configuration,
        xi: Array,
        memory: Memory,
        pose: Pose,
        sample: Sample,
        seen: np.ndarray,
    ) -> tuple[list[tasks.Term], np.ndarray, dict[str, int]]:
        """All evidence at this configuration, the predictions refused (S,), counts of what was left out."""
        s = self.settings
        sigma, whitener = self._network_errors(pose)
        terms = [tasks.network(xi, whitener)]
        use = (seen & self._limbs).nonzero()[0]
        term, angle = tasks.orientation(at, use, sample.R_world_bone[use], self._sigma)
        terms.append(term)
        refused = np.zeros(len(self.joint), bool)
        if self.pelvis is not None and s.positions:
            use = (memory.motion.running & self._limbs).nonzero()[0]
            p, J = tasks.relative_position(at, self.pelvis)
            placed = tasks.position(
                p[use],
                J[use],
                memory.motion.p[use],
                memory.motion.covariance[use, 0],
                sigma.ravel() ** 2,
                s.position_gate_sigma,
                s.position_robust_sigma,
            )
            refused[use] = placed.refused
            terms.append(placed.term)
        turned = int((angle > tasks.MAX_ANGLE).sum())
        events = {"orientation refused": turned, "position refused": int(refused.sum())}
        return terms, refused, events

    def _charts(self, ahead: Array, R_free: Array, R_now: Array, memory: Memory) -> Charts:
        """All logarithms that this frame's problem needs, in one call; of the free joints (F,3,3) each."""
        if memory.R_free is None:
            xi, theta, proposed = rotations.log(np.array([ahead, R_now, R_free]))
            return Charts(xi, theta, proposed, None)
        back = R_now.mT @ memory.R_free
        return Charts(*rotations.log(np.array([ahead, R_now, R_free, back])))

    def _solve(
        self, qp: LimbQP, H: Array, g: Array, charts: Charts, dt: float
    ) -> tuple[Answer, Array]:
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
        low, high = tasks.box(theta, charts.proposed, self._lower, self._upper, centre, reach)
        damped = H + self._identity / (self._step**2 * dt)
        H, g = tasks.in_rotation_vectors(damped, g, B)
        answer = qp.solve(H, g, low.ravel(), high.ravel())
        return answer, _times(B, answer.x.reshape(theta.shape))

    def _follow(
        self,
        memory: Memory,
        at: Configuration,
        dv: Array,
        refused: np.ndarray,
        sample: Sample,
        dt: float,
    ) -> tuple[motion_filter.SensorMotion, Array, int]:
        """The filters after the solve, for how long each has been refused, how many started anew."""
        motion, noise = memory.motion, self.settings.filter_noise
        if self.pelvis is None or not self.settings.positions:
            return motion, memory.refused_s, 0
        p, J = tasks.relative_position(at, self.pelvis)
        solved = p + J @ dv.ravel()
        refused_s = np.where(refused, memory.refused_s + dt, 0.0)
        again = refused_s > self.settings.restart_after_s
        measured = sample.valid & np.isfinite(sample.acc_world).all(axis=1)
        begin = self._limbs & ~motion.running & measured & measured[self.pelvis]
        used = motion.running & self._limbs & ~refused
        motion = motion_filter.update(motion, solved, used, noise.solved_variance(dt))
        motion = motion_filter.start(motion, solved, begin | again, noise)
        return motion, np.where(again, 0.0, refused_s), int(again.sum())

    def _network_errors(self, pose: Pose) -> tuple[Array, Array]:
        """Of the free joints, sigma (F,3) rad and L (3F,3F) with L^T L the inverse of their covariance.

        The covariance is the network's where it gives one: errors of joints along a limb lean against each
        other, and without that the limb's end would seem less certain than it is. Otherwise it is the
        diagonal of the deviations.
        """
        if pose.covariance is not None:
            if self._known is None or self._known[0] is not pose.covariance:
                self._known = (pose.covariance, self._whitened(pose.covariance))
            if self._known[1] is not None:
                return self._known[1]
        sigma = self._network_sigma(pose)
        return sigma, self._identity / sigma.ravel()

    def _whitened(self, covariance: Array) -> tuple[Array, Array] | None:
        """`_network_errors` of a covariance (72,72); None where it is not one."""
        rows = (3 * np.array(self._free)[:, None] + np.arange(3)).ravel()
        C = covariance[np.ix_(rows, rows)]
        C = C + self._floor**2 * self._identity
        try:
            whitener = np.linalg.inv(np.linalg.cholesky(C))
        except np.linalg.LinAlgError:  # not positive definite
            return None
        return np.sqrt(C.diagonal()).reshape(-1, 3), whitener

    def _network_sigma(self, pose: Pose) -> Array:
        """(F,3) rad: the network's deviation of the free joints, scaled and kept in bounds."""
        sigma = self._plain
        if pose.std_rad is not None:
            stated = pose.std_rad[self._free]
            known = np.isfinite(stated) & (stated > 0)
            sigma = np.where(known, stated * self._scale, sigma)
        return np.minimum(np.maximum(sigma, self._floor), self._ceiling)

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
