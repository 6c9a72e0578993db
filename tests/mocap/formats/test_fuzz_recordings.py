"""Random damage to good files: every reader answers with a document or a PoserError, never anything else.

Warnings are errors here too, so an overflow in a check would show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mocap.errors import PoserError
from mocap.formats import (
    Document,
    Options,
    csv,
    dip,
    mvnx,
    native,
    opensense,
    qmt,
    totalcapture,
    xsens_mtw,
)
from tests.mocap.formats import recording_files as files


def _stored(folder: Path) -> Path:
    """A native file whose arrays lie open, so that damage reaches their headers."""
    path = files.native_raw(folder)
    with np.load(path) as f:
        arrays = {k: v for k, v in f.items() if v.size < 100}
    np.savez(path, **arrays)
    return path


WRITERS: dict[str, tuple[object, Callable[[Path], Path]]] = {
    "native recording": (native, files.native_recording),
    "native raw": (native, files.native_raw),
    "native, not compressed": (native, _stored),
    "qmt": (qmt, files.qmt),
    "opensense": (opensense, files.sto),
    "mtw": (xsens_mtw, lambda d: files.mtw(d) / "MT_trial_00B40001.txt"),
    "mvnx": (mvnx, files.mvnx),
    "csv": (csv, files.csv_wide),
    "dip": (dip, files.dip),
    "dip release": (dip, files.dip_npz),
    "totalcapture": (totalcapture, files.totalcapture),
    "totalcapture pickle": (totalcapture, files.tc_pkl),
}
TOKENS = (
    b"nan",
    b"inf",
    b"-1e308",
    b"1e308",
    b"",
    b"99999999999",
    b"\t",
    b",",
    b"\n",
    b"<",
    b"\x00",
)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    """One short good file of each format."""
    folder = tmp_path_factory.mktemp("fuzz")
    old, files.FRAMES = files.FRAMES, 90
    yield {
        name: write(_made(folder / name.replace(" ", "_"))) for name, (_, write) in WRITERS.items()
    }
    files.FRAMES = old


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


@st.composite
def _damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Truncate, flip, drop, double or overwrite at random places, once or a few times."""
    steps = draw(
        st.lists(
            st.tuples(
                st.sampled_from(["cut", "flip", "drop", "double", "token"]),
                st.floats(0, 1, exclude_max=True),
                st.integers(1, 200),
                st.sampled_from(TOKENS),
            ),
            min_size=1,
            max_size=3,
        )
    )

    def apply(data: bytes) -> bytes:
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

    return apply


@pytest.mark.parametrize("name", WRITERS)
@settings(
    max_examples=80,
    deadline=10_000,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(damage=_damage())
def test_damage(name: str, damage: Callable[[bytes], bytes], good: dict[str, Path]) -> None:
    source = good[name]
    path = source.with_name("damaged" + source.suffix)
    path.write_bytes(damage(source.read_bytes()))
    reader = WRITERS[name][0].FORMAT  # type: ignore[attr-defined]
    reader.sniff(path, path.read_bytes()[:4096])
    try:
        document = reader.read(path, Options())
    except PoserError as e:
        said = str(e)
    else:
        assert isinstance(document, Document)
        said = " ".join((*document.assumptions, *document.warnings))
    assert "\n" not in said
