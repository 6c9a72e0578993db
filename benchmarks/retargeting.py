"""The same motion from several files, and how people stand: `make bench-retargeting`.

Pairs: CMU's trials that exist as AMC and as Daz or MotionBuilder BVH. The angle between a joint's rotations
relative to the pelvis, mean over the frames in which neither file has a fault, then over trials. The Daz
profile (`mocap/formats/_rigs.py`) was estimated on some subjects; the others stand apart.

Standing: trunk and legs upright within 15 and 20 deg. The angle of the mean rotation of neck, head and
collars relative to the chest, and how far their y axes lean in the world.

Mean pose: of the training set, each clip alike, relative to the parent joint.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from common import row
from numpy.typing import NDArray

from mocap import dataset
from mocap import orientation as ori
from mocap.dataset import Clip
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS

ESTIMATED_ON = ("01", "03", "07", "08", "10", "14")
LONGEST_LAG = 8
FRAMES = 2400  # of a trial at most
LEFT_OUT = ("wrist", "hand")  # of the mean over joints; of Daz files also the toes, which they lack
OTHERS: tuple[dataset.ClipSource, ...] = ("cmu-motionbuilder-bvh", "cmu-daz-bvh")
STANDING = ("neck", "head", "left_collar", "right_collar")

Pair = tuple[Clip, Clip]


def pairs(other: dataset.ClipSource) -> list[Pair]:
    """Trials that exist as AMC and in the other archive."""
    cmu = dataset.every(("cmu",))
    original = {c.name: c for c in cmu if c.source == "cmu-amc"}
    return [(original[c.name], c) for c in cmu if c.source == other and c.name in original]


def rotations(clip: Clip) -> tuple[Array, NDArray[np.bool_], int]:
    """R_world_joint (T,24,3,3), which frames hold no fault, and the first frame on the take's clock."""
    found = clip.read()
    m = found.motion.slice(0, FRAMES)
    return m.R_world_joint, found.trusted[:FRAMES], round(m.start_s * m.rate_hz)


def relative(R: Array) -> Array:
    return np.asarray(np.swapaxes(R[:, :1], -1, -2) @ R)


def overlap(lag: int, a: int, b: int) -> tuple[slice, slice]:
    """The frames of two files of a and b frames where one begins `lag` frames into the other."""
    i, j = max(lag, 0), max(-lag, 0)
    n = max(min(a - i, b - j), 0)
    return slice(i, i + n), slice(j, j + n)


def compare(pair: Pair) -> tuple[str, int, Array, float] | None:
    """Trial, lag, mean angles (24,) deg, and the share of frames used; None where nothing overlaps."""
    (a, ok_a, start_a), (b, ok_b, start_b) = (rotations(c) for c in pair)
    a, b = relative(a), relative(b)

    def apart(lag: int) -> float:
        i, j = overlap(start_b - start_a + lag, len(a), len(b))
        step = max(1, (i.stop - i.start) // 150)
        angles = ori.angle_between(a[i][::step], b[j][::step])[:, LIMBS]
        return float(angles.mean()) if i.stop > i.start else np.inf

    lag = min(range(-LONGEST_LAG, LONGEST_LAG + 1), key=apart)
    i, j = overlap(start_b - start_a + lag, len(a), len(b))
    good = ok_a[i] & ok_b[j]
    if not good.any():
        return None
    angles = np.degrees(ori.angle_between(a[i][good], b[j][good])).mean(axis=0)
    return pair[0].name, lag, angles, float(good.mean())


LIMBS = [JOINTS.index(f"{s}_{n}") for s in ("left", "right")
         for n in ("knee", "ankle", "shoulder", "elbow")]  # fmt: skip


def table(found: dict[str, tuple[int, Array, float]], left_out: Sequence[str]) -> Iterator[str]:
    """Lines: each joint's mean and worst trial, and the mean over joints but `left_out`."""
    groups = {
        "all": list(found.values()),
        "estimated on": [r for n, r in found.items() if dataset.subject_of(n) in ESTIMATED_ON],
        "held out": [r for n, r in found.items() if dataset.subject_of(n) not in ESTIMATED_ON],
    }
    groups = {g: rows for g, rows in groups.items() if rows}
    widths = (16, *[14] * (len(groups) + 1))
    yield row((f"{'joint, deg':16s}", *groups, "worst trial"), widths)
    means = {g: np.mean([r[1] for r in rows], axis=0) for g, rows in groups.items()}
    worst = np.max([r[1] for r in groups["all"]], axis=0)
    for j, name in enumerate(JOINTS[1:], 1):
        cells = [f"{m[j]:.2f}" for m in means.values()]
        yield row((f"{name:16s}", *cells, f"{worst[j]:.1f}"), widths)
    counted = [j for j, n in enumerate(JOINTS) if j and not n.endswith(tuple(left_out))]
    yield (
        row((f"{'mean':16s}", *(f"{m[counted].mean():.2f}" for m in means.values())), widths)
        + f"   without {', '.join(left_out)}"
    )
    yield row((f"{'largest':16s}", *(f"{m[counted].max():.2f}" for m in means.values())), widths)
    used = np.mean([r[2] for r in groups["all"]])
    yield f"{len(found)} trials; {100 * used:.1f} % of the frames hold no fault in either file"


def show_pairs(pool: ProcessPoolExecutor) -> None:
    for other in OTHERS:
        done = [r for r in pool.map(compare, pairs(other)) if r is not None]
        if not done:
            continue
        print(f"\nAMC against {other}")
        lags: dict[int, int] = defaultdict(int)
        for _, lag, *_ in done:
            lags[lag] += 1
        left_out = (*LEFT_OUT, "foot") if other == "cmu-daz-bvh" else LEFT_OUT
        print("\n".join(table({r[0]: r[1:] for r in done}, left_out)))
        print("frames by which one begins later than stated:", dict(sorted(lags.items())))


def standing(clip: Clip) -> Array | None:
    """R_world_joint (T,24,3,3) of the upright frames of a clip; None where they are fewer than 20."""
    R, trusted, _ = rotations(clip)
    up = R[..., 1, 1]
    good = trusted & (up[:, [0, 9]] > np.cos(np.radians(15))).all(axis=1)
    good &= (up[:, [1, 2, 4, 5]] > np.cos(np.radians(20))).all(axis=1)
    return R[good][::10] if good.sum() >= 20 else None


def show_standing(pool: ProcessPoolExecutor, clips: list[Clip]) -> None:
    print("\nUpright people of the training set, deg")
    widths = (24, *[14] * len(STANDING))
    by_source: dict[str, list[Array]] = defaultdict(list)
    for clip, R in zip(clips, pool.map(standing, clips, chunksize=4), strict=True):
        if R is not None:
            by_source[clip.source].append(R)
    joints = [JOINTS.index(n) for n in STANDING]
    for source, found in by_source.items():
        print(f"{source}: {len(found)} clips")
        print(row((f"{'':24s}", *STANDING), widths))
        for name, above in (("chest", [9] * len(joints)), ("parent", [PARENTS[j] for j in joints])):
            turn = [ori.mean(np.swapaxes(R[:, above], -1, -2) @ R[:, joints]) for R in found]
            mean = ori.mean(np.array(turn))
            about_x = np.degrees(ori.log(mean))[:, 0]
            for said, v in (
                (f"mean, to the {name}", np.degrees(ori.angle(mean))), ("  of it about x", about_x),
            ):  # fmt: skip
                print(row((f"{said:24s}", *(f"{x:.1f}" for x in v)), widths))
        lean = [np.degrees(np.arccos(np.clip(R[:, joints, 1, 1], -1, 1))).mean(0) for R in found]
        cells = (f"{v:.1f}" for v in np.mean(lean, axis=0))
        print(row((f"{'lean in the world':24s}", *cells), widths))


def local(clip: Clip) -> Array | None:
    """R_parent_joint (T,24,3,3) of the frames of a clip without fault, five a second."""
    found = clip.read()
    step = max(1, round(found.motion.rate_hz / 5))
    good = found.motion.R_parent_joint[found.trusted][::step]
    return good if len(good) else None


def show_mean_pose(pool: ProcessPoolExecutor, clips: list[Clip]) -> None:
    means = [ori.mean(R) for R in pool.map(local, clips, chunksize=4)
             if R is not None]  # fmt: skip
    mean = np.degrees(ori.log(ori.mean(np.stack(means))))
    print(f"\nMean pose of the training set ({len(means)} clips), relative to the parent, deg")
    for j, name in enumerate(JOINTS):
        if PARENTS[j] >= 0:
            x, y, z = mean[j]
            print(f"{name:16s}{x:8.1f}{y:8.1f}{z:8.1f}   angle {np.linalg.norm(mean[j]):6.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--every", type=int, default=4, help="of the training clips every so many")
    parser.add_argument("--collections", default="cmu,bandai", help="of the training clips")
    parser.add_argument("--only", default="pairs,standing,mean")
    args = parser.parse_args()
    training = dataset.select("train", args.collections.split(","))[:: args.every]
    with ProcessPoolExecutor(args.workers) as pool:
        if "pairs" in args.only:
            show_pairs(pool)
        if "standing" in args.only:
            show_standing(pool, training)
        if "mean" in args.only:
            show_mean_pose(pool, training)


if __name__ == "__main__":
    main()
