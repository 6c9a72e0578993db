"""The body: rest offsets on SMPL's joint tree, its size; the numeric kinematics and the Pinocchio model.

World and rest frames: y up, the body faces +z, its left is +x. In the rest pose (a T-pose) every
joint's rotation is the identity, so a bone's frame is the world's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap import tree
from mocap.errors import FormatError, ShapeError
from mocap.orientation import Array
from mocap.tree import JOINTS, PARENTS

if TYPE_CHECKING:
    from pathlib import Path

MIRROR: tuple[int, ...] = (
    0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22,
)  # fmt: skip
"""Index of each joint's mirror image."""

# Rest joints of the neutral mean SMPL shape, metres.
REST: Array = np.array(
    [
        [-0.00179506, -0.22333345, 0.02821913],
        [0.06772468, -0.31473967, 0.02140379],
        [-0.06946554, -0.31385513, 0.02389930],
        [-0.00432792, -0.11437022, 0.00152281],
        [0.10200122, -0.68993827, 0.01690799],
        [-0.10775559, -0.69642414, 0.01504927],
        [0.00115911, 0.02081021, 0.00261528],
        [0.08840552, -1.08789863, -0.02678534],
        [-0.09198183, -1.09483879, -0.02726252],
        [0.00261610, 0.07373245, 0.02803985],
        [0.11476366, -1.14368952, 0.09250305],
        [-0.11735357, -1.14298274, 0.09608543],
        [-0.00016228, 0.28760280, -0.01481718],
        [0.08146084, 0.19548175, -0.00604975],
        [-0.07914308, 0.19256528, -0.01057543],
        [0.00498956, 0.35257241, 0.03653179],
        [0.17243777, 0.22595065, -0.01491791],
        [-0.17515546, 0.22511645, -0.01971850],
        [0.43205002, 0.21317859, -0.04237434],
        [-0.42889742, 0.21178723, -0.04111948],
        [0.68128365, 0.22216462, -0.04354526],
        [-0.68419550, 0.21955953, -0.04667868],
        [0.76532583, 0.21400308, -0.05849062],
        [-0.76881743, 0.21344227, -0.05699376],
    ]
)
# Stature of that body: the joints span 1.496 m from the lowest toe joint to the head joint. The head
# joint sits at the skull's base, about 0.19 m under the vertex, the toe joint about 0.02 m over the
# sole (both read off anthropometric tables for this stature; they only set the scale of `height`).
TOES = (10, 11)
HEAD_ABOVE_JOINT = 0.19
SOLE_BELOW_TOE = 0.02
TABLE_STATURE: float = float(
    REST[15, 1] - REST[list(TOES), 1].min() + HEAD_ABOVE_JOINT + SOLE_BELOW_TOE
)
STATURE_RANGE = (0.5, 2.6)  # m; outside, a height is taken for a mistake of unit


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of 24 ball joints.

    names: J joint names. parents: J indices, -1 for the root, every parent before its children.
    offsets: (J,3) m, each joint in its parent's frame at rest; offsets[0] is the root's rest position
    J0 in SMPL's own rest frame, which `trans` of SMPL files counts from (p_world_root = J0 + trans).
    betas: SMPL shape the offsets came from (zeros: the mean shape). mesh: the SMPL mesh where an
    SMPL file was read, else None.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    betas: Array = field(default_factory=lambda: np.zeros(10))
    mesh: Any = None

    def __post_init__(self) -> None:
        offsets = np.array(self.offsets, float)
        offsets.setflags(write=False)
        object.__setattr__(self, "offsets", offsets)
        J = len(self.names)
        if offsets.shape != (J, 3) or len(self.parents) != J:
            raise ShapeError(
                f"Skeleton: {J} names need offsets ({J}, 3) and {J} parents, "
                f"got {offsets.shape} and {len(self.parents)}"
            )
        if not np.isfinite(offsets).all():
            raise ShapeError("Skeleton: offsets hold values that are not finite")
        if self.parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(self.parents) if j):
            raise ShapeError("Skeleton: joint 0 must be the only root and parents precede children")

    @classmethod
    def default(cls, height: float | None = None) -> Skeleton:
        """The neutral mean SMPL shape, scaled so that its stature is `height` metres.

        Without `height`: unscaled, stature `TABLE_STATURE`. The rest root J0 is not scaled: SMPL
        `trans` of a file without a body model counts from joint 0 of the table (conventions, "Native files").
        Raises ShapeError for a height outside `STATURE_RANGE`.
        """
        offsets = tree.offsets(PARENTS, REST)
        if height is not None:
            if not STATURE_RANGE[0] <= height <= STATURE_RANGE[1]:
                raise ShapeError(
                    f"height {height:g} m is outside {STATURE_RANGE[0]} to {STATURE_RANGE[1]} m"
                )
            offsets[1:] *= height / TABLE_STATURE
        return cls(JOINTS, PARENTS, offsets)

    @classmethod
    def from_smpl_file(cls, path: str | Path, betas: Any = None) -> Skeleton:
        """The body of the user's own SMPL `.pkl` or `.npz` file with shape `betas` (N,), default zeros.

        `mesh` is a `mocap.formats.smpl.SmplMesh`. Raises FormatError where the file is no SMPL model or the
        body of another size than people are, ShapeError for betas that are no vector of finite numbers.
        """
        from mocap.formats.smpl import read_mesh

        mesh, shape = read_mesh(path, betas)
        body = cls(JOINTS, PARENTS, tree.offsets(PARENTS, mesh.joints), shape, mesh)
        low, high = STATURE_RANGE
        if not low <= body.stature <= high:
            raise FormatError(
                path,
                f"a body {body.stature:.3g} m tall, expected {low} to {high} m",
                f"betas {np.array2string(shape[:3], precision=2)}...",
            )
        return body

    @property
    def stature(self) -> float:
        """Standing height in m: toe-to-head-joint span of the rest pose plus head and sole, scaled."""
        rest = self.rest_positions
        span = rest[15, 1] - rest[list(TOES), 1].min()
        table = TABLE_STATURE - HEAD_ABOVE_JOINT - SOLE_BELOW_TOE
        return float(span * TABLE_STATURE / table)

    @property
    def sole(self) -> float:
        """How far the sole is under the toe joint, m: `SOLE_BELOW_TOE`, scaled with the stature."""
        return SOLE_BELOW_TOE * self.stature / TABLE_STATURE

    @property
    def standing_height(self) -> float:
        """Height in m of the pelvis joint over the floor in the rest pose."""
        rest = self.rest_positions
        return float(rest[0, 1] - rest[list(TOES), 1].min() + self.sole)

    @cached_property
    def rest_positions(self) -> Array:
        """(J,3) m: joint positions of the rest pose, root at J0."""
        rest = np.array(self.offsets)
        for j, p in enumerate(self.parents):
            if p >= 0:
                rest[j] += rest[p]
        return rest

    def with_offsets(self, offsets: Array) -> Skeleton:
        """The same tree with other bone vectors (J,3) m."""
        return Skeleton(self.names, self.parents, offsets, self.betas)

    def ancestors(self, joint: int) -> tuple[int, ...]:
        """Indices from the root down to `joint`, both included."""
        chain = [joint]
        while self.parents[chain[-1]] >= 0:
            chain.append(self.parents[chain[-1]])
        return tuple(reversed(chain))

    def rotations(self, R_parent_joint: Array) -> Array:
        """Global rotations R_world_joint (...,J,3,3) of local ones (...,J,3,3)."""
        return tree.rotations(self.parents, R_parent_joint)

    def local_rotations(self, R_world_joint: Array) -> Array:
        """Inverse of `rotations`: R_parent_joint (...,J,3,3) of global rotations."""
        R = np.array(R_world_joint, float)
        parents = list(self.parents[1:])
        R[..., 1:, :, :] = np.swapaxes(R[..., parents, :, :], -1, -2) @ R[..., 1:, :, :]
        return R

    def positions(self, R_world_joint: Array, p_world_root: Array) -> Array:
        """Joint positions (...,J,3) m from global rotations (...,J,3,3) and the root's place (...,3)."""
        return tree.positions(self.parents, self.offsets, R_world_joint, p_world_root)

    def forward(self, R_parent_joint: Array, p_world_root: Array) -> tuple[Array, Array]:
        """R_world_joint (...,J,3,3) and p_world_joint (...,J,3) m of a pose."""
        R = self.rotations(R_parent_joint)
        return R, self.positions(R, p_world_root)

    @cached_property
    def pin_model(self) -> Any:
        """The `pinocchio.Model`: a free-flyer pelvis and 23 spherical joints.

        q = [p_world_root (3), quaternion xyzw of the root, then one quaternion xyzw per joint in the
        order of `names`]; pinocchio numbers the joints depth first, `pin_ids` maps ours to its.
        """
        import pinocchio as pin

        model = pin.Model()
        ids: list[int] = []
        for j, (name, parent) in enumerate(zip(self.names, self.parents, strict=True)):
            joint = pin.JointModelFreeFlyer() if parent < 0 else pin.JointModelSpherical()
            # The free-flyer's placement is the world origin: its q holds the pelvis position itself.
            offset = np.zeros(3) if parent < 0 else self.offsets[j]
            ids.append(
                model.addJoint(
                    0 if parent < 0 else ids[parent], joint, pin.SE3(np.eye(3), offset), name
                )
            )
        return model

    @cached_property
    def pin_ids(self) -> tuple[int, ...]:
        """Pinocchio's joint id of each of our joints."""
        return tuple(int(self.pin_model.getJointId(n)) for n in self.names)

    def pin_configuration(self, R_parent_joint: Array, p_world_root: Array) -> Array:
        """Pinocchio's q of one pose: local rotations (J,3,3) and root position (3,) m."""
        from mocap.orientation import to_quat

        model = self.pin_model
        q = np.empty(model.nq)
        quats = to_quat(R_parent_joint, scalar_first=False)
        q[:3] = p_world_root
        for j, jid in enumerate(self.pin_ids):
            start = model.joints[jid].idx_q + (3 if j == 0 else 0)
            q[start : start + 4] = quats[j]
        return q
