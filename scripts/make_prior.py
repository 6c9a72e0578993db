"""Make sip/prior.npz from the training motion: `python scripts/make_prior.py`.

CMU training clips only (see `mocap.dataset`), so that the file is free of the non-commercial licence of the
other collection. The data used was obtained from mocap.cs.cmu.edu, created with funding from NSF
EIA-0196217. Poses are taken at 10 Hz, each clip weighted by the square root of its length, and mirrored;
frames with a fault of the capture (`mocap.faults`) are left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from learned.training import corpus
from mocap import Motion, dataset
from mocap import orientation as ori
from mocap.skeleton import JOINTS, Skeleton

RATE_HZ = corpus.RATE_HZ
STEP = 6  # frames between poses
BANK = 2000
STILL_RAD = np.deg2rad(0.5)  # an angle that varies less than this never moves
FLOOR = 0.1  # smallest relative roughness
MARGIN_RAD = np.deg2rad(10.0)
# What the rigs of the training data cannot show, because these joints do not move there: toes bent up 70 and
# down 40 degrees (clinical range of the first metatarsophalangeal joint, AAOS 1965), shoulders lifted by 30
# with raised arms (elevation of the clavicle, Inman 1944). deg: (joint, axis): (lower, upper).
ANATOMY = {
    ("left_foot", 0): (-70.0, 40.0),
    ("right_foot", 0): (-70.0, 40.0),
    ("left_collar", 2): (0.0, 30.0),
    ("right_collar", 2): (-30.0, 0.0),
}


def angles(motion: Motion) -> np.ndarray:
    """Body angles (T,69) in rad, principal chart."""
    return ori.log(motion.R_parent_joint[:, 1:]).reshape(len(motion), 69)


def motions() -> Iterator[Motion]:
    """The training clips of a second or more, low-passed, from the cache that training reads them into."""
    found = corpus.read(
        dataset.select("train", ("cmu",)),
        lambda i, n: print(f"\rreading {i} of {n} motions", end="\n" * (i == n), file=sys.stderr),
    )
    for start, length in zip(found.start, found.length, strict=True):
        if length >= RATE_HZ:
            at = slice(start, start + length)
            R, p = ori.from_quat(found.q[at].astype(float)), found.p[at].astype(float)
            yield Motion(RATE_HZ, R, p, Skeleton.default(), trusted=found.sound[at])


def steady(trusted: np.ndarray) -> np.ndarray:
    """(T-2,): whether a frame and those beside it are trusted."""
    return trusted[:-2] & trusted[1:-1] & trusted[2:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("sip/prior.npz"))
    output = parser.parse_args().output
    poses, weights, rough = [], [], []
    clips = 0
    for motion in motions():
        assert motion.trusted is not None
        if not steady(motion.trusted).any() or not motion.trusted[::STEP].any():
            continue
        clips += 1
        for m in (motion, motion.mirrored()):
            a = angles(m)
            poses.append(a[::STEP][motion.trusted[::STEP]])
            weights.append(np.full(len(poses[-1]), 1 / np.sqrt(len(poses[-1]))))
            bends = np.diff(a, 2, axis=0)[steady(motion.trusted)]
            rough.append(np.mean(bends**2, axis=0) * RATE_HZ**4)
    x, w = np.concatenate(poses), np.concatenate(weights)
    w /= w.sum()
    mean = w @ x
    covariance = (x - mean).T @ ((x - mean) * w[:, None])
    # An angle that never moves has the constant of the rig that the data came on (its collars hang 34
    # degrees below ours), which is no property of people: the mean lies half-way to our rest pose, and
    # either end is one sigma away.
    still = np.sqrt(np.diag(covariance)) < STILL_RAD
    mean[still] /= 2
    covariance[still] = 0
    covariance[:, still] = 0
    covariance[still, still] = mean[still] ** 2
    lower, upper = (np.quantile(x, q, axis=0) for q in (0.0005, 0.9995))
    # SMPL's rest pose is within everybody's limits; a rig's hands may never come near it.
    lower, upper = np.minimum(lower, 0), np.maximum(upper, 0)
    for (joint, axis), (low, high) in ANATOMY.items():
        k = 3 * (JOINTS.index(joint) - 1) + axis
        lower[k], upper[k] = min(lower[k], np.deg2rad(low)), max(upper[k], np.deg2rad(high))
    roughness = np.sqrt(np.median(rough, axis=0))
    scale = roughness[~still].mean()
    # What never moves here may move a little on others.
    roughness = np.maximum(roughness, FLOOR * scale)
    rng = np.random.default_rng(0)
    bank = x[rng.choice(len(x), BANK, replace=False, p=w)]
    np.savez_compressed(
        output,
        mean=mean,
        covariance=covariance,
        lower=lower - MARGIN_RAD,
        upper=upper + MARGIN_RAD,
        roughness=roughness / scale,
        poses=bank.astype(np.float16),
    )
    print(
        f"{output}: {len(x)} poses of {clips} clips, {still.sum()} angles never move, roughness scale "
        f"{scale:.1f} rad/s^2"
    )
    print("mean pose, deg, and its deviation:")
    spread = np.sqrt(np.diag(covariance))
    for j, name in enumerate(JOINTS[1:]):
        k = slice(3 * j, 3 * j + 3)
        print(f"{name:>15} {np.rad2deg(mean[k]).round(1)} +- {np.rad2deg(spread[k]).round(1)}")


if __name__ == "__main__":
    main()
