"""Small files that would become large, or take for ever: refused within the limits of a child process."""

from __future__ import annotations

import pickle
import resource
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.mocap.formats import recording_files as files

MEGABYTES, SECONDS = 1500, 20
CODE = """
import sys
from pathlib import Path
from mocap import formats
from mocap.errors import FormatError
try:
    formats.read(Path(sys.argv[1]))
except FormatError as e:
    print(e)
"""


def refused(path: Path) -> str:
    """What reading says in a process of its own, which may take so much memory and time and no more."""

    def limits() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEGABYTES << 20, MEGABYTES << 20))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))

    done = subprocess.run(
        [sys.executable, "-c", CODE, str(path)],
        capture_output=True, text=True, preexec_fn=limits, timeout=4 * SECONDS, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-400:]
    assert done.stdout.count("\n") == 1 and str(path) in done.stdout, done.stdout
    return done.stdout


def nested_keys(folder: Path) -> Path:
    """Tuples of two in each other forty deep as the key of a dictionary: its hash takes 2^40 steps."""
    data = b"\x80\x02}" + b"K\x01" + b"".join(b"2\x86" for _ in range(40)) + b"K\x02s."
    (folder / "x.pkl").write_bytes(data + b" imu_ori")
    return folder / "x.pkl"


def member_of_a_set(folder: Path) -> Path:
    inner = b"K\x01" + b"".join(b"2\x86" for _ in range(40))
    (folder / "x.pkl").write_bytes(b"\x80\x04\x8f(" + inner + b"\x90. imu_ori")
    return folder / "x.pkl"


def huge_integer(folder: Path) -> Path:
    """An integer of megabytes where an array's shape is expected."""
    good = pickle.dumps({"imu_ori": np.zeros((2, 2))}, 2)
    size = 4 << 20
    big = b"\x8b" + size.to_bytes(4, "little") + b"\x01" * size
    (folder / "x.pkl").write_bytes(good.replace(b"K\x02K\x02\x86", big + b"K\x02\x86", 1))
    return folder / "x.pkl"


def digits(folder: Path) -> Path:
    (folder / "x.pkl").write_bytes(b"I" + b"9" * (8 << 20) + b"\n. imu_ori")
    return folder / "x.pkl"


def bytes_to_floats(folder: Path) -> Path:
    """800 million zeros of one byte, in under 5 MB: 6.4 GB as the numbers that a reader makes of them."""
    path = folder / "x.npz"
    shape = (800_000_000 // 156, 156)
    header = np.lib.format.header_data_from_array_1_0(np.zeros(1, np.int8)) | {"shape": shape}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("poses.npy", "w", force_zip64=True) as f:
            np.lib.format.write_array_header_1_0(f, header)
            left = shape[0] * shape[1]
            while left > 0:
                f.write(bytes(min(left, 1 << 24)))
                left -= 1 << 24
        for name, value in (("trans", np.zeros((1, 3))), ("mocap_framerate", np.array(60.0))):
            with archive.open(f"{name}.npy", "w") as f:
                np.lib.format.write_array(f, value)
    return path


def in_mvnx(old: str, new: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = files.mvnx(folder)
        path.write_text(path.read_text().replace(old, new, 1))
        return path

    return make


BOMBS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "nested keys": (nested_keys, "a tuple as a key"),
    "a nested member of a set": (member_of_a_set, "a tuple as a key"),
    "a shape of megabytes": (huge_integer, "an integer of 4194304 bytes"),
    "digits by the million": (digits, "an integer of 8388608 digits"),
    "bytes that become floats": (bytes_to_floats, "MiB"),
    "a long attribute": (
        in_mvnx("<subject ", f'<subject comment="{"x" * (100 << 20)}" '), "a tag or comment of over"
    ),
    "a long comment": (in_mvnx("<subject ", f"<!--{'x' * (100 << 20)}--><subject "), "tag or comment"),
    "deep elements": (in_mvnx("<subject ", "<a>" * 200_000 + "<subject "), "elements lie over 100"),
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_bombs_are_refused(tmp_path: Path, bomb: str) -> None:
    make, said = BOMBS[bomb]
    assert said in refused(make(tmp_path))
