"""Poses of chosen points on the body and their Jacobians, through Pinocchio, at one frame's cost.

Unknown of the whole package: dv (n,) rad, the right-tangent step of the free joints, three numbers each,
R_parent_joint_j <- R_parent_joint_j Exp(dv_j) (for the root R_world_root <- R_world_root Exp(dv_0)).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hybrid import rotations
from mocap.orientation import Array
from mocap.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Configuration:
    """Kinematics of one pose, pelvis joint at the origin: whoever holds one cannot use stale ones.

    R_world_bone (S,3,3) and p_world (S,3) m: of each point's bone, and of the point. J_rotation (S,3,n):
    R_world_bone(dv) = Exp(J_rotation dv) R_world_bone, so world axes. J_origin (S,3,n) m/rad: velocity of
    that part of the bone's space which is at the world's origin. R_parent_joint (24,3,3): the pose itself;
    tree: whose points and free joints these are; J (6,n): the columns that all Jacobians are made of, the
    spatial velocity at the world's origin, linear part first.
    """

    R_world_bone: Array
    p_world: Array
    J_rotation: Array
    J_origin: Array
    R_parent_joint: Array
    tree: Kinematics
    J: Array

    @cached_property
    def J_position(self) -> Array:
        """(S,3,n) m/rad of p_world: v(p) = v(origin) + omega x p."""
        return self.J_origin - rotations.hat(self.p_world) @ self.J_rotation

    def on(self, joint: int, seat: ArrayLike = (0.0, 0.0, 0.0)) -> PointOnBody:
        """Any point: `seat` (3,) m in the frame of the bone of `joint`."""
        offsets, chain = self.tree.skeleton.offsets, self.tree.skeleton.ancestors(joint)
        R, p = np.eye(3), np.zeros(3)
        for j in chain:
            p = p + R @ offsets[j] if j else p
            R = R @ self.R_parent_joint[j]
        p = p + R @ np.asarray(seat, float)
        moves = np.repeat([float(j in chain) for j in self.tree.free], 3)
        turning = moves * self.J[3:]
        return PointOnBody(R, p, turning, moves * self.J[:3] - rotations.hat(p) @ turning)


class PointOnBody(NamedTuple):
    """R_world_bone (3,3) and p_world (3,) m, pelvis joint at the origin, world axes, with Jacobians (3,n):
    R_world_bone(dv) = Exp(J_rotation dv) R_world_bone, p_world(dv) = p_world + J_position dv + O(dv^2)."""

    R_world_bone: Array
    p_world: Array
    J_rotation: Array
    J_position: Array


class Kinematics:
    """The tree with its points and free joints fixed; `at` evaluates a pose.

    joint (S,), seat (S,3) m: the points, each fixed to a bone. free: the joints that may move, the root
    being 0. Arrays are allocated once; what `at` returns is new.
    """

    def __init__(
        self, skeleton: Skeleton, joint: np.ndarray, seat: Array, free: tuple[int, ...]
    ) -> None:
        self.skeleton, self.free = skeleton, free
        self.joint, self.seat = np.asarray(joint, int), np.asarray(seat, float)
        model = skeleton.pin_model
        self._model, self._data = model, model.createData()
        self._ids = [skeleton.pin_ids[j] for j in self.joint]
        self._seats = np.column_stack([self.seat, np.ones(len(self.joint))])[..., None]
        # Where each joint's quaternion stands in Pinocchio's q: the root's after its position.
        q_starts = [model.joints[i].idx_q for i in skeleton.pin_ids]
        q_starts[0] += 3
        self._origin = np.zeros(model.nq)
        self._quaternions = np.array(q_starts)[:, None] + np.arange(4)
        starts = [model.joints[skeleton.pin_ids[j]].idx_v + (0 if j else 3) for j in free]
        self._columns = np.array([s + k for s in starts for k in range(3)], int)
        above = [[f in skeleton.ancestors(int(j)) for f in free] for j in self.joint]
        shape = (len(self.joint), 1, 3 * len(free))
        self._reach = np.repeat(np.array(above, float), 3, axis=-1).reshape(shape)

    @property
    def n(self) -> int:
        """Unknowns: three per free joint."""
        return 3 * len(self.free)

    def at(self, R_parent_joint: Array) -> Configuration:
        """Poses and Jacobians of the points at local rotations (24,3,3); one tree sweep."""
        q = self._origin.copy()
        q[self._quaternions] = rotations.quaternion(R_parent_joint)
        # Columns of the world Jacobian: a spatial velocity at the world's origin, linear part first.
        J = pin.computeJointJacobians(self._model, self._data, q).take(self._columns, axis=1)
        placed = self._data.oMi
        T = np.array([placed[i].homogeneous for i in self._ids]).reshape(-1, 4, 4)
        p = (T @ self._seats)[:, :3, 0]
        return Configuration(
            T[:, :3, :3], p, self._reach * J[3:], self._reach * J[:3], R_parent_joint, self, J
        )
