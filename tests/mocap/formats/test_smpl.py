"""SMPL model files, small ones that the tests write: joints, mesh, and pickles of chumpy objects."""

from __future__ import annotations

import pickle
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from mocap import orientation as ori
from mocap.errors import FormatError, ShapeError
from mocap.evaluation import metrics
from mocap.formats import Options, amass
from mocap.formats.smpl import read_body
from mocap.motion import Motion
from mocap.skeleton import PARENTS, REST, Skeleton

V = 24 * 4


def a_model(rng: np.random.Generator, J: int = 24) -> dict[str, np.ndarray]:
    """Four vertices around each joint of the table, that joint's bone carrying them."""
    rest, parents = REST, np.array(PARENTS)
    if J == 52:  # our 22 and 23 become the first fingers, the other fingers lie at the wrists
        rest = np.concatenate([REST[:22], REST[[22]], REST[[20] * 14], REST[[23]], REST[[21] * 14]])
        parents = np.r_[parents[:22], [20] * 15, [21] * 15]
    around = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.05
    size = 4 * J
    weights = np.repeat(np.eye(J), 4, axis=0)
    weights = 0.8 * weights + 0.2 * weights[:, np.where(parents < 0, 0, parents)]
    return {
        "v_template": (rest[:, None] + around).reshape(-1, 3),
        "shapedirs": rng.normal(0, 0.004, (size, 3, 10)),
        "posedirs": rng.normal(0, 0.003, (size, 3, 9 * (J - 1))),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "J_regressor": np.kron(np.eye(J), np.full(4, 0.25)),
        "f": rng.integers(0, size, (60, 3)).astype(np.uint32),
        "kintree_table": np.array([parents, np.arange(J)]).astype(np.uint32),
    }


@pytest.fixture
def chumpy() -> Iterator[types.SimpleNamespace]:
    """Classes that pickle as chumpy's do; chumpy itself no longer installs."""

    class Ch:
        def __init__(self, **state: Any):
            self.__dict__.update(state)

    class Select(Ch):
        pass

    made = {"chumpy": types.ModuleType("chumpy")}
    for kind, module in ((Ch, "chumpy.ch"), (Select, "chumpy.reordering")):
        kind.__module__, kind.__qualname__ = module, kind.__name__
        made[module] = types.ModuleType(module)
        setattr(made[module], kind.__name__, kind)
    sys.modules.update(made)
    yield types.SimpleNamespace(Ch=Ch, Select=Select)
    for name in made:
        del sys.modules[name]


def a_motion(rng: np.random.Generator, T: int = 40) -> Motion:
    R = ori.exp(np.cumsum(rng.normal(0, 0.1, (T, 24, 3)), axis=0))
    return Motion(60.0, R, rng.normal(0, 1, (T, 3)), Skeleton.default())


def test_the_mean_shape_is_the_table(rng: np.random.Generator, tmp_path: Path) -> None:
    np.savez(tmp_path / "smpl.npz", **a_model(rng))  # type: ignore[arg-type]
    body = read_body(tmp_path / "smpl.npz")
    np.testing.assert_allclose(body.rest_positions, REST, atol=1e-12)
    assert body.mesh.template.shape == (V, 3) and body.mesh.weights.shape == (V, 24)


def test_joints_follow_the_shape(rng: np.random.Generator, tmp_path: Path) -> None:
    """joints = J_regressor (v_template + shapedirs betas), also for more betas than the file has."""
    model = a_model(rng)
    np.savez(tmp_path / "smpl.npz", **model)  # type: ignore[arg-type]
    betas = rng.normal(0, 1, 16)
    body = Skeleton.from_smpl_file(tmp_path / "smpl.npz", betas)
    shaped = model["v_template"] + np.einsum("vkb,b->vk", model["shapedirs"], betas[:10])
    np.testing.assert_allclose(body.rest_positions, model["J_regressor"] @ shaped, atol=1e-12)
    np.testing.assert_allclose(body.mesh.template, shaped, atol=1e-12)
    np.testing.assert_array_equal(body.betas, betas)


@pytest.mark.parametrize("protocol", [0, 2, 4])
@pytest.mark.parametrize("matrix", [sparse.csc_matrix, sparse.csr_matrix])
def test_the_first_releases_pickles(
    rng: np.random.Generator, tmp_path: Path, chumpy: Any, protocol: int, matrix: Any
) -> None:
    """Arrays inside chumpy objects and a sparse regressor come out without either library."""
    model = a_model(rng)
    np.savez(tmp_path / "smpl.npz", **model)  # type: ignore[arg-type]
    wide = np.concatenate([model["shapedirs"], np.ones((V, 3, 5))], axis=2)
    index = np.arange(wide.size).reshape(wide.shape)[:, :, :10].ravel()
    old = {
        **model,
        "v_template": chumpy.Ch(x=model["v_template"], _dirty_vars=set()),
        "shapedirs": chumpy.Select(
            a=chumpy.Ch(x=wide), idxs=index, preferred_shape=model["shapedirs"].shape
        ),
        "J_regressor": matrix(model["J_regressor"]),
        "bs_style": "lbs",
    }
    (tmp_path / "smpl.pkl").write_bytes(pickle.dumps(old, protocol))
    betas = rng.normal(0, 1, 10)
    a, b = (read_body(tmp_path / f"smpl.{s}", betas) for s in ("pkl", "npz"))
    np.testing.assert_array_equal(a.offsets, b.offsets)
    motion = a_motion(rng, 3)
    np.testing.assert_array_equal(a.mesh.vertices(motion), b.mesh.vertices(motion))


def test_vertices_by_the_formula(rng: np.random.Generator, tmp_path: Path) -> None:
    """Skinning vertex by vertex with 4x4 transforms, as SMPL's paper writes it."""
    model = a_model(rng)
    np.savez(tmp_path / "smpl.npz", **model)  # type: ignore[arg-type]
    body = read_body(tmp_path / "smpl.npz", rng.normal(0, 1, 10))
    motion = a_motion(rng)
    t = 35
    local = motion.R_parent_joint[t]
    rest, G = body.rest_positions, np.zeros((24, 4, 4))
    for j, parent in enumerate(PARENTS):
        G[j, :3, :3], G[j, 3, 3] = local[j], 1
        G[j, :3, 3] = motion.p_world_root[t] if parent < 0 else rest[j] - rest[parent]
        if parent >= 0:
            G[j] = G[parent] @ G[j]
    feature = np.concatenate([(local[j] - np.eye(3)).ravel() for j in range(1, 24)])
    expected = np.zeros((V, 3))
    for v in range(V):
        posed = body.mesh.template[v] + model["posedirs"][v] @ feature
        for j in range(24):
            expected[v] += model["weights"][v, j] * (G[j] @ np.r_[posed - rest[j], 1])[:3]
    np.testing.assert_allclose(body.mesh.vertices(motion)[t], expected, atol=1e-12)


def test_a_body_at_rest_is_its_template(rng: np.random.Generator, tmp_path: Path) -> None:
    np.savez(tmp_path / "smpl.npz", **a_model(rng))  # type: ignore[arg-type]
    body = read_body(tmp_path / "smpl.npz")
    rest = Motion(60.0, np.eye(3)[None, None].repeat(24, 1), body.offsets[:1], body)
    np.testing.assert_allclose(body.mesh.vertices(rest)[0], body.mesh.template, atol=1e-12)


def test_fingers_fold_onto_our_hands(rng: np.random.Generator, tmp_path: Path) -> None:
    """SMPL+H: index fingers are our 22 and 23, the other fingers are rigid with the wrists."""
    model = a_model(rng, 52)
    np.savez(tmp_path / "smplh.npz", **model)  # type: ignore[arg-type]
    body = read_body(tmp_path / "smplh.npz")
    np.testing.assert_allclose(body.rest_positions, REST, atol=1e-12)
    folded = body.mesh.weights
    np.testing.assert_allclose(folded.sum(axis=1), 1)
    np.testing.assert_allclose(folded[:, 22], model["weights"][:, 22:25].sum(axis=1))
    right = model["weights"][:, [21, *range(40, 52)]].sum(axis=1)
    np.testing.assert_allclose(folded[:, 21], right)
    columns = slice(9 * 36, 9 * 37)
    np.testing.assert_array_equal(body.mesh.posedirs[..., -9:], model["posedirs"][..., columns])


def test_mesh_error_of_the_metrics(rng: np.random.Generator, tmp_path: Path) -> None:
    """mesh_cm is zero for the same pose, and the mean way of the vertices for another."""
    np.savez(tmp_path / "smpl.npz", **a_model(rng))  # type: ignore[arg-type]
    body = read_body(tmp_path / "smpl.npz")
    motion = a_motion(rng, 300)
    assert metrics.evaluate(motion, motion, smpl=body).mesh_cm == 0.0
    still = Motion(60.0, np.tile(np.eye(3), (5, 24, 1, 1)), np.zeros((5, 3)), body)
    turned = np.array(still.R_parent_joint)
    turned[:, 16] = ori.rot_z(0.5)
    other = Motion(60.0, turned, still.p_world_root, body)
    way = np.linalg.norm(body.mesh.vertices(other) - body.mesh.vertices(still), axis=-1)
    found = metrics.evaluate(other, still, smpl=body).mesh_cm
    assert found == pytest.approx(100 * way.mean(), rel=1e-9) and found > 0.1


def test_an_amass_file_on_its_own_body(rng: np.random.Generator, tmp_path: Path) -> None:
    """With the model at hand J0 is the shape's own, and the file's betas make the bones."""
    np.savez(tmp_path / "smpl.npz", **a_model(rng))  # type: ignore[arg-type]
    body = read_body(tmp_path / "smpl.npz", rng.normal(0, 1, 10))
    first = a_motion(rng).on(body)
    amass.write_motion(tmp_path / "m.npz", first)
    for options in (Options(smpl=tmp_path / "smpl.npz"), Options()):
        back = amass.read_motion(tmp_path / "m.npz", options)
        np.testing.assert_allclose(back.p_world_joint, first.p_world_joint, atol=1e-12)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("v_template", np.full((V, 3), np.nan), "not finite"),
        ("v_template", None, "'v_template' is missing"),
        ("v_template", 100 * REST.repeat(4, 0), "a body 1.7e.02 m tall|a body 17. m tall"),
        ("shapedirs", np.zeros((V, 10)), "'shapedirs': has shape"),
        ("weights", np.zeros((V, 24)), "'weights': row 0 sums to 0, expected 1"),
        ("weights", np.full((V, 30), 1 / 30), "a model of 30 joints"),
        ("J_regressor", np.zeros((24, V)), "'J_regressor': row 0 sums to 0"),
        ("f", np.full((4, 3), V), "names vertices outside"),
        ("kintree_table", np.zeros((2, 24), np.int64), "another joint tree"),
    ],
)
@pytest.mark.parametrize("suffix", ["npz", "pkl"])
def test_broken_models(
    rng: np.random.Generator, tmp_path: Path, field: str, value: Any, message: str, suffix: str
) -> None:
    model = {k: v for k, v in (a_model(rng) | {field: value}).items() if v is not None}
    path = tmp_path / f"smpl.{suffix}"
    if suffix == "npz":
        np.savez(path, **model)  # type: ignore[arg-type]
    else:
        path.write_bytes(pickle.dumps(model, 2))
    with pytest.raises(FormatError, match=message) as caught:
        read_body(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_other_files(rng: np.random.Generator, tmp_path: Path, chumpy: Any) -> None:
    """No file, garbage, a pickle that wants to run something, matrices and arrays that do not fit."""
    with pytest.raises(FormatError, match="No such file"):
        read_body(tmp_path / "none.pkl")
    path = tmp_path / "smpl.pkl"
    sparse_far = sparse.csc_matrix(a_model(rng)["J_regressor"])
    sparse_far.indices = sparse_far.indices + 100
    lie = sparse.csc_matrix(a_model(rng)["J_regressor"])
    lie.indptr = lie.indptr + np.where(np.arange(V + 1) == V, 10**9, 0)
    model = a_model(rng)
    for data, message in (
        (b"garbage", "not a whole pickle"),
        (pickle.dumps([1, 2], 2), "holds a list"),
        (pickle.dumps({"v_template": print}, 2), "asks for"),
        (pickle.dumps(model | {"J_regressor": sparse_far}, 2), "do not fit together"),
        (pickle.dumps(model | {"J_regressor": lie}, 2), "do not fit together"),
        (pickle.dumps(model | {"J_regressor": chumpy.Ch(y=1)}, 2), "do not fit together"),
        (pickle.dumps(model | {"J_regressor": "text"}, 2), "is a str, expected an array"),
        (pickle.dumps(model, 2)[:-500], "damaged or cut short"),
    ):
        path.write_bytes(data)
        with pytest.raises(FormatError, match=message):
            read_body(path)
    np.savez(tmp_path / "good.npz", **model)  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match="finite"):
        read_body(tmp_path / "good.npz", [np.nan])
