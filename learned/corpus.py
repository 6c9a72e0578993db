"""Motion capture as compact arrays: what training windows are cut from.

A `Corpus` holds every clip at one rate, low-passed, as unit quaternions and root positions in float32.
The cache lies outside the repository (`mocap.dataset.cache_folder`) and is named by what it was made
from, so that another selection of files makes another cache.
"""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap import dataset, formats
from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.formats._files import write_aside
from mocap.motion import Motion

RATE_HZ = 60.0
LOWPASS_HZ = 8.0
# A rig whose ankle, head or wrist turns further than this from its bone has flipped (some Daz clips
# do, by half a turn); people do not. Windows with such frames are left out.
FLIP_RAD = np.deg2rad(110.0)
_END_JOINTS = (7, 8, 12, 15, 20, 21)
_VERSION = "4"

Float = NDArray[np.float32]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Corpus:
    """Clips end to end at `RATE_HZ`.

    q (N,24,4): local rotations as unit quaternions, scalar first, sign-continuous within a clip. p (N,3)
    m: the pelvis. sound (N,): the frame may train (no flipped rig). start, length (C,): frames of each
    clip; names (C,); weight (C,): probability of drawing it.
    """

    q: Float
    p: Float
    sound: NDArray[np.bool_]
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
    names, qs, ps, sounds = [], [], [], []
    for name, motion in clips:
        motion = motion.resampled(RATE_HZ)
        q = ori.to_quat(motion.R_parent_joint)
        sign = np.cumprod(np.sign(np.sum(q[1:] * q[:-1], axis=-1) + 1e-300), axis=0)
        q[1:] *= sign[..., None]
        turn = ori.angle(motion.R_parent_joint[:, list(_END_JOINTS)])
        names.append(name)
        qs.append(q.astype(np.float32))
        ps.append(motion.p_world_root.astype(np.float32))
        sounds.append((turn < FLIP_RAD).all(axis=1))
    if not names:
        raise PoserError("no motion to train on")
    length = np.array([len(q) for q in qs])
    weight = np.sqrt(length.astype(float))
    return Corpus(
        np.concatenate(qs), np.concatenate(ps), np.concatenate(sounds),
        np.concatenate([[0], np.cumsum(length)[:-1]]), length, tuple(names), weight / weight.sum(),
    )  # fmt: skip


def prepared(motion: Motion) -> Motion:
    """At `RATE_HZ`, low-passed at `LOWPASS_HZ`: what sensors are put on.

    A slower motion is resampled first: the geodesic path between its frames has kinks at the frames,
    whose second differences are spikes, and the low-pass then rounds them.
    """
    if motion.rate_hz < RATE_HZ:
        return motion.resampled(RATE_HZ).lowpassed(LOWPASS_HZ)
    return motion.lowpassed(LOWPASS_HZ).resampled(RATE_HZ)


def key_of(paths: Sequence[Path]) -> str:
    """16 hexadecimal digits that change with the files (path, size, time) and with how they are read.

    Raises PoserError where a file is absent.
    """
    key = hashlib.sha256(_VERSION.encode())
    for path in paths:
        try:
            stat = path.stat()
        except OSError as e:
            raise PoserError(f"{path}: {e.strerror}") from e
        key.update(f"{path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}\n".encode())
    return key.hexdigest()[:16]


def read(paths: Sequence[Path], progress: Progress | None = None) -> Corpus:
    """The corpus of motion files of any format, from the cache where it is there.

    Raises PoserError naming the file where one cannot be read or holds no motion.
    """
    cached = dataset.cache_folder() / f"corpus-{key_of(paths)}.npz"
    if (found := _load(cached)) is not None:
        return found
    corpus = pack(_clips(paths, progress))
    cached.parent.mkdir(parents=True, exist_ok=True)
    with write_aside(cached) as aside:
        np.savez(
            aside, q=corpus.q, p=corpus.p, sound=corpus.sound, start=corpus.start,
            length=corpus.length, names=np.array(corpus.names), weight=corpus.weight,
        )  # fmt: skip
    return corpus


def _load(path: Path) -> Corpus | None:
    """A cached corpus; None where there is none, or a damaged one, which is made anew."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            return Corpus(
                data["q"], data["p"], data["sound"], data["start"], data["length"],
                tuple(str(n) for n in data["names"]), data["weight"],
            )  # fmt: skip
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def _clips(paths: Sequence[Path], progress: Progress | None) -> Iterable[tuple[str, Motion]]:
    for i, path in enumerate(paths):
        motion = formats.read(path).content
        if not isinstance(motion, Motion):
            raise PoserError(f"{path}: holds no motion, but a {type(motion).__name__}")
        if len(motion) >= 8:
            yield path.stem, prepared(motion)
        if progress:
            progress(i + 1, len(paths))
