"""What a task is: one kind of evidence of a frame, as a whitened residual e and its Jacobian J.

A frame minimises the sum over its tasks of |e + J dv|^2, dv (n,) rad the tangent step of the free joints
(`hybrid.point_kinematics`). A task knows no other one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hybrid.point_kinematics import Configuration
from hybrid.worn import Worn
from mocap.estimator import Pose, Sample
from mocap.orientation import Array


class Residual(NamedTuple):
    """Whitened residual e (m,) and Jacobian J (m,n): cost |e + J dv|^2."""

    e: Array
    J: Array


class Frame(NamedTuple):
    """One frame at the pose that it is linearised at: all that a task may read.

    worn: what stays the same from frame to frame. at: kinematics of the pose (`Configuration`), of the
    sensors and, by `at.on`, of any point. sample: what was measured, NaN where nothing was. seen (S,):
    sensors with a valid orientation. pose: the network's, as it gave it. xi (F,3) rad: Log(R_net^T R) of
    the free joints, R_net the network's rotations without their tremble. sigma (F,3) rad: the network's
    deviations of these joints; whitener (3F,3F): L with L^T L the inverse of their covariance. dt: s since
    the frame before.
    """

    worn: Worn
    at: Configuration
    sample: Sample
    seen: np.ndarray
    pose: Pose
    xi: Array
    sigma: Array
    whitener: Array
    dt: float


class TaskResult(NamedTuple):
    """What a task says of a frame.

    term: None where it says nothing. state: what it remembers, whatever becomes of the frame. counts: of what
    was left out, by name, for `TrackerState.counts`.
    """

    term: Residual | None
    state: Any = None
    counts: Mapping[str, int] = {}


class Task:
    """Base of all tasks. One without memory overrides `term` alone.

    Tasks hold settings; all that changes from frame to frame is in their state, which must pickle. A task
    that raises gives the frame the network's pose, and the reason tells its name.
    """

    @property
    def name(self) -> str:
        """What it is called in notes."""
        return type(self).__name__

    def start(self, worn: Worn) -> Any:
        """The state where nothing is remembered."""
        return None

    def term(self, frame: Frame) -> Residual | None:
        """Residual and Jacobian at this frame, each row divided by its standard deviation; None: nothing."""
        raise NotImplementedError

    def evidence(self, frame: Frame, state: Any) -> TaskResult:
        """`term` with the state after it."""
        return TaskResult(self.term(frame), state)

    def follow(self, frame: Frame, state: Any, dv: Array) -> tuple[Any, Mapping[str, int]]:
        """The state after the frame has been solved, by the step dv (F,3) rad, and counts of events."""
        return state, {}


def normal_equations(terms: Sequence[Residual]) -> tuple[Array, Array]:
    """H (n,n) and g (n,) of 1/2 sum |e + J dv|^2 = 1/2 dv^T H dv + g^T dv + constant."""
    J = np.concatenate([t.J for t in terms])
    e = np.concatenate([t.e for t in terms])
    return J.T @ J, J.T @ e
