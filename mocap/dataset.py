"""The motion capture that the project trains and tests on: which clip comes from where and belongs where.

CMU's trials are read from the original ASF/AMC where that is there, else from the Daz-friendly BVH, a few
from MotionBuilder's BVH; no trial twice. The split is fixed and goes by subject: test = CMU 02, 05, 09;
validation = CMU 06, 12, 17, 35 and every tenth Bandai clip; every other clip trains. A clip's windows never
part.

Archives are looked for unpacked in `cache_folder`, then in the folder `data` of $POSER_SHARED or of `shared`
beside the repository. What is absent is not used: `absent` names it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from mocap import faults
from mocap.errors import PoserError
from mocap.formats import Options, asfamc, bvh
from mocap.motion import Motion

Split = Literal["train", "validation", "test"]
ClipSource = Literal["cmu-amc", "cmu-daz-bvh", "cmu-motionbuilder-bvh", "bandai2-bvh"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
TEST_SUBJECTS, VALIDATION_SUBJECTS = ("02", "05", "09"), ("06", "12", "17", "35")
READERS_ONLY = ("131",)
# Of each collection its archives, the better first: where two hold a trial the first one's counts.
ARCHIVES: dict[str, tuple[ClipSource, ...]] = {
    "cmu": ("cmu-amc", "cmu-daz-bvh", "cmu-motionbuilder-bvh"),
    "bandai": ("bandai2-bvh",),
}
NAMES: dict[ClipSource, str] = {
    "cmu-amc": "CMU's mocap in the original ASF/AMC",
    "cmu-daz-bvh": "the Daz-friendly BVH conversion of CMU's mocap (cgspeed.com)",
    "cmu-motionbuilder-bvh": "the MotionBuilder BVH conversion of CMU's mocap",
    "bandai2-bvh": "Bandai-Namco-Research-Motiondataset-2",
}
_SUFFIX: dict[ClipSource, str] = {
    "cmu-amc": "amc", "cmu-daz-bvh": "bvh", "cmu-motionbuilder-bvh": "bvh", "bandai2-bvh": "bvh",
}  # fmt: skip
SALSA_HZ = 60.0  # the salsa clips' rate of capture; their headers say 120
KARATE = "135"  # the subject of the Daz set's martial clips, whose numbers are not CMU's
LOWPASS_HZ = 8.0
_TRIAL = re.compile(r"^(\d+)_\d+$")


@dataclass(frozen=True)
class Clip:
    """A file of the data set.

    rate_hz: of the capture, where the file states another. left_out: why it is not used, "" if it is.
    """

    name: str
    path: Path
    source: ClipSource
    split: Split
    rate_hz: float | None = None
    left_out: str = ""

    @property
    def subject(self) -> str:
        """See `subject_of`."""
        return subject_of(self.name)

    def read(self) -> faults.Mended:
        """The motion on the default body at the rate of capture, faults turned back or marked."""
        return read(self.path, self.rate_hz)

    def motion(self, lowpass_hz: float | None = LOWPASS_HZ, rate_hz: float | None = None) -> Motion:
        """The motion of `read`, low-passed and resampled."""
        motion = self.read().motion
        if lowpass_hz is not None:
            motion = motion.lowpassed(lowpass_hz)
        return motion if rate_hz is None else motion.resampled(rate_hz)


def cache_folder() -> Path:
    """Where unpacked archives are kept: $POSER_CACHE or ~/.cache/poser."""
    return Path(os.environ.get("POSER_CACHE", Path.home() / ".cache" / "poser"))


def shared_folder() -> Path:
    """The project's data folder: `data` in $POSER_SHARED, or in `shared` beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    return Path(os.environ.get("POSER_SHARED", beside)) / "data"


def split_of(name: str, bandai_index: int | None = None) -> Split:
    """The split of a clip by its name (stem); bandai_index: its place among the sorted Bandai clips."""
    if bandai_index is not None:
        return "validation" if bandai_index % 10 == 0 else "train"
    found = _TRIAL.match(name)
    subject = found.group(1) if found else ""
    if subject in TEST_SUBJECTS:
        return "test"
    return "validation" if subject in VALIDATION_SUBJECTS else "train"


def subject_of(name: str) -> str:
    """CMU subject of a clip's name, else the collection it belongs to."""
    found = _TRIAL.match(name)
    return found.group(1) if found else name.split("_")[0]


def absent(collections: Sequence[str] = ("cmu", "bandai")) -> list[ClipSource]:
    """Archives of these collections that are nowhere unpacked."""
    return [a for c in collections for a in ARCHIVES[c] if not _files(a)]


def every(collections: Sequence[str] = ("cmu", "bandai")) -> list[Clip]:
    """Every file that is there, by collection and name, those that are left out with the reason.

    Raises PoserError where a collection has no file at all.
    """
    return [clip for c in collections for clip in (_cmu() if c == "cmu" else _bandai())]


def select(split: Split, collections: Sequence[str] = ("cmu", "bandai")) -> list[Clip]:
    """The clips of a split, by collection and name. Raises PoserError where a collection has no file."""
    return [c for c in every(collections) if c.split == split and not c.left_out]


def clips(
    split: Split,
    collections: Sequence[str] = ("cmu",),
    rate_hz: float = 60.0,
    min_s: float = 0.0,
    max_s: float = float("inf"),
) -> Iterator[tuple[str, Motion]]:
    """Name and motion of each clip of a split, low-passed at `LOWPASS_HZ`, cut to at most max_s seconds."""
    for clip in select(split, collections):
        motion = clip.motion(LOWPASS_HZ, rate_hz)
        if motion.seconds >= min_s:
            yield clip.name, motion.slice(0, int(min(len(motion), max_s * rate_hz)))


def read(path: Path, rate_hz: float | None = None) -> faults.Mended:
    """A file of motion capture at the rate of capture, faults turned back or marked."""
    fmt = asfamc.FORMAT if path.suffix.lower() == ".amc" else bvh.FORMAT
    motion = fmt.read(path, Options(rate_hz=rate_hz)).content
    assert isinstance(motion, Motion)
    return faults.mend(motion)


def _cmu() -> list[Clip]:
    """A trial counts once, from the first archive that has it."""
    there = {source: _files(source) for source in ARCHIVES["cmu"]}
    if not any(there.values()):
        raise PoserError(
            f"{cache_folder() / 'cmu-amc'} holds no .amc and {cache_folder() / 'cmu-daz-bvh'} no .bvh file: "
            f"unpack CMU's mocap there"
        )
    karate = any(subject_of(p.stem) == KARATE for p in there["cmu-amc"])
    found: dict[str, Clip] = {}
    again: list[Clip] = []
    for source, paths in there.items():
        for path in paths:
            name = path.stem
            rate = SALSA_HZ if source == "cmu-daz-bvh" and name.startswith("salsa_") else None
            clip = Clip(name, path, source, split_of(name), rate)
            if subject_of(name) in READERS_ONLY:
                again.append(replace(clip, left_out="serves the readers' tests alone"))
            elif source == "cmu-daz-bvh" and name.startswith("martial_") and karate:
                again.append(replace(clip, left_out=f"subject {KARATE}, used from cmu-amc"))
            elif name in found:
                again.append(
                    replace(clip, left_out=f"the same trial, used from {found[name].source}")
                )
            else:
                found[name] = clip
    return sorted(
        [*found.values(), *again], key=lambda c: (c.name, ARCHIVES["cmu"].index(c.source))
    )


def _bandai() -> list[Clip]:
    paths = _files("bandai2-bvh")
    if not paths:
        raise PoserError(
            f"{cache_folder() / 'bandai2-bvh'} holds no .bvh file: unpack {NAMES['bandai2-bvh']} there"
        )
    return [Clip(p.stem, p, "bandai2-bvh", split_of(p.stem, i)) for i, p in enumerate(paths)]


def _files(source: ClipSource) -> list[Path]:
    """Motion files of an archive, by name, from the first place that has any."""
    for folder in (cache_folder() / source, shared_folder() / source):
        found = sorted(folder.rglob(f"*.{_SUFFIX[source]}"), key=lambda p: p.name)
        if found:
            return found
    return []
