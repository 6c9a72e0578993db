"""Make sip/prior.npz from the training motion: `python scripts/make_prior.py`.

CMU training clips only (see `mocap.dataset`), so that the file is free of the non-commercial licence of the
other collection. The data used was obtained from mocap.cs.cmu.edu, created with funding from NSF
EIA-0196217. Poses are taken at 10 Hz, each clip weighted by the square root of its length, and mirrored.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mocap import dataset
from mocap import orientation as ori
from mocap.skeleton import JOINTS

RATE_HZ = 60.0
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


def angles(motion: dataset.Motion) -> np.ndarray:
    """Body angles (T,69) in rad, principal chart."""
    return ori.log(motion.R_parent_joint[:, 1:]).reshape(len(motion), 69)


def plausible(a: np.ndarray) -> np.ndarray:
    """The poses without a head or an ankle turned by more than 90 degrees: faults of the source."""
    turn = np.linalg.norm(a.reshape(-1, 23, 3)[:, [6, 7, 14]], axis=-1)
    return a[(turn < np.pi / 2).all(axis=1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("sip/prior.npz"))
    output = parser.parse_args().output
    poses, weights, rough = [], [], []
    for _, motion in dataset.clips("train", ("cmu",), RATE_HZ, min_s=1.0):
        for m in (motion, motion.mirrored()):
            a = angles(m)
            poses.append(plausible(a[::STEP]))
            if not len(poses[-1]):
                poses.pop()
                continue
            weights.append(np.full(len(poses[-1]), 1 / np.sqrt(len(poses[-1]))))
            rough.append(np.mean(np.diff(a, 2, axis=0) ** 2, axis=0) * RATE_HZ**4)
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
        f"{output}: {len(x)} poses, {still.sum()} angles never move, roughness scale {scale:.1f} rad/s^2"
    )


if __name__ == "__main__":
    main()
