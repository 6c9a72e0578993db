"""Motions for other tools: what is written, by the output's suffix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mocap.body import Look
    from mocap.formats._bvh_profiles import Profile, Rest
    from mocap.motion import Motion

# As `mocap.formats._bvh_profiles` and `mocap.body` have them, which need numpy: the parser does without.
PROFILES = ("smpl", "mixamo", "unity", "cmu")
RESTS = ("t", "a")
LOOKS = ("mesh", "capsules", "smpl")


@dataclass(frozen=True)
class Export:
    """What a user may say of it. profile, rest: of `.bvh` (see `mocap.formats.bvh.write_motion`). body: of
    `.glb` (see `mocap.body.skin`)."""

    profile: Profile = "smpl"
    rest: Rest = "t"
    body: Look | None = None


def _bvh(path: Path, motion: Motion, export: Export) -> None:
    from mocap.formats import bvh

    bvh.write_motion(path, motion, export.profile, export.rest)


def _glb(path: Path, motion: Motion, export: Export) -> None:
    from mocap.formats import gltf

    gltf.write_motion(path, motion, export.body)


def _sto(path: Path, motion: Motion, export: Export) -> None:
    from mocap.formats import opensim

    opensim.write_orientations(path, motion)


def _trc(path: Path, motion: Motion, export: Export) -> None:
    from mocap.formats import opensim

    opensim.write_markers(path, motion)


WRITERS: dict[str, Callable[[Path, Motion, Export], None]] = {
    ".bvh": _bvh, ".glb": _glb, ".sto": _sto, ".trc": _trc,
}  # fmt: skip
"""Suffix -> what writes it: whole or not at all."""
SUFFIXES = (".npz", *WRITERS)
"""Of the files that a motion can be written to."""
