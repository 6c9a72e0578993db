"""Standard deviations against closed forms: an arm near its rest pose is a linear-Gaussian problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from sip import Settings, solve
from tests.sip.test_solve import static

ARM = ("pelvis", "left_upper_arm", "left_forearm", "left_hand")
CHAIN = (3, 6, 9, 13, 16, 18, 20)  # body joints above the hand's sensor
WORN = (4, 5, 6)  # places in CHAIN: upper arm, elbow, wrist


def arm(settings: Settings, frames: int = 1):
    """Standard deviations (T,24,3) where every bone was measured in its rest pose: all Jacobians are ones."""
    recording = static(ARM, np.broadcast_to(np.eye(3), (4, 3, 3)), frames)
    return solve(recording, settings=replace(settings, uncertainty=True)).std_rad


def design(sigma: float) -> np.ndarray:
    """Rows: sensors on pelvis, upper arm, forearm, hand; columns: root, then CHAIN; over sigma."""
    A = np.zeros((4, 1 + len(CHAIN)))
    A[:, 0] = 1
    for row, last in enumerate(WORN, start=1):
        A[row, 1 : 2 + last] = 1
    return A / sigma


@pytest.fixture
def settings(wide) -> Settings:
    return Settings(
        prior=wide, terms="sop", solver="banded", smooth_order=0, sigma_limits=0.0, prior_weight=0.5
    )


def test_an_arm_in_one_frame(settings: Settings) -> None:
    """Posterior covariance (A^T A + P)^-1; P is the prior's precision with its weight squared."""
    angle_variance = np.deg2rad(20.0) ** 2 + settings.prior_floor**2
    precision = design(settings.sigma_orientation).T @ design(settings.sigma_orientation)
    precision[1:, 1:] += np.eye(len(CHAIN)) * settings.prior_weight**2 / angle_variance
    expected = np.sqrt(np.diag(np.linalg.inv(precision)))
    std = arm(settings)
    assert std is not None
    for joint, value in zip((0, *CHAIN), expected, strict=True):
        assert std[0, joint] == pytest.approx(np.full(3, value), rel=1e-4)
    # Elbow and wrist lie between two sensors, each with its error, and the prior helps little.
    between = np.sqrt(2) * settings.sigma_orientation
    assert 0.9 * between < std[0, 20, 0] < between
    # A joint above no sensor has what the prior says of it.
    assert std[0, 1] == pytest.approx(np.full(3, np.sqrt(angle_variance)), rel=1e-9)


def test_an_arm_over_time(settings: Settings) -> None:
    """With smoothness, frames inform each other: the dense inverse over all of them."""
    frames, sigma = 6, 30.0
    smooth = replace(settings, smooth_order=2, smooth_angle=sigma, smooth_root=sigma)
    std = arm(smooth, frames)
    assert std is not None
    angle_variance = np.deg2rad(20.0) ** 2 + settings.prior_floor**2
    A, m = design(settings.sigma_orientation), 1 + len(CHAIN)
    prior = np.diag(np.r_[0.0, np.full(len(CHAIN), settings.prior_weight**2 / angle_variance)])
    D = np.diff(np.eye(frames), 2, axis=0) * 60.0**2 / sigma
    precision = np.kron(np.eye(frames), A.T @ A + prior) + np.kron(D.T @ D, np.eye(m))
    expected = np.sqrt(np.diag(np.linalg.inv(precision))).reshape(frames, m)
    for t in range(frames):
        for i, joint in enumerate((0, *CHAIN)):
            assert std[t, joint] == pytest.approx(np.full(3, expected[t, i]), rel=1e-3)
    assert expected[0, 0] > expected[3, 0]  # the ends know less


def test_deviations_are_those_of_repeated_measurements(
    settings: Settings, rng: np.random.Generator
) -> None:
    """Monte Carlo: without a prior the scatter of the answers is the deviation reported."""
    blunt = replace(settings, prior_weight=1e-3, sigma_orientation=np.deg2rad(2.0))
    std = arm(blunt)
    assert std is not None
    noisy = ori.exp(rng.normal(size=(400, 4, 3)) * blunt.sigma_orientation)
    recording = replace(static(ARM, np.broadcast_to(np.eye(3), (4, 3, 3)), 400), R_world_bone=noisy)
    solved = ori.log(solve(recording, settings=blunt).motion.R_parent_joint)
    for joint in (0, 18, 20):
        # 1200 draws of a standard deviation: 2 % of it, three times over.
        assert solved[:, joint].std() == pytest.approx(std[0, joint].mean(), rel=0.07)
