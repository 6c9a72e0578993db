"""Poses of chosen points on the body and their Jacobians, through Pinocchio, at one frame's cost.

Unknown of the whole package: dv (n,) rad, the right-tangent step of the free joints, three numbers each,
R_parent_joint_j <- R_parent_joint_j Exp(dv_j) (for the root R_world_root <- R_world_root Exp(dv_0)).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from hybrid import rotations
from mocap.orientation import Array
from mocap.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Configuration:
    """Kinematics of one pose, pelvis joint at the origin: whoever holds one cannot use stale ones.

    R_world_bone (S,3,3) and p_world (S,3) m: of each point's bone, and of the point. J_rotation (S,3,n):
    R_world_bone(dv) = Exp(J_rotation dv) R_world_bone, so world axes. J_origin (S,3,n) m/rad: velocity of
    that part of the bone's space which is at the world's origin.
    """

    R_world_bone: Array
    p_world: Array
    J_rotation: Array
    J_origin: Array

    @cached_property
    def J_position(self) -> Array:
        """(S,3,n) m/rad of p_world: v(p) = v(origin) + omega x p."""
        return self.J_origin - rotations.hat(self.p_world) @ self.J_rotation


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
        return Configuration(T[:, :3, :3], p, self._reach * J[3:], self._reach * J[:3])
