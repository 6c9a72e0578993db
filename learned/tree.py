"""Rotations and the joint tree in torch, batched and differentiable.

The same formulas as `mocap.skeleton.Skeleton` and `mocap.orientation`, with which tests compare them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mocap.skeleton import PARENTS


def rotations(R_parent_joint: Tensor) -> Tensor:
    """Global rotations R_world_joint (...,24,3,3) of local ones (...,24,3,3)."""
    R: list[Tensor] = []
    for j, parent in enumerate(PARENTS):
        local = R_parent_joint[..., j, :, :]
        R.append(local if parent < 0 else R[parent] @ local)
    return torch.stack(R, dim=-3)


def positions(R_world_joint: Tensor, p_world_root: Tensor, offsets: Tensor) -> Tensor:
    """Joint positions (...,24,3) m: p_j = p_parent + R_parent o_j, offsets (24,3) or (...,24,3) m."""
    p: list[Tensor] = []
    for j, parent in enumerate(PARENTS):
        if parent < 0:
            p.append(p_world_root.expand((*R_world_joint.shape[:-3], 3)))
            continue
        o = offsets[..., j, :]
        p.append(p[parent] + (R_world_joint[..., parent, :, :] @ o.unsqueeze(-1)).squeeze(-1))
    return torch.stack(p, dim=-2)


def exp(w: Tensor) -> Tensor:
    """Rotation matrices (...,3,3) of rotation vectors (...,3) rad (Rodrigues)."""
    t2 = (w * w).sum(-1)
    t = torch.sqrt(t2.clamp_min(1e-12))
    a = torch.sin(t) / t
    b = (1 - torch.cos(t)) / t2.clamp_min(1e-12)
    x, y, z = w.unbind(-1)
    zero = torch.zeros_like(x)
    W = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*w.shape, 3)
    eye = torch.eye(3, dtype=w.dtype, device=w.device)
    return eye + a[..., None, None] * W + b[..., None, None] * (W @ W)


def from_quat(q: Tensor) -> Tensor:
    """Rotation matrices (...,3,3) of quaternions (...,4), scalar first, normalised here."""
    w, x, y, z = (q / q.norm(dim=-1, keepdim=True)).unbind(-1)
    return torch.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        -1,
    ).reshape(*q.shape[:-1], 3, 3)  # fmt: skip


def rot_y(a: Tensor) -> Tensor:
    """Rotations (...,3,3) about y (up) by `a` (...) rad."""
    c, s, zero, one = torch.cos(a), torch.sin(a), torch.zeros_like(a), torch.ones_like(a)
    return torch.stack([c, zero, s, zero, one, zero, -s, zero, c], -1).reshape(*a.shape, 3, 3)


def to_6d(R: Tensor) -> Tensor:
    """The first two columns of R (...,3,3) as (...,6): column 0, then column 1 (Zhou et al. 2019)."""
    return torch.cat([R[..., :, 0], R[..., :, 1]], -1)


def from_6d(x: Tensor) -> Tensor:
    """Rotations (...,3,3) of (...,6) by Gram-Schmidt (Zhou et al. 2019, eq. 5)."""
    a, b = x[..., :3], x[..., 3:]
    e0 = torch.nn.functional.normalize(a, dim=-1, eps=1e-6)
    e1 = torch.nn.functional.normalize(b - (e0 * b).sum(-1, keepdim=True) * e0, dim=-1, eps=1e-6)
    return torch.stack([e0, e1, torch.linalg.cross(e0, e1)], -1)


def angle_between(Ra: Tensor, Rb: Tensor) -> Tensor:
    """Geodesic distance (...) rad: 2 asin(|Ra - Rb|_F / (2 sqrt 2)), accurate at small angles."""
    half = (Ra - Rb).flatten(-2).norm(dim=-1) / (8**0.5)
    return 2 * torch.asin(half.clamp(max=1.0))
