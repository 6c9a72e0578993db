"""Deviations learnt from errors: known ones come back, and they steer the tracker."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid import TrackerSettings, scale
from mocap import PoserError
from mocap import orientation as ori
from mocap.errors import ShapeError


def test_known_deviations_come_back(rng: np.random.Generator) -> None:
    sigma = np.deg2rad(np.linspace(2, 20, 24))[:, None]
    stated = np.full((4000, 24, 3), np.deg2rad(10.0))
    R_true = ori.exp(rng.normal(size=(4000, 24, 3)))
    e = rng.normal(size=(4000, 24, 3)) * sigma
    found = scale.errors(R_true @ ori.exp(-e), R_true)
    assert np.allclose(found, e, atol=1e-9)
    degrees = np.array(scale.network_sigma_deg(found))
    assert np.allclose(degrees, np.linspace(2, 20, 24), rtol=0.03)
    factor = np.array(scale.network_scale(found, stated))
    assert np.allclose(factor, degrees / 10, rtol=1e-9)
    assert np.allclose(np.mean((found / (stated * factor[:, None])) ** 2, axis=(0, 2)), 1)


def test_a_joint_without_error_keeps_usable_numbers() -> None:
    zero = np.zeros((5, 24, 3))
    assert scale.network_sigma_deg(zero) == (scale.SMALLEST_DEG,) * 24
    assert scale.network_scale(zero, zero + 0.1) == (1.0,) * 24
    TrackerSettings(network_sigma_deg=scale.network_sigma_deg(zero), network_scale=(1.0,) * 24)


def test_shapes_are_checked() -> None:
    with pytest.raises(ShapeError, match="24,3,3"):
        scale.errors(np.zeros((2, 23, 3, 3)), np.zeros((2, 23, 3, 3)))
    with pytest.raises(PoserError, match="24 values"):
        TrackerSettings(network_sigma_deg=(1.0, 2.0))
