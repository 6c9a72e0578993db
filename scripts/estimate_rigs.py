"""What `mocap/formats/_rigs.py` states of two rigs: `estimate_rigs.py AMC DAZ BANDAI` (folders).

The "Daz-friendly" conversion of CMU's trials: the neutral frame of its joint j is the mean, over trials that
exist as AMC too, of G_j^T R_j S_j. G_j is the joint's rotation in the BVH file, R_j ours as read from AMC,
S_j what turns the T-pose's straight limbs into those of our rest pose. Subjects weigh alike; frames far off
the mean are left out (a limb that flips in one of the two files).

Bandai-Namco's dataset 2: upright people with hanging arms have neck, head and collars as their chest on
average, and feet that stand are level and point as their bones do.

Both are printed as rotation vectors in deg. People of test and validation are not looked at.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from mocap import formats
from mocap import orientation as ori
from mocap.formats import Options, _neutral, bvh
from mocap.formats._bvh_text import parse
from mocap.formats._frames import Neutral, unit
from mocap.formats._source import INDEX, ForeignMotion, Roles, assign
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import Skeleton

SUBJECTS = ("01", "03", "07", "08", "10", "14")  # neither test nor validation
DAZ = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
BANDAI = ("collar", "ankle", "foot")
SIDES = ("left", "right")
# The Daz figure's hand turns about the forearm alone, as this bone of CMU's does.
HANDS = {"lwrist": "left_wrist", "rwrist": "right_wrist"}
STILL = 0.1  # m/s: a foot that stands


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("amc", "daz", "bandai"):
        parser.add_argument(name, type=Path)
    args = parser.parse_args(argv)
    show("Daz", daz(args.amc, args.daz))
    show("Bandai", bandai(sorted(args.bandai.rglob("*.bvh"))))
    return 0


def show(rig: str, F: dict[str, Array]) -> None:
    """The frames as lines of Python."""
    print(rig)
    for name, R in F.items():
        x, y, z = np.degrees(ori.log(R))
        print(f'    "{name}": ({x:.1f}, {y:.1f}, {z:.1f}),')


def source_of(path: Path) -> tuple[ForeignMotion, Roles]:
    """A BVH file's joints in motion and their roles."""
    file = parse(path, path.read_bytes())
    source = bvh._source(path, file, file.rate_hz, Options())
    return source, assign(source)


def robust_mean(R: Array) -> Array:
    """Mean rotation (3,3) of R (N,3,3) without those off by over twice the median (at least 10 deg)."""
    mean = ori.mean(R)
    for _ in range(10):
        off = np.degrees(ori.angle_between(mean, R))
        mean = ori.mean(R[off < max(10.0, 2 * float(np.median(off)))])
    return mean


def lag(a: Array, b: Array) -> int:
    """The frame of a that fits b's first, by rotations (T,K,3,3) at 120 Hz; within 8 frames either way."""

    def apart(k: int) -> float:
        i, j = max(k, 0), max(-k, 0)
        n = min(len(a) - i, len(b) - j)
        return float(ori.angle_between(a[i : i + n : 4], b[j : j + n : 4]).mean())

    return min(range(-8, 9), key=apart)


def daz(amc: Path, folder: Path) -> dict[str, Array]:
    """Neutral frames of the Daz conversion's joints."""
    names = ["neck", "head", *(f"{s}_{n}" for n in DAZ for s in SIDES)]
    joints = [INDEX[n] for n in names]
    body = Skeleton.default()
    own = _neutral.straightening(body.rest_positions, {j: j for j in range(24)})
    S = np.array([own.get(j, np.eye(3)) for j in joints])
    by_subject = defaultdict(list)
    original = {p.stem: p for p in amc.rglob("*.amc") if p.stem[:2] in SUBJECTS}
    for path in sorted(p for p in folder.rglob("*.bvh") if p.stem in original):
        source, roles = source_of(path)
        G = source.forward[0]
        motion = formats.read(original[path.stem], Options(mapping=HANDS)).content
        assert isinstance(motion, Motion)
        # From the file's first frame after its T-pose, on AMC's clock.
        first = round(motion.start_s * motion.rate_hz)
        G = G[first + 3 :]
        R = motion.R_world_joint[:, joints]
        Q = G[:, [roles.joint[j] for j in joints]]
        pelvis = motion.R_world_joint[:, [0]], G[:, [roles.joint[0]]]
        k = lag(*pelvis)
        i, j = max(k, 0), max(-k, 0)
        n = min(len(R) - i, len(Q) - j)
        F = np.swapaxes(Q[j : j + n : 5], -1, -2) @ R[i : i + n : 5] @ S
        by_subject[path.stem[:2]].append(F)
        print(path.stem, "BVH frame = AMC frame +", 3 - k, file=sys.stderr)
    people = [np.concatenate(f) for f in by_subject.values()]
    return {
        name: ori.mean(np.array([robust_mean(F[:, k]) for F in people]))
        for k, name in enumerate(names)
    }


def bandai(paths: Iterable[Path]) -> dict[str, Array]:
    """Neutral frames of Bandai's joints, of every ninth clip of those that are not for validation."""
    names = ["neck", "head", *(f"{s}_{n}" for n in BANDAI for s in SIDES)]
    found: dict[str, list[Array]] = {n: [] for n in names}
    training = [p for i, p in enumerate(paths) if i % 10]
    for path in training[::9]:
        source, roles = source_of(path)
        neutral = _neutral.of_pose(source, roles)
        for name, F in standing_frames(source, roles, neutral, names).items():
            found[name].append(F)
    return {n: robust_mean(np.array(F)) for n, F in found.items()}


def standing_frames(
    source: ForeignMotion, roles: Roles, neutral: Neutral, names: list[str]
) -> dict[str, Array]:
    """What one clip says of the neutral frames, from its upright frames."""
    G, p = source.forward
    unit_m = 0.01
    pelvis = G[:, roles.joint[0]] @ neutral.F[0]
    chest = G[:, roles.spine[-1]] @ neutral.F_spine[-1]
    upright = (pelvis[:, 1, 1] > np.cos(np.radians(15))) & (chest[:, 1, 1] > np.cos(np.radians(15)))
    out = {}
    for name in names:
        j = INDEX[name]
        i = roles.joint[j]
        side = name.partition("_")[0]
        good = upright.copy()
        wanted = chest
        if name.endswith(("ankle", "foot")):
            a = INDEX[f"{side}_ankle"]
            toe, ankle = p[:, roles.target[a]], p[:, roles.joint[a]]
            speed = np.linalg.norm(np.gradient(toe, axis=0), axis=1) * source.rate_hz * unit_m
            rise = np.abs(np.gradient(ankle[:, 1])) * source.rate_hz * unit_m
            good &= (speed < STILL) & (rise < STILL)
            z = (toe - ankle) * (1.0, 0.0, 1.0)
            z = unit(z)
            y = np.broadcast_to((0.0, 1.0, 0.0), z.shape)
            wanted = np.stack([np.cross(y, z), y, z], axis=-1)
        elif name.endswith("collar"):
            s = INDEX[f"{side}_shoulder"]
            arm = unit(p[:, roles.target[s]] - p[:, roles.joint[s]])
            good &= arm[:, 1] < -np.cos(np.radians(30))
        if good.sum() >= 5:
            out[name] = ori.mean(np.swapaxes(G[good, i], -1, -2) @ wanted[good])
    return out


if __name__ == "__main__":
    raise SystemExit(main())
