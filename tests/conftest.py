"""Fixtures that the whole suite shares."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator: tests draw from it, so a failure repeats."""
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder `shared/` beside the repository, or a skip where it is absent.

    The environment variable POSER_SHARED names another place.
    """
    here = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("POSER_SHARED", here.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip("the data folder shared/ is not beside the repository (POSER_SHARED)")
    return folder
