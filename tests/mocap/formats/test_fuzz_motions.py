"""Random damage to good motion files: a document or a PoserError, never anything else.

Warnings are errors here too, so an overflow in a check would show.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import sparse

from mocap import formats
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.formats import Options, amass
from mocap.formats.smpl import read_body
from mocap.motion import Motion
from mocap.skeleton import PARENTS, REST, Skeleton
from tests.mocap.formats import motion_files as files

TOKENS = (b"nan", b"-inf", b"1e308", b"1e7", b"", b"99999999999", b"-1", b"0", b"\n", b"{", b"}", b" ",
          b"\x00", b"\xff", b"End Site", b"CHANNELS 1 Xposition", b":units", b"begin", b"#")  # fmt: skip


def _bvh(folder: Path) -> Path:
    (folder / "m.bvh").write_text(files.bvh_text())
    return folder / "m.bvh"


def _amc(folder: Path) -> Path:
    (folder / "1.asf").write_text(files.asf_text())
    (folder / "1_01.amc").write_text(files.amc_text([{}, {"lradius": "30"}, {"ltibia": "20"}]))
    return folder / "1_01.amc"


def _asf(folder: Path) -> Path:
    return _amc(folder).with_name("1.asf")


def _amass(folder: Path, save: Callable[..., None] = np.savez_compressed) -> Path:
    R = ori.exp(np.random.default_rng(0).normal(0, 0.2, (4, 24, 3)))
    amass.write_motion(
        folder / "m.npz",
        Motion(60.0, R, np.zeros((4, 3)), Skeleton.default(1.8)),
        {"a": np.ones(2)},
    )
    with np.load(folder / "m.npz") as f:
        save(folder / "m.npz", **dict(f))
    return folder / "m.npz"


def _smpl(folder: Path) -> Path:
    """Five vertices at each joint would be as good as one."""
    model = {
        "v_template": REST,
        "shapedirs": np.zeros((24, 3, 2)),
        "posedirs": np.zeros((24, 3, 207)),
        "weights": np.eye(24),
        "J_regressor": sparse.csc_matrix(np.eye(24)),
        "f": np.zeros((4, 3), np.uint32),
        "kintree_table": np.array([PARENTS, range(24)]),
    }
    (folder / "m.pkl").write_bytes(pickle.dumps(model, 2))
    return folder / "m.pkl"


WRITERS: dict[str, Callable[[Path], Path]] = {
    "bvh": _bvh,
    "amc": _amc,
    "asf": _asf,
    "amass": _amass,
    "amass, not compressed": lambda folder: _amass(folder, np.savez),
    "smpl": _smpl,
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One small good file of each format, in a folder of its own."""
    return {n: write(tmp_path_factory.mktemp(n.split(",")[0])) for n, write in WRITERS.items()}


_STEP = st.tuples(
    st.sampled_from(["cut", "flip", "drop", "double", "token"]),
    st.floats(0, 1, exclude_max=True),
    st.integers(1, 200),
    st.sampled_from(TOKENS),
)


def _damaged(data: bytes, steps: list[tuple[str, float, int, bytes]]) -> bytes:
    """Truncate, flip, drop, double or overwrite at the places that the steps name."""
    for kind, where, size, token in steps:
        at = int(where * len(data))
        if kind == "cut":
            data = data[:at]
        elif kind == "flip" and data:
            data = data[:at] + bytes([data[at] ^ (size % 255 + 1)]) + data[at + 1 :]
        elif kind == "drop":
            data = data[:at] + data[at + size :]
        elif kind == "double":
            data = data[: at + size] + data[at:]
        elif kind == "token":
            data = data[:at] + token + data[at + size % 8 :]
    return data


def _read(path: Path, name: str) -> str:
    """What reading says; raises PoserError where it refuses."""
    if name == "smpl":
        read_body(path, np.ones(10))
        return ""
    if name == "asf":
        path = path.with_name("1_01.amc")
    document = formats.read(path, Options())
    assert isinstance(document.content, Motion)
    assert np.isfinite(document.content.p_world_joint).all()
    return " ".join((*document.assumptions, *document.warnings))


@pytest.mark.parametrize("name", WRITERS)
@settings(
    max_examples=150,
    deadline=10_000,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(steps=st.lists(_STEP, min_size=1, max_size=3))
def test_damage(
    name: str, steps: list[tuple[str, float, int, bytes]], good: dict[str, Path]
) -> None:
    source = good[name]
    whole = source.read_bytes()
    try:
        source.write_bytes(_damaged(whole, steps))
        said = _read(source, name)
    except PoserError as e:
        said = str(e)
    finally:
        source.write_bytes(whole)
    assert "\n" not in said
