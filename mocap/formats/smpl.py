"""The user's own SMPL model file: the rest joints of a shape, and its mesh.

SMPL's files are licensed, so none is shipped; without one the project works on the table of
`mocap.skeleton`. Read are SMPL (24 joints), SMPL+H (52) and SMPL-X (55), as `.npz` or as the `.pkl` of
the first releases, whose arrays are wrapped in objects of chumpy and scipy: neither is imported, stand-ins
take the numbers out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap import tree
from mocap.errors import FormatError, ShapeError
from mocap.formats import _npz, _unpickle
from mocap.formats._files import check_regular
from mocap.orientation import Array
from mocap.tree import PARENTS

_NEEDED = ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "f", "kintree_table")
MAX_VERTICES = 200_000
_CHUNK = 32  # frames blended at once: 6890 vertices take 16 MB of matrices


class Posed(Protocol):
    """What skinning needs of a motion: R_parent_joint (T,24,3,3) and p_world_root (T,3) m."""

    @property
    def R_parent_joint(self) -> Array: ...
    @property
    def p_world_root(self) -> Array: ...


@dataclass(frozen=True, eq=False)
class SmplMesh:
    """A shaped SMPL mesh in its rest pose (T-pose, y up, metres), V vertices.

    template: (V,3). joints: (24,3), the rest joints. weights: (V,24), rows sum to 1. posedirs: (V,3,207),
    m per entry of R_parent_joint - I of joints 1 to 23, row by row. faces: (F,3) indices.
    """

    template: Array
    joints: Array
    weights: Array
    posedirs: Array
    faces: NDArray[np.int64]

    def vertices(self, motion: Posed) -> Array:
        """Vertices (T,V,3) m in our world of a motion's rotations and pelvis path, on this body.

        v_world = sum_j w_j (R_world_j (v - J_j) + p_world_j), v = template + posedirs (R_parent - I):
        linear blend skinning with pose blend shapes.
        """
        T, offsets = len(motion.p_world_root), tree.offsets(PARENTS, self.joints)
        out = np.empty((T, len(self.template), 3))
        for part in (slice(t, t + _CHUNK) for t in range(0, T, _CHUNK)):
            local = motion.R_parent_joint[part]
            R = tree.rotations(PARENTS, local)
            p = tree.positions(PARENTS, offsets, R, motion.p_world_root[part])
            feature = (local[:, 1:] - np.eye(3)).reshape(len(local), -1)
            v = self.template + (feature @ self.posedirs.reshape(-1, feature.shape[1]).T).reshape(
                len(local), -1, 3
            )
            turn = (self.weights @ R.reshape(len(local), 24, 9)).reshape(len(local), -1, 3, 3)
            shift = self.weights @ (p - (R @ self.joints[..., None])[..., 0])
            out[part] = (turn @ v[..., None])[..., 0] + shift
        return out


def read_mesh(path: str | Path, betas: ArrayLike | None = None) -> tuple[SmplMesh, Array]:
    """The body of an SMPL file with shape `betas` (N,), default zeros, and that shape.

    joints = J_regressor @ (v_template + shapedirs @ betas). Shape coefficients beyond those of the file
    are left out (AMASS names 16, the first SMPL files have 10). See `Skeleton.from_smpl_file`.
    Raises FormatError where the file is no SMPL model, ShapeError for betas that are no vector of finite
    numbers.
    """
    path = Path(path)
    shape = np.zeros(10) if betas is None else np.array(betas, float)
    if shape.ndim != 1 or not np.isfinite(shape).all():
        raise ShapeError(f"betas must be a vector of finite numbers, got shape {shape.shape}")
    try:
        stat = path.stat()
    except OSError as e:
        raise FormatError(path, e.strerror or str(e)) from e
    model = _model(path, stat.st_mtime_ns, stat.st_size)
    n = min(len(shape), model.shapedirs.shape[2])
    template = model.template + model.shapedirs[:, :, :n] @ shape[:n]
    joints = model.regressor @ template
    return SmplMesh(template, joints, model.weights, model.posedirs, model.faces), shape


@dataclass(frozen=True, eq=False)
class _Model:
    """A model file with its joints folded onto ours: regressor (24,V), weights (V,24), posedirs
    (V,3,207).
    """

    template: Array
    shapedirs: Array
    regressor: Array
    weights: Array
    posedirs: Array
    faces: NDArray[np.int64]


@lru_cache(maxsize=2)
def _model(path: Path, mtime_ns: int, size: int) -> _Model:
    """The file's arrays, checked; kept while time and size of the file stay, for many clips read."""
    data = _arrays(path)
    v = data.floats("v_template", (None, 3))
    V = len(v)
    if V > MAX_VERTICES:
        raise FormatError(path, f"{V} vertices, at most {MAX_VERTICES} are read")
    weights = data.floats("weights", (V, None))
    J = weights.shape[1]
    if J not in _FIRST_FINGERS:
        raise FormatError(path, f"a model of {J} joints; SMPL has 24, SMPL+H 52, SMPL-X 55")
    shapedirs = data.floats("shapedirs", (V, 3, None))
    posedirs = data.floats("posedirs", (V, 3, 9 * (J - 1)))
    regressor = data.floats("J_regressor", (J, V))
    faces = data.integers("f", (None, 3))
    kept = [*range(22), *_FIRST_FINGERS[J]]
    _check(path, data.integers("kintree_table", (2, J))[0], regressor, weights, faces)
    for name, a in (("v_template", v), ("shapedirs", shapedirs), ("posedirs", posedirs)):
        if not np.isfinite(a).all():
            raise FormatError(path, "holds values that are not finite", f"field {name!r}")
    columns = (9 * (np.array(kept[1:]) - 1)[:, None] + np.arange(9)).ravel()
    fold = np.zeros((J, 24))
    fold[np.arange(J), _carriers(J)] = 1.0
    return _Model(v, shapedirs, regressor[kept], weights @ fold, posedirs[:, :, columns], faces)


# Joints of a file that are our 22 and 23: SMPL's hand joints, or the first joint of the index fingers.
_FIRST_FINGERS = {24: (22, 23), 52: (22, 37), 55: (25, 40)}


def _carriers(J: int) -> list[int]:
    """Our joint that carries each of the file's J joints: what we have not is rigid with its wrist or
    the head, and an index finger with its first joint.
    """
    if J == 24:
        return list(range(24))
    left, right = _FIRST_FINGERS[J]
    faces = [15] * (left - 22)
    return [*range(22), *faces, *[22] * 3, *[20] * (right - left - 3), *[23] * 3, *[21] * 12]


def _check(
    path: Path,
    parents: NDArray[np.int64],
    regressor: Array,
    weights: Array,
    faces: NDArray[np.int64],
) -> None:
    """What makes the arrays an SMPL model."""
    if tuple(parents[1:22]) != PARENTS[1:22]:
        raise FormatError(path, "another joint tree than SMPL's", "field 'kintree_table'")
    for name, rows in (("weights", weights), ("J_regressor", regressor)):
        total = rows.sum(axis=1)
        bad = ~(np.abs(total - 1) < 0.02)
        if bad.any():
            k = int(np.argmax(bad))
            raise FormatError(
                path, f"row {k} sums to {total[k]:.3g}, expected 1", f"field {name!r}"
            )
    if faces.min() < 0 or faces.max() >= len(weights):
        raise FormatError(path, f"names vertices outside 0 to {len(weights) - 1}", "field 'f'")


def _arrays(path: Path) -> _npz.Fields:
    check_regular(path)
    with path.open("rb") as f:
        head = f.read(2)
    if head == b"PK":
        return _npz.Fields(path, _npz.load(path, _NEEDED))
    data = _unpickle.load(path, _STAND_INS)
    if not isinstance(data, Mapping):
        raise FormatError(path, f"holds a {type(data).__name__}, expected the fields of SMPL")
    named = {k.decode("latin1") if isinstance(k, bytes) else k: v for k, v in data.items()}
    if "v_template" not in named:
        raise FormatError(path, "field 'v_template' is missing: no SMPL model")
    V = len(np.atleast_1d(_plain(path, "v_template", named["v_template"], 0)))
    return _npz.Fields(path, {n: _plain(path, n, named[n], V) for n in _NEEDED if n in named})


class _Wrapped:
    """Stands in for an object of chumpy or scipy: its state alone, nothing of its behaviour."""

    def __init__(self) -> None:
        self.state: Mapping[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, Mapping) else {}


class _Constant(_Wrapped):
    """chumpy.ch.Ch: an array `x`."""


class _Selected(_Wrapped):
    """chumpy.reordering.Select: `idxs` of the flat array `a`, in `preferred_shape`."""


class _Columns(_Wrapped):
    """A sparse matrix compressed by columns."""


class _Rows(_Wrapped):
    """A sparse matrix compressed by rows."""


class _Nothing(_Wrapped):
    """The base class `object`, which old pickles name."""


def _names(module: str, kind: str) -> Iterator[str]:
    """A sparse class under scipy's old and new module names."""
    yield f"scipy.sparse.{module}.{kind}"
    yield f"scipy.sparse._{module}.{kind}"


_STAND_INS: dict[str, type] = {
    "chumpy.ch.Ch": _Constant,
    "chumpy.reordering.Select": _Selected,
    "__builtin__.object": _Nothing,
    "builtins.object": _Nothing,
    **dict.fromkeys((*_names("csc", "csc_matrix"), *_names("csc", "csc_array")), _Columns),
    **dict.fromkeys((*_names("csr", "csr_matrix"), *_names("csr", "csr_array")), _Rows),
}


def _plain(path: Path, name: str, value: Any, V: int, depth: int = 0) -> np.ndarray:
    """The array that a field stands for. V: columns that a sparse matrix must have."""
    if isinstance(value, np.ndarray):
        return value
    try:
        if isinstance(value, _Constant):
            return _plain(path, name, value.state["x"], V, depth)
        if isinstance(value, _Selected) and depth < 3:
            whole = _plain(path, name, value.state["a"], V, depth + 1)
            index = np.asarray(value.state["idxs"])
            return whole.ravel()[index].reshape(value.state["preferred_shape"])
        if isinstance(value, _Columns | _Rows):
            return _dense(value, V)
    except (KeyError, ValueError, TypeError, IndexError, RecursionError) as e:
        raise FormatError(path, "its parts do not fit together", f"field {name!r}") from e
    raise FormatError(path, f"is a {type(value).__name__}, expected an array", f"field {name!r}")


def _dense(value: _Wrapped, V: int) -> np.ndarray:
    """A sparse matrix (joints,V) as a full one; ValueError where its parts do not fit."""
    state = value.state
    rows, columns = (int(n) for n in state["_shape"])
    indptr, inner = np.asarray(state["indptr"]), np.asarray(state["indices"])
    outer_size = columns if isinstance(value, _Columns) else rows
    if columns != V or not 0 < rows <= max(_FIRST_FINGERS) or len(indptr) != outer_size + 1:
        raise ValueError
    each = np.diff(indptr)
    if indptr[0] != 0 or (each < 0).any() or indptr[-1] != len(inner) or (inner < 0).any():
        raise ValueError
    outer = np.repeat(np.arange(outer_size), each)
    out = np.zeros((rows, columns))
    at = (inner, outer) if isinstance(value, _Columns) else (outer, inner)
    np.add.at(out, at, np.asarray(state["data"], float))
    return out
