"""The reader of IMUPoser's dataset: what was written is read, what is broken is refused in a sentence."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learned.imuposer.dataset import FORMAT
from mocap import formats, synthesis
from mocap.errors import FormatError, PoserError
from mocap.formats import Options
from mocap.recording import Recording
from mocap.sensors import FIVE
from tests.learned.swing import wavy

MOTION = wavy(90, rate_hz=25.0)
LEFT_HANDED = np.diag([1.0, 1, -1])


def fields() -> dict[str, Any]:
    """A file's dictionary: accelerations first, then orientations, all float32."""
    rec = synthesis.recording(MOTION, FIVE)
    T = len(rec)
    acc = np.array(rec.acc_world)
    acc[[0, -1]] = acc[[1, -2]]
    imu = np.concatenate([acc.reshape(T, 15), rec.R_world_bone.reshape(T, 45)], axis=1)
    return {
        "imu": torch.tensor(imu).float(),
        "pose": torch.tensor(MOTION.poses).float(),
        "trans": torch.tensor(MOTION.trans).float(),
        "betas": torch.zeros(10),
    }


def written(folder: Path, data: object = None, **options: Any) -> Path:
    path = folder / "squats.pkl"
    torch.save(fields() if data is None else data, path, **options)
    return path


@pytest.mark.parametrize("zipped", [True, False])
def test_what_was_written_is_read(tmp_path: Path, zipped: bool) -> None:
    path = written(tmp_path, _use_new_zipfile_serialization=zipped)
    document = formats.read(path)
    rec = document.content
    assert document.format == "imuposer" and isinstance(rec, Recording)
    want = synthesis.recording(MOTION, FIVE)
    assert (rec.rate_hz, rec.sensors) == (25.0, FIVE)
    np.testing.assert_allclose(rec.R_world_bone, want.R_world_bone, atol=1e-6)
    np.testing.assert_allclose(rec.acc_world[1:-1], want.acc_world[1:-1], atol=1e-5)
    assert rec.reference is not None
    np.testing.assert_allclose(rec.reference.p_world_joint, MOTION.p_world_joint, atol=1e-5)
    assert any("rate 25 Hz" in a for a in document.assumptions)
    assert document.warnings == ()


def test_the_rate_can_be_told(tmp_path: Path) -> None:
    # At another rate the accelerations no longer fit the reference: the reader may doubt, not refuse.
    document = FORMAT.read(written(tmp_path), Options(rate_hz=24.0))
    assert document.content.rate_hz == 24.0
    assert not any("rate" in a for a in document.assumptions)


def test_it_is_registered() -> None:
    points = {p.name: p for p in entry_points(group="poser.formats")}
    assert points["imuposer"].load() is FORMAT


def test_holes_of_the_reference(tmp_path: Path) -> None:
    """Short ones are bridged, ends cut off with the sensors; with most poses lost the sensors stay alone."""
    data = fields()
    data["pose"][30], data["pose"][:4] = float("nan"), float("nan")
    document = FORMAT.read(written(tmp_path, data), Options())
    rec = document.content
    assert isinstance(rec, Recording) and rec.reference is not None
    assert len(rec) == len(rec.reference) == 86
    assert rec.start_s == rec.reference.start_s == pytest.approx(4 / 25)
    np.testing.assert_allclose(
        rec.reference.p_world_joint[[0, 50]], MOTION.p_world_joint[[4, 54]], atol=1e-5
    )
    assert any("bridged" in w for w in document.warnings)
    data["pose"][::2] = float("nan")
    data["pose"][20:80] = float("nan")
    document = FORMAT.read(written(tmp_path, data), Options())
    assert isinstance(document.content, Recording) and document.content.reference is None
    assert len(document.content) == 90
    assert any("no reference" in w for w in document.warnings)


def _with(**changes: object) -> Callable[[Path], Path]:
    """Fields changed by a function, replaced, or dropped (None)."""

    def make(folder: Path) -> Path:
        data = fields()
        for name, change in changes.items():
            if change is None:
                del data[name]
            else:
                data[name] = change(data[name]) if callable(change) else change
        return written(folder, data)

    return make


def _cut(keep: float) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = written(folder)
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
        return path

    return make


def _mirrored(imu: torch.Tensor) -> torch.Tensor:
    R = imu[:, 15:].reshape(-1, 5, 3, 3) @ torch.tensor(LEFT_HANDED).float()
    return torch.cat([imu[:, :15], R.flatten(1)], 1)


def _stretched(imu: torch.Tensor) -> torch.Tensor:
    imu = imu.clone()
    imu[7, 15:24] *= 1.3
    return imu


def _acc(change: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[torch.Tensor], torch.Tensor]:
    return lambda imu: torch.cat([change(imu[:, :15]), imu[:, 15:]], 1)


UP = torch.tensor([0, 9.81, 0]).repeat(5)
BROKEN: dict[str, tuple[Callable[[Path], Path], str]] = {
    "empty": (_cut(0.0), "damaged or cut short"),
    "cut in the middle": (_cut(0.5), "damaged or cut short"),
    "cut at the end": (_cut(0.97), "damaged or cut short"),
    "a list": (lambda d: written(d, [torch.zeros(3, 60)]), "holds a list, expected a dictionary"),
    "no imu": (_with(imu=None), "field 'imu' is missing"),
    "no pose": (_with(pose=None), "field 'pose' is missing"),
    "thin": (_with(imu=lambda x: x[:, :59]), r"field imu: is \(90, 59\), expected \(N, 60\)"),
    "no frames": (_with(imu=lambda x: x[:0]), "field imu: holds no frame"),
    "other length": (_with(pose=lambda x: x[:80]), r"field pose: is \(80, 72\), expected \(90, 72\)"),
    "path of other length": (_with(trans=lambda x: x[:80]), r"field trans: is \(80, 3\)"),
    "complex": (_with(imu=lambda x: x + 1j), "expected real numbers"),
    "sparse": (_with(imu=lambda x: x.to_sparse()), "expected a dense tensor"),
    "text": (_with(imu="abc"), "is a str, expected a dense tensor"),
    "more than it holds": (_with(imu=torch.zeros(1, 60).expand(10**9, 60)), "more than the file holds"),
    "left-handed": (_with(imu=_mirrored), "frame 0, sensor left_wrist: imu: left-handed"),
    "not orthonormal": (_with(imu=_stretched), "frame 7, sensor left_wrist: imu: not orthonormal"),
    "gravity in": (_with(imu=_acc(lambda a: a + UP)), "gravity must be removed"),
    "in degrees": (_with(pose=lambda x: 200 * x), "expected radians"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::UserWarning:torch")
@pytest.mark.parametrize("case", BROKEN)
def test_broken(case: str, tmp_path: Path) -> None:
    make, said = BROKEN[case]
    path = make(tmp_path)
    with pytest.raises(PoserError, match=said) as caught:
        FORMAT.read(path, Options())
    text = str(caught.value)
    assert isinstance(caught.value, FormatError)
    assert text.startswith(str(path)) and "\n" not in text and len(text) - len(str(path)) < 300


class Evil:
    """Unpickled without care, it would write a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.write_text, (self.target, "executed")


@pytest.mark.parametrize("save", [torch.save, lambda x, p: p.write_bytes(pickle.dumps(x))])
def test_a_malicious_pickle_runs_nothing(tmp_path: Path, save: Callable[..., object]) -> None:
    path = tmp_path / "squats.pkl"
    save(fields() | {"imu": Evil(tmp_path / "executed")}, path)
    with pytest.raises(FormatError, match="damaged"):
        FORMAT.read(path, Options())
    assert not (tmp_path / "executed").exists()


def test_damage_anywhere_gives_a_document_or_a_sentence(tmp_path: Path) -> None:
    good = written(tmp_path).read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "damaged.pkl"
    for _ in range(60):
        data = bytearray(good)
        for at in rng.integers(len(data), size=3):
            data[at] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(data))
        said = ""
        try:
            FORMAT.read(path, Options())
        except PoserError as e:
            said = str(e)
        assert "\n" not in said


def test_other_pickles_are_not_taken_for_it(tmp_path: Path) -> None:
    path = tmp_path / "dip.pkl"
    path.write_bytes(pickle.dumps({"imu_ori": np.zeros(3), "imu_acc": np.zeros(3)}))
    assert not FORMAT.sniff(path, b"")
    assert FORMAT.sniff(written(tmp_path), b"")


def test_without_torch_it_is_absent_with_a_sentence(tmp_path: Path) -> None:
    """A process in which torch cannot be imported: other formats still read, this file is refused."""
    path = written(tmp_path)
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from mocap import formats\n"
        "from mocap.errors import FormatError\n"
        "assert 'imuposer' not in [f.name for f in formats.registry()]\n"
        "try:\n"
        f"    formats.read({str(path)!r})\n"
        "except FormatError as e:\n"
        "    print(e)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.count("\n") == 1 and str(path) in out.stdout
    assert len(out.stdout) < 300
