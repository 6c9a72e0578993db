"""A short smooth motion, and problems over it."""

from __future__ import annotations

import numpy as np
import pytest

from mocap import Motion, Recording, Skeleton, sensors, synthesis
from mocap import orientation as ori
from sip import Settings
from sip.prior import Prior


def wavy(frames: int = 40, rate_hz: float = 60.0, seed: int = 0, size: float = 0.3) -> Motion:
    """Every joint swings on its own sines; the root turns and travels."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / rate_hz
    amplitude = rng.normal(size=(24, 3)) * size
    phase, speed = rng.uniform(0, 6, (24, 3)), rng.uniform(0.3, 1.2, (24, 3))
    angles = amplitude * np.sin(2 * np.pi * speed * t + phase)
    s = t[:, 0, 0]
    path = np.stack([0.5 * s, 0.05 * np.sin(5 * s), np.sin(s)], axis=1)
    return Motion(rate_hz, ori.exp(angles), path, Skeleton.default())


@pytest.fixture(scope="session")
def motion() -> Motion:
    return wavy()


@pytest.fixture(scope="session")
def recording(motion: Motion) -> Recording:
    return synthesis.recording(motion, sensors.SIX)


@pytest.fixture
def wide() -> Prior:
    """A prior that allows the test motion: zero mean, 20 degrees, limits at 170 degrees."""
    sigma = np.deg2rad(20.0)
    limit = np.full(69, np.deg2rad(170.0))
    return Prior(np.zeros(69), np.eye(69) * sigma**2, -limit, limit, np.ones(69), np.zeros((1, 69)))


@pytest.fixture
def bare(wide: Prior) -> Settings:
    """Measurements alone: no prior, limits, smoothness or gauge."""
    return Settings(
        prior=wide, prior_weight=0.0, sigma_limits=0.0, smooth_order=0, sigma_gauge=np.inf
    )
