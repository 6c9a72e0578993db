"""IMUPoser's dataset (Mollyn et al. 2023): `P1` to `P10`, dictionaries of torch tensors in `.pkl` files.

`imu` (N,60): acceleration 5x3, then orientation 5x3x3, of left wrist, right wrist, left pocket, right
pocket, head; `pose` (N,72) SMPL axis-angle, `trans` (N,3) m, `betas`. Such a file is a pickle that only
torch can read: it goes through `torch.load(weights_only=True)`, which admits tensors and plain containers.
What the authors do not state is checked against the reference or told as an assumption: the rate (25 Hz, that
of the paper's network, 4.2), accelerations in m/s^2 without gravity, orientations of the bones, y up.
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Document, Format, Options, _checks, _holes, _physics, _pickled
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.recording import Recording
from mocap.sensors import FIVE

RATE = 25.0
MAX_BYTES = 2 << 30
WIDTHS = {"imu": 60, "pose": 72, "trans": 3}


def read(path: Path, options: Options) -> Document:
    """One file as a recording of the five places, with its reference."""
    data = _load(path)
    imu = _field(path, data, "imu")
    T = len(imu)
    if T == 0:
        raise FormatError(path, "holds no frame", "field imu")
    R = _checks.rotations(path, imu[:, 15:].reshape(T, 5, 3, 3), FIVE, "imu")
    acc = imu[:, :15].reshape(T, 5, 3) * _physics.factors(options)[0]
    rate = options.rate_hz or RATE
    reference, kept, doubts = _reference(path, data, rate, T, options)
    start_s = kept.start / rate
    rec = Recording(rate, FIVE, R[kept], acc[kept], reference=reference, start_s=start_s)
    assumed = [
        assumption("bones-y-up"),
    ]
    if options.rate_hz is None:
        assumed.insert(0, assumption("rate-of-paper", rate_hz=rate))
    if "betas" in data and options.smpl is None:
        assumed.append(assumption("betas-unused-smpl"))
    return Document("imuposer", rec, tuple(assumed), (*doubts, *_physics.calibrated(path, rec)))


def _load(path: Path) -> dict[str, Any]:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise FormatError(path, f"{size >> 20} MiB, at most {MAX_BYTES >> 20} are read")
    try:
        data = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as e:
        raise FormatError(path, "not tensors alone, or damaged: it is not loaded") from e
    # The rest of what a damaged file may raise inside torch cannot be listed.
    except Exception as e:
        raise FormatError(path, "not a whole torch file: damaged or cut short") from e
    if not isinstance(data, dict):
        raise FormatError(path, f"holds a {type(data).__name__}, expected a dictionary")
    return data


def _field(path: Path, data: dict[str, Any], name: str) -> Array:
    """A field (N, its width) as float64."""
    if name not in data:
        known = ", ".join(str(k) for k in list(data)[:12])
        raise FormatError(path, f"field {name!r} is missing (there is: {known[:200]})")
    value = data[name]
    where = f"field {name}"
    if not isinstance(value, torch.Tensor) or value.layout != torch.strided:
        raise FormatError(path, f"is a {type(value).__name__}, expected a dense tensor", where)
    shape = tuple(value.shape)
    if value.ndim < 1 or value.is_complex() or value.is_quantized or value.dtype == torch.bool:
        raise FormatError(path, f"is {value.dtype} {shape}, expected real numbers", where)
    # A view may declare more numbers than the file holds.
    if value.numel() * value.element_size() > value.untyped_storage().nbytes():
        raise FormatError(path, f"declares {shape}, more than the file holds", where)
    if value.is_meta:
        raise FormatError(path, "has a shape, but no numbers (torch's device meta)", where)
    width = WIDTHS[name]
    if value[:1].numel() != width and len(value):
        raise FormatError(path, f"is {shape}, expected (N, {width})", where)
    return np.array(value.detach().to(torch.float64).numpy()).reshape(len(value), width)


def _reference(
    path: Path, data: dict[str, Any], rate: float, T: int, options: Options
) -> tuple[Motion | None, slice, list[Finding]]:
    """The motion of `pose` and `trans` of the frames that it is known for (`_holes`), and these frames;
    without enough finite poses none, with a doubt.
    """
    pose = _field(path, data, "pose")
    if len(pose) != T:
        raise FormatError(path, f"is {pose.shape}, expected ({T}, 72)", "field pose")
    body = _pickled.body(options)
    whole = _holes.poses(pose, rate)
    kept = whole.kept
    motion, doubts = _pickled.reference(path, rate, whole.values, body, kept.start / rate)
    doubts = [*whole.notes, *doubts]
    if motion is None or "trans" not in data:
        return motion, kept, doubts
    trans = _field(path, data, "trans")
    if len(trans) != T:
        raise FormatError(path, f"is {trans.shape}, expected ({T}, 3)", "field trans")
    if not np.isfinite(trans[kept]).all():
        doubts.append(doubt("trans-not-finite"))
        return motion, kept, doubts
    return replace(motion, p_world_root=trans[kept] + body.offsets[0]), kept, doubts


def _sniff(path: Path, head: bytes) -> bool:
    """A zip of torch's (or its older pickle) that names `imu`, `pose` and no field of DIP's."""
    return _pickled.mentions(path, b"imu") and _pickled.mentions(path, b"torch")


FORMAT = Format(
    "imuposer",
    (".pkl", ".pt", ".pth"),
    _sniff,
    _checks.quiet(read),
    kinds=("recording",),
    about="IMUPoser's dataset",
    sign="IMUPoser's dataset",
)
