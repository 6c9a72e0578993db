"""Every writer, once with a disk that is full and once killed as it writes: see `test_writers`.

Run: python -m tests.writers FOLDER. Prints a line of JSON for each writer: its name and outcomes. Each write
is in a child whose files may hold so many bytes and no more: beyond, the system tells of it as of a full
disk, or ends the process.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import json
import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mocap import formats, sensors, synthesis
from mocap.errors import PoserError
from mocap.estimator import Pose
from mocap.formats import amass, bvh, csv, gltf, native, opensim
from mocap.formats._files import ASIDE
from mocap.synthesis import motions

MOTION = motions.builtin(seconds=3.0)
OTHER = motions.walk(3.0)
FILES = {
    "recording": "out.npz", "raw": "out.npz", "motion": "out.npz", "amass": "out.npz", "bvh": "out.bvh",
    "glb": "out.glb", "sto": "out.sto", "trc": "out.trc", "csv": "out.csv", "text": "results.json",
    "picture": "out.png", "placement": "out.png", "strip": "out.png", "gif": "out.gif", "mp4": "out.mp4",
    "weights": "out.safetensors", "state": "state.pt", "sink": "out.npz", "bvh sink": "out.bvh",
    "record": "out.npz", "rrd": "out.rrd",
}  # fmt: skip
"""Of each writer."""
NEEDS = {"rrd": "rerun", "mp4": "imageio_ffmpeg"}


def write(name: str, path: Path, second: bool) -> None:
    """Make the writer's file, of one motion or of the other, so that the two differ."""
    motion = OTHER if second else MOTION
    _WRITERS[name](path, motion)


def _recording(path: Path, motion: Any) -> None:
    native.write_recording(path, synthesis.recording(motion))


def _raw(path: Path, motion: Any) -> None:
    native.write_raw(
        path, synthesis.raw_recording(motion, sensors.SIX, synthesis.Noise(loss=0.0), rng=1)
    )


def _csv(path: Path, motion: Any) -> None:
    csv.FORMAT.write(  # type: ignore[misc]
        path, synthesis.raw_recording(motion, sensors.SIX, synthesis.Noise(loss=0.0), rng=1)
    )


def _text(path: Path, motion: Any) -> None:
    from poser import files

    files.write_text(path, json.dumps(motion.p_world_root.tolist()))


def _picture(path: Path, motion: Any) -> None:
    from poser.report import pictures

    pictures.save(pictures.skeletons({"a": motion}, [0.5]), path)


def _placement(path: Path, motion: Any) -> None:
    from poser.live import placement

    placement.draw(path, sensors.SIX if motion is MOTION else ("head", "pelvis"))


def _render(path: Path, motion: Any) -> None:
    from poser.__main__ import main

    made = path.parent / "in" / ("b.npz" if motion is OTHER else "a.npz")
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = main(["render", str(made), "-o", str(path), "--size", "64x64", "--to", "1"])
    if status:
        raise OSError(said.getvalue())


def _weights(path: Path, motion: Any) -> None:
    import learned

    model = learned.build(learned.for_network("imuposer", hidden=8))
    learned.save(model, path, {"of": float(motion.p_world_root.sum())})


def _state(path: Path, motion: Any) -> None:
    import torch

    from learned.training.run_folder import Identity, RunFolder
    from learned.training.settings import TrainSettings

    folder = RunFolder(path.parent)
    assert folder.state == path
    state = {"x": torch.as_tensor(motion.p_world_root.copy())}
    folder.write(state, Identity(TrainSettings(), "", "", []))


def _sink(name: str) -> Callable[[Path, Any], None]:
    def save(path: Path, motion: Any) -> None:
        from poser.live.sinks.protocol import SinkOrder

        kind = importlib.import_module(f"poser.live.sinks.{name}").SINK
        sink = kind.make(SinkOrder(str(path), motion.rate_hz, motion.skeleton, 0))
        for k in range(len(motion)):
            sink.write(Pose(k / motion.rate_hz, motion.R_parent_joint[k], motion.p_world_root[k]))
        sink.close()

    return save


def _record(path: Path, motion: Any) -> None:
    from poser.live.assembler import Row
    from poser.live.recorder import Recorder

    keeper = Recorder(path, ("head",), motion.rate_hz)
    for k in range(len(motion)):
        R = motion.R_world_joint[k, 15:16]
        keeper.take([Row(k / motion.rate_hz, R, np.zeros((1, 3)), np.ones(1, bool))])
    keeper.close()


_WRITERS: dict[str, Callable[[Path, Any], None]] = {
    "recording": _recording,
    "raw": _raw,
    "motion": native.write_motion,
    "amass": lambda p, m: amass.write_motion(p, m),
    "bvh": lambda p, m: bvh.write_motion(p, m),
    "glb": lambda p, m: gltf.write_motion(p, m),
    "sto": lambda p, m: opensim.write_orientations(p, m),
    "trc": lambda p, m: opensim.write_markers(p, m),
    "csv": _csv,
    "text": _text,
    "picture": _picture,
    "placement": _placement,
    "strip": _render,
    "gif": _render,
    "mp4": _render,
    "weights": _weights,
    "state": _state,
    "sink": _sink("motion_file"),
    "bvh sink": _sink("motion_file"),
    "record": _record,
    "rrd": _sink("rerun"),
}


def limited(name: str, path: Path, most: int, killed: bool) -> str:
    """The second file written over the first, in a child whose files end at `most` bytes."""
    out, into = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(out)
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL if killed else signal.SIG_IGN)
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        said = "written"
        try:
            write(name, path, second=True)
        except BaseException as e:
            said = f"{type(e).__name__}: {e}"
        os.write(into, said.encode())
        os._exit(0)
    os.close(into)
    with os.fdopen(out, "rb") as stream:
        said = stream.read().decode()
    _, status = os.waitpid(pid, 0)
    return "killed" if os.WIFSIGNALED(status) else said


def outcomes(name: str, folder: Path) -> Iterator[dict[str, Any]]:
    """What is there after each way to end."""
    path = folder / FILES[name]
    inputs = folder / "in"
    inputs.mkdir(parents=True)
    native.write_motion(inputs / "a.npz", MOTION)
    native.write_motion(inputs / "b.npz", OTHER)
    write(name, path, second=True)
    size = path.stat().st_size

    def there() -> dict[str, bytes]:
        files = (p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
        return {p.name: p.read_bytes() for p in files}

    for killed in (False, True):
        for most in (size // 2, size - 1):
            for p in there():
                (folder / p).unlink()
            write(name, path, second=False)
            before = there()
            said = limited(name, path, most, killed)
            after = there()
            left = [p.name for p in folder.iterdir() if p.name.startswith(ASIDE)]
            yield {
                "killed": killed, "most": most, "said": said, "left": left,
                "kept": all(after.get(n) == data for n, data in before.items()),
                "whole": _reads(path), "others": sorted(set(after) - set(before)),
            }  # fmt: skip


def _reads(path: Path) -> bool:
    """Whether the file that is there now is one that can be read; False of those that are only written."""
    try:
        formats.read(path)
    except PoserError:
        return False
    return True


def main() -> None:
    folder = Path(sys.argv[1])
    for name in sys.argv[2:] or _WRITERS:
        if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
            found = []  # an extra that is not installed
        else:
            found = list(outcomes(name, folder / name.replace(" ", "_")))
        print(json.dumps([name, found]), flush=True)


if __name__ == "__main__":
    main()
