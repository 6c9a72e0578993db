"""Random damage to good files: every reader ends soon, with little memory, in a result or a PoserError.

Run: python -m tests.fuzz [--seconds 600] [--seed N] [--cases N] [--only CASE]. Each case is read in a
child of its own with limits of time and memory. A failure prints seed and case, by which it is made again,
and its file is kept in build/fuzz/.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

import learned
from mocap import calibration, formats, sensors, synthesis
from mocap.errors import PoserError
from mocap.formats import Options
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.live import alignment
from tests.mocap.formats import recording_files as files
from tests.mocap.formats import rig_files, test_fuzz_motions

SECONDS, MEGABYTES = 20, 1500  # of a child: processor time, and memory beyond what it begins with
KEPT = Path("build/fuzz")
SHARED = Path(os.environ.get("POSER_SHARED", Path(__file__).resolve().parents[2] / "shared"))
BOMB = 8 << 20
NUMBERS = (
    b"nan", b"-inf", b"1e308", b"-1e308", b"1e-320", b"99999999999", b"-1", b"0", b"1", b"2", b"1e7", b"-0.5",
    b"180", b"9.81", b"1e3",
)  # fmt: skip
TOKENS = (
    *NUMBERS, b"", b"\t", b",", b"\n", b"<", b">", b"<!--", b'"', b"{", b"[", b"\x00", b"\xff\xfe", b"0x7",
    b"1_0", b"End Site", b"MOTION", b"#", b"CHANNELS 6", b"Frames:", b"endheader", b"\x80\x04", b"PK\x03\x04",
)  # fmt: skip
NUMBER = re.compile(rb"(?<![\w.+-])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")
VALUES = (np.nan, -np.inf, 1e308, -1e30, 1e-320, 0.0, -1.0, 1e6, 2.0)

Read = Callable[[Path], object]
Seed = tuple[str, Path, Read]
"""Its name, the file in a folder of its own, and how it is read."""


def _any(path: Path) -> object:
    return formats.read(path, Options())


def _smpl(path: Path) -> object:
    return Skeleton.from_smpl_file(path, np.ones(10))


def _weights(folder: Path) -> Path:
    path = folder / "w.safetensors"
    learned.save(learned.build(learned.for_network("imuposer", hidden=8)), path, {})
    return path


def _description(folder: Path) -> Path:
    return _weights(folder).with_suffix(".json")


def _calibration(folder: Path) -> Path:
    moving = motions.joined([motions.stand(2.0), motions.walk(3.0)])
    raw = synthesis.raw_recording(moving, sensors.SIX, synthesis.Noise(loss=0.0), rng=3)
    _, found = calibration.calibrate(raw, at=1.0, facing=0.0)
    path = folder / "calibration.json"
    path.write_text(found.to_json())
    return path


def _imuposer(folder: Path) -> Path:
    path = folder / "1.pkl"
    R = torch.eye(3).repeat(90, 5, 1, 1).reshape(90, 45)
    imu = torch.cat([torch.zeros(90, 15), R], dim=1)
    torch.save({"imu": imu, "pose": torch.zeros(90, 72), "trans": torch.zeros(90, 3)}, path)
    return path


WRITERS: dict[str, tuple[Callable[[Path], Path], Read]] = {
    "native recording": (files.native_recording, _any),
    "native raw": (files.native_raw, _any),
    "qmt": (files.qmt, _any),
    "sto": (files.sto, _any),
    "mtw": (lambda d: files.mtw(d) / "MT_trial_00B40001.txt", _any),
    "mvnx": (files.mvnx, _any),
    "mvnx motion": (lambda d: rig_files.write_mvnx(d, rig_files.a_motion(seconds=1.0)), _any),
    "csv": (files.csv_wide, _any),
    "watch": (files.watch, _any),
    "dip": (files.dip, _any),
    "dip release": (files.dip_npz, _any),
    "totalcapture": (files.totalcapture, _any),
    "totalcapture pickle": (files.tc_pkl, _any),
    "imuposer": (_imuposer, _any),
    "bvh": (test_fuzz_motions.WRITERS["bvh"], _any),
    "amc": (test_fuzz_motions.WRITERS["amc"], _any),
    "asf": (test_fuzz_motions.WRITERS["asf"], lambda p: _any(p.with_name("1_01.amc"))),
    "amass": (test_fuzz_motions.WRITERS["amass"], _any),
    "smpl": (test_fuzz_motions.WRITERS["smpl"], _smpl),
    "weights": (_weights, learned.load),
    "weights' description": (_description, lambda p: learned.load(p.with_suffix(".safetensors"))),
    "calibration": (_calibration, alignment.read),
}


def seeds(folder: Path) -> list[Seed]:
    """Good files as the project writes them, and the small ones of shared/ where it is there."""
    files.FRAMES = 90
    out = []
    for name, (write, read) in WRITERS.items():
        own = folder / re.sub(r"\W", "_", name)
        own.mkdir()
        path = write(own)
        # What is refused whole tells nothing; and what reading imports is there for all children.
        read(path)
        out.append((name, path, read))
    cases = SHARED / "cases"
    for path in sorted(p for p in cases.rglob("*") if p.is_file() and p.suffix != ".md"):
        own = folder / "shared" / path.parent.name / path.stem
        own.mkdir(parents=True)
        out.append((f"shared {path.name}", Path(shutil.copy(path, own)), _any))
    return out


def damaged(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """One wound or more, and their names."""
    done = []
    for _ in range(int(rng.choice([1, 1, 1, 1, 2, 4]))):
        wound = str(rng.choice(list(WOUNDS), p=SHARES))
        data = WOUNDS[wound](data, rng)
        done.append(wound)
    return data, " ".join(done)


def _at(data: bytes, rng: np.random.Generator) -> int:
    """A place; every second one near the beginning, where headers are."""
    end = min(len(data), 2000) if rng.random() < 0.5 else len(data)
    return int(rng.integers(0, end + 1))


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _at(data, rng)]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 20))):
        if out:
            out[min(_at(data, rng), len(out) - 1)] ^= int(rng.integers(1, 256))
    return bytes(out)


def _drop(data: bytes, rng: np.random.Generator) -> bytes:
    at = _at(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 400)) :]


def _double(data: bytes, rng: np.random.Generator) -> bytes:
    at = _at(data, rng)
    return data[: at + int(rng.integers(1, 400))] + data[at:]


def _token(data: bytes, rng: np.random.Generator) -> bytes:
    at = _at(data, rng)
    return data[:at] + TOKENS[int(rng.integers(len(TOKENS)))] + data[at + int(rng.integers(8)) :]


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """A number becomes another."""
    at = _at(data, rng)
    found = NUMBER.search(data, at)
    if found is None:
        return data
    return data[: found.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + data[found.end() :]


def _value(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes that may be a float become another: of double or single precision, at a place of its size."""
    kind = np.dtype(str(rng.choice(["<f8", "<f4"])))
    at = int(rng.integers(0, max(1, len(data) // kind.itemsize))) * kind.itemsize
    with np.errstate(over="ignore"):
        value = np.array(rng.choice(VALUES)).astype(kind).tobytes()
    return data[:at] + value + data[at + kind.itemsize :]


def _swap(data: bytes, rng: np.random.Generator) -> bytes:
    """Two lines change places."""
    lines = data.split(b"\n")
    i, j = (int(x) for x in rng.integers(0, len(lines), 2))
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _bomb(data: bytes, rng: np.random.Generator) -> bytes:
    """BOMB bytes of one kind, or a piece of the file over and over."""
    at = _at(data, rng)
    piece = (
        data[at : at + 60]
        if rng.random() < 0.5
        else bytes([int(rng.choice(list(b" 0\n,.[(<ab\x00")))])
    )
    return data[:at] + piece * (BOMB // max(1, len(piece))) + data[at:]


WOUNDS: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    "cut": _cut, "flip": _flip, "drop": _drop, "double": _double, "token": _token, "number": _number,
    "value": _value, "swap": _swap, "bomb": _bomb,
}  # fmt: skip
SHARES = (0.1, 0.1, 0.05, 0.05, 0.14, 0.25, 0.2, 0.1, 0.01)


def _inside(path: Path, rng: np.random.Generator) -> str:
    """Damage to a member of an archive, or one that is small and becomes large; whole again around it."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = str(rng.choice(sorted(members)))
    if rng.random() < 0.05:
        members[name], how = files.lying_npy((60_000_000,)) + bytes(480_000_000), "inflated"
    else:
        members[name], how = damaged(members[name], rng)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for member, data in members.items():
            archive.writestr(member, data)
    return f"in {name}: {how}"


def wounded(path: Path, rng: np.random.Generator) -> str:
    if zipfile.is_zipfile(path) and rng.random() < 0.8:
        return _inside(path, rng)
    data, how = damaged(path.read_bytes(), rng)
    path.write_bytes(data)
    return how


def child(path: Path, read: Read) -> tuple[str, str]:
    """What reading comes to in a child: "read", "refused" or "failed", and why."""
    out, into = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(out)
        answer = _answer(path, read)
        os.write(into, json.dumps(answer).encode()[:60_000])
        os._exit(0)
    os.close(into)
    with os.fdopen(out, "rb") as stream:
        said = stream.read()
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        return "failed", f"ended by {name} (SIGXCPU, SIGKILL: over {SECONDS} s)"
    kind, why = json.loads(said or b'["failed", "no answer"]')
    return kind, why


def _answer(path: Path, read: Read) -> tuple[str, str]:
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    most = held + (MEGABYTES << 20)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
    warnings.simplefilter("error")
    sys.setrecursionlimit(1000)
    try:
        read(path)
    except PoserError as e:
        text = str(e)
        if "\n" in text or len(text) - len(str(path)) > 1000:
            return "failed", f"a refusal that is no sentence: {text[:300]!r}"
        return "refused", type(e).__name__
    except BaseException:
        return "failed", traceback.format_exc()[-1500:]
    return "read", ""


def run(seed: int, cases: int, seconds: float, only: int | None = None) -> int:
    """The failures among so many cases, or as many as fit into the time."""
    torch.set_num_threads(1)
    told: Counter[str] = Counter()
    until, failures = time.monotonic() + seconds, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        good = seeds(folder)
        for case in range(cases) if only is None else (only,):
            if time.monotonic() > until:
                break
            what, path, read = good[case % len(good)]
            rng = np.random.default_rng((seed, case))
            work = folder / "work"
            shutil.rmtree(work, ignore_errors=True)
            shutil.copytree(path.parent, work)
            target = work / path.name
            how = wounded(target, rng)
            kind, why = child(target, read)
            told[kind] += 1
            if kind == "failed":
                failures += 1
                kept = KEPT / f"{seed}-{case}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(work, kept)
                print(
                    f"seed {seed} case {case} ({what}; {how}), kept in {kept}:\n{why}", flush=True
                )
    print(f"seed {seed}: {told.total()} cases, " + ", ".join(f"{n} {k}" for k, n in told.items()))
    return failures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--cases", type=int, default=1 << 40)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", type=int, metavar="CASE")
    args = parser.parse_args()
    print(f"seed {args.seed}", flush=True)
    sys.exit(1 if run(args.seed, args.cases, args.seconds, args.only) else 0)


if __name__ == "__main__":
    main()
