"""The motion-capture data that the project trains and tests on: which clip belongs where.

The split is fixed and goes by subject (design, data README): test = CMU subjects 02, 05, 09; validation =
CMU 06 and 12 and every tenth Bandai clip; every other clip trains. Windows of one clip never part.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from mocap.errors import PoserError
from mocap.formats import Options, bvh
from mocap.motion import Motion

Split = Literal["train", "validation", "test"]
TEST_SUBJECTS, VALIDATION_SUBJECTS = ("02", "05", "09"), ("06", "12")
NAMES = {
    "cmu": "the Daz-friendly BVH conversion of CMU's mocap (cgspeed.com)",
    "bandai": "Bandai-Namco-Research-Motiondataset-2",
}
_CMU = re.compile(r"^(\d\d)_\d\d$")


def cache_folder() -> Path:
    """Where unpacked archives are kept: $POSER_CACHE or ~/.cache/poser."""
    return Path(os.environ.get("POSER_CACHE", Path.home() / ".cache" / "poser"))


def split_of(name: str, bandai_index: int | None = None) -> Split:
    """The split of a clip by its name (stem); bandai_index: its place among the sorted Bandai clips."""
    if bandai_index is not None:
        return "validation" if bandai_index % 10 == 0 else "train"
    found = _CMU.match(name)
    subject = found.group(1) if found else ""
    if subject in TEST_SUBJECTS:
        return "test"
    return "validation" if subject in VALIDATION_SUBJECTS else "train"


def subject_of(name: str) -> str:
    """CMU subject of a clip's name, else the collection it belongs to."""
    found = _CMU.match(name)
    return found.group(1) if found else name.split("_")[0]


def files(split: Split, collections: tuple[str, ...] = ("cmu", "bandai")) -> list[Path]:
    """BVH files of a split in the cache folder, sorted by name.

    Raises PoserError where a collection has not been unpacked there.
    """
    found = []
    for collection in collections:
        folder = cache_folder() / {"cmu": "cmu-daz-bvh", "bandai": "bandai2-bvh"}[collection]
        paths = sorted(folder.glob("*.bvh"))
        if not paths:
            raise PoserError(f"{folder} holds no .bvh file: unpack {NAMES[collection]} there")
        for i, path in enumerate(paths):
            index = i if collection == "bandai" else None
            if split_of(path.stem, index) == split:
                found.append(path)
    return found


def load(path: Path, lowpass_hz: float | None = 8.0, rate_hz: float | None = None) -> Motion:
    """A clip on the default body, low-passed and resampled."""
    motion = bvh.FORMAT.read(path, Options()).content
    assert isinstance(motion, Motion)
    if lowpass_hz is not None:
        motion = motion.lowpassed(lowpass_hz)
    return motion if rate_hz is None else motion.resampled(rate_hz)


def clips(
    split: Split,
    collections: tuple[str, ...] = ("cmu",),
    rate_hz: float = 60.0,
    min_s: float = 0.0,
    max_s: float = float("inf"),
) -> Iterator[tuple[str, Motion]]:
    """Name and motion of each clip of a split, low-passed at 8 Hz, cut to at most max_s seconds."""
    for path in files(split, collections):
        motion = load(path, 8.0, rate_hz)
        if motion.seconds >= min_s:
            yield path.stem, motion.slice(0, int(min(len(motion), max_s * rate_hz)))
