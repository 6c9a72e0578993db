"""What a body looks like: a skin of vertices that the 24 joints move.

`mesh` is the free mesh that comes with the package, `capsules` what is drawn from bones alone; the
user's own SMPL body brings its mesh (`Skeleton.from_smpl_file`). `skin` chooses.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from mocap.body.capsules import capsule_skin
from mocap.body.mesh import mesh_skin
from mocap.body.skin import Skin
from mocap.errors import PoserError
from mocap.skeleton import Skeleton

Look = Literal["mesh", "capsules", "smpl"]
LOOKS: tuple[Look, ...] = get_args(Look)

__all__ = ["LOOKS", "Look", "Skin", "capsule_skin", "mesh_skin", "skin", "smpl_skin"]


def skin(skeleton: Skeleton, look: Look | None = None) -> Skin:
    """The skin of a skeleton; without `look` its SMPL mesh where it has one, else the free mesh.

    Raises PoserError for `smpl` where no SMPL file was read.
    """
    if look is None:
        look = "mesh" if skeleton.mesh is None else "smpl"
    if look == "smpl":
        return smpl_skin(skeleton)
    return mesh_skin(skeleton) if look == "mesh" else capsule_skin(skeleton)


def smpl_skin(skeleton: Skeleton) -> Skin:
    """The mesh of the SMPL file that the skeleton was read from.

    SMPL's pose blend shapes are left out: browsers and files know bones and weights only, which makes a
    bent elbow a little thinner. Raises PoserError where there is none.
    """
    mesh = skeleton.mesh
    if mesh is None:
        raise PoserError("a body that looks as SMPL's needs --smpl FILE, your SMPL model")
    rest = skeleton.rest_positions - skeleton.rest_positions[0]
    return Skin(mesh.template - mesh.joints[0], mesh.faces.astype(np.int32), mesh.weights, rest)
