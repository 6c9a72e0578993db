"""Motion capture as compact arrays: what training windows are cut from.

A `Corpus` holds every clip at one rate, low-passed, as unit quaternions and root positions in float32; faults
of the capture are turned back or marked before that (`mocap.faults`). The cache lies outside the repository
(`mocap.dataset.cache_folder`): one small file a motion file, written as soon as that one is read, so that
reading 15,000 of them can be interrupted and a file more costs one file. Any of it may be deleted. An entry
holds for the file it was made from and the code that read it: with another one it is made anew.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

import mocap
from mocap import dataset, faults, formats
from mocap import orientation as ori
from mocap.dataset import Clip
from mocap.errors import PoserError
from mocap.formats._files import write_aside
from mocap.motion import Motion

RATE_HZ = 60.0
LOWPASS_HZ = 8.0
# Of what training sees in a file: a run that was begun with another version does not go on.
_VERSION = "5"
# The code that decides which pose a file of captured motion is: where it changes, entries are made anew.
_READ_BY = (
    "faults.py", "formats/_asf_text.py", "formats/_bvh_text.py", "formats/_frames.py",
    "formats/_geometry.py", "formats/_neutral.py", "formats/_rigs.py", "formats/_upright.py",
    "formats/_retarget.py", "formats/_source.py", "formats/asfamc.py", "formats/bvh.py",
)  # fmt: skip

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]
Given = Path | Clip
G = TypeVar("G", bound=Given)
Progress = Callable[[int, int], None]
Unreadable = Callable[[Path, PoserError], None]
Arrays = tuple[Float, Float, Mask, Mask]  # q (N,24,4), p (N,3), sound and mended (N,) of one clip


@dataclass(frozen=True, eq=False)
class Corpus:
    """Clips end to end at `RATE_HZ`.

    q (N,24,4): local rotations as unit quaternions, scalar first, sign-continuous within a clip. p (N,3)
    m: the pelvis. sound (N,): the frame may train (`Motion.trusted`). start, length (C,): frames of each
    clip; names (C,): what `pack` was given, of `read` the files' paths; weight (C,): probability of
    drawing it.
    """

    q: Float
    p: Float
    sound: Mask
    start: NDArray[np.int64]
    length: NDArray[np.int64]
    names: tuple[str, ...]
    weight: NDArray[np.float64]

    @property
    def seconds(self) -> float:
        """Length of all clips in s."""
        return float(self.length.sum() / RATE_HZ)

    def subset(self, share: float, seed: int = 0) -> Corpus:
        """A share (0 to 1] of the clips, drawn without replacement: nested for one seed."""
        order = np.random.default_rng(seed).permutation(len(self.names))
        keep = np.sort(order[: max(1, round(share * len(order)))])
        return self._of(keep, self.weight[keep])

    def _of(self, keep: NDArray[np.int64], weight: NDArray[np.float64]) -> Corpus:
        return Corpus(
            self.q, self.p, self.sound, self.start[keep], self.length[keep],
            tuple(self.names[k] for k in keep), weight / weight.sum(),
        )  # fmt: skip

    @classmethod
    def join(cls, parts: Sequence[Corpus], shares: Sequence[float]) -> Corpus:
        """Several corpora drawn from in these proportions."""
        shift = np.cumsum([0, *(len(c.q) for c in parts[:-1])])
        weight = np.concatenate([c.weight * s for c, s in zip(parts, shares, strict=True)])
        return cls(
            np.concatenate([c.q for c in parts]),
            np.concatenate([c.p for c in parts]),
            np.concatenate([c.sound for c in parts]),
            np.concatenate([c.start + s for c, s in zip(parts, shift, strict=True)]),
            np.concatenate([c.length for c in parts]),
            tuple(n for c in parts for n in c.names),
            weight / weight.sum(),
        )


def pack(clips: Iterable[tuple[str, Motion]]) -> Corpus:
    """A corpus of named motions, each resampled to `RATE_HZ`; see `prepared`.

    Clips are drawn with probability proportional to the square root of their length: repetitive long
    clips count less than their frames, short ones more.
    """
    found = [(name, _arrays(motion.resampled(RATE_HZ))) for name, motion in clips]
    return _end_to_end(
        [name for name, _ in found], [len(a[0]) for _, a in found], (a for _, a in found)
    )


def _arrays(motion: Motion, mended: Mask | None = None) -> Arrays:
    """What a corpus holds of a motion at `RATE_HZ`."""
    q = ori.to_quat(motion.R_parent_joint)
    sign = np.cumprod(np.sign(np.sum(q[1:] * q[:-1], axis=-1) + 1e-300), axis=0)
    q[1:] *= sign[..., None]
    everywhere, nowhere = np.ones(len(q), bool), np.zeros(len(q), bool)
    return (
        q.astype(np.float32),
        motion.p_world_root.astype(np.float32),
        everywhere if motion.trusted is None else motion.trusted,
        nowhere if mended is None else mended,
    )


def _end_to_end(names: Sequence[str], frames: Sequence[int], clips: Iterable[Arrays]) -> Corpus:
    """The clips are taken one after another: all of them at once would be the corpus a second time."""
    if not names:
        raise PoserError("no motion to train on")
    length = np.array(frames)
    start, weight = np.concatenate([[0], np.cumsum(length)[:-1]]), np.sqrt(length.astype(float))
    q = np.empty((length.sum(), 24, 4), np.float32)
    p, sound = np.empty((len(q), 3), np.float32), np.empty(len(q), bool)
    for name, at, n, arrays in zip(names, start, length, clips, strict=True):
        if len(arrays[0]) != n:
            raise PoserError(f"{name}: changed while it was read")
        for whole, own in zip((q, p, sound), arrays[:3], strict=True):
            whole[at : at + n] = own
    return Corpus(q, p, sound, start, length, tuple(names), weight / weight.sum())


def prepared(motion: Motion) -> Motion:
    """At `RATE_HZ`, low-passed at `LOWPASS_HZ`: what sensors are put on.

    A slower motion is resampled first: the geodesic path between its frames has kinks at the frames,
    whose second differences are spikes, and the low-pass then rounds them.
    """
    if motion.rate_hz < RATE_HZ:
        return motion.resampled(RATE_HZ).lowpassed(LOWPASS_HZ)
    return motion.lowpassed(LOWPASS_HZ).resampled(RATE_HZ)


def key_of(given: Sequence[Given]) -> str:
    """16 hexadecimal digits that change with the files (path, size, time) and with how they are read.

    Raises PoserError where a file is absent.
    """
    key = hashlib.sha256(_VERSION.encode())
    for one in given:
        key.update(f"{_identity(one)}\n".encode())
    return key.hexdigest()[:16]


def _identity(given: Given) -> str:
    """A file's path, size and time, and the rate that it is read at where that is not its own. Not its bytes:
    of AMASS they would take minutes at every start."""
    path = _path(given)
    try:
        stat = path.stat()
    except OSError as e:
        raise PoserError(f"{path}: {e.strerror}") from e
    rate = given.rate_hz if isinstance(given, Clip) else None
    at = f"|{rate:g} Hz" if rate else ""
    return f"{path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}{at}"


def _path(given: Given) -> Path:
    return given.path if isinstance(given, Clip) else given


@cache
def _readers() -> str:
    """8 hexadecimal digits of the code that makes an entry of the cache from a file."""
    here = Path(mocap.__file__).parent
    digest = hashlib.sha256(_VERSION.encode())
    for name in _READ_BY:
        digest.update((here / name).read_bytes())
    return digest.hexdigest()[:8]


def read(given: Sequence[G], progress: Progress | None = None) -> Corpus:
    """The corpus of motion files of any format, each from the cache where it is there.

    Raises PoserError naming the file where one cannot be read or holds no motion.
    """
    return cached(frames(given, progress))


def frames(
    given: Sequence[G], progress: Progress | None = None, unreadable: Unreadable | None = None
) -> dict[G, int]:
    """How many frames a corpus has of each file, zero of motions too short to train; the cache has all then.

    unreadable: told of every file that cannot be read or holds no motion, and why; the file is left out.
    Raises PoserError naming the file where nobody is told, and where none is left.
    """
    found: dict[G, int] = {}
    first: PoserError | None = None
    for i, one in enumerate(given):
        try:
            found[one] = _frames(one)
        except PoserError as e:
            if unreadable is None:
                raise
            unreadable(_path(one), e)
            first = first or e
        if progress:
            progress(i + 1, len(given))
    if first and not found:
        raise PoserError(f"none of the motions can be read: {first}") from first
    return found


def cached(found: Mapping[G, int]) -> Corpus:
    """The corpus of what `frames` has found."""
    long = {one: n for one, n in found.items() if n}
    return _end_to_end([str(_path(one)) for one in long], list(long.values()), map(_clip, long))


def counts(given: Given) -> tuple[int, int, int]:
    """Of a file, from the cache where it is there: (frames at `RATE_HZ`, those that may not train, those of
    the others in which a fault was turned back)."""
    _, _, sound, mended = _clip(given)
    return len(sound), int((~sound).sum()), int((sound & mended).sum())


def _frames(given: Given) -> int:
    """How many frames `_clip` has of a file, which is in the cache then."""
    entry, made_from = _entry(given)
    found = _stored(entry, "sound", "made_from")
    return len(found[0]) if found and str(found[1]) == made_from else len(_clip(given)[0])


def _clip(given: Given) -> Arrays:
    """The motion of a file, from the cache where it is there; of no frames where it is shorter than 8."""
    entry, made_from = _entry(given)
    found = _stored(entry, "q", "p", "sound", "mended", "made_from")
    if found and str(found[4]) == made_from:
        return found[0], found[1], found[2], found[3]
    arrays: Arrays = (
        np.empty((0, 24, 4), np.float32), np.empty((0, 3), np.float32), np.empty(0, bool), np.empty(0, bool),
    )  # fmt: skip
    done = _captured(given)
    if len(done.motion) >= 8:
        motion = prepared(done.motion)
        arrays = _arrays(motion, done.mended_at(motion))
    with write_aside(entry) as aside:
        q, p, sound, mended = arrays
        np.savez(aside, q=q, p=p, sound=sound, mended=mended, made_from=np.array(made_from))
    return arrays


def _captured(given: Given) -> faults.Mended:
    """The motion of a file as it was captured, without its faults."""
    if isinstance(given, Clip):
        return given.read()
    motion = formats.read(given).content
    if not isinstance(motion, Motion):
        raise PoserError(f"{given}: holds no motion, but a {type(motion).__name__}")
    return faults.mend(motion)


def _entry(given: Given) -> tuple[Path, str]:
    """The cache file of a motion file, and what it must say that it was made from.

    It is named by the path alone, so that the entry of a file that has changed is replaced.
    """
    name = hashlib.sha256(str(_path(given).resolve()).encode()).hexdigest()[:16]
    made_from = f"{_readers()}|{_identity(given)}"
    return dataset.cache_folder() / "clips" / f"{name}.npz", made_from


def _stored(path: Path, *names: str) -> list[NDArray[Any]] | None:
    """Arrays of a cache file; None where there is none, or a damaged one, which is made anew."""
    try:
        with zipfile.ZipFile(path) as file:
            # Each whole, so that its checksum is looked at: an array's damaged header may ask for less.
            whole = [io.BytesIO(file.read(f"{name}.npy")) for name in names]
        return [np.load(array, allow_pickle=False) for array in whole]
    # What zipfile raises of flipped bytes cannot be listed: unknown methods, passwords, texts, numbers.
    except Exception:
        return None
