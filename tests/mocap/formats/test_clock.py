"""Stamps on a grid: jitter and wandering are evened out, losses are found where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap.errors import FormatError
from mocap.formats import _clock
from mocap.words import sentence

HERE = Path("take.csv")


def test_rounded_stamps(rng: np.random.Generator) -> None:
    """Stamps rounded to 10 ms at 60 Hz: the rate is that of the whole, not of the median step."""
    found = _clock.grid(HERE, np.round(np.arange(600) / 60, 2))
    assert found.rate_hz == pytest.approx(60, rel=1e-3)
    assert (found.frames == np.arange(600)).all()
    assert "jitter" in sentence(found.doubts[0])


def test_a_gap_among_jitter() -> None:
    rng = np.random.default_rng(0)
    keep = np.r_[0:50, 57:120]
    t = 3.0 + keep / 100 + rng.uniform(-0.002, 0.002, len(keep))
    found = _clock.grid(HERE, t)
    assert found.rate_hz == pytest.approx(100, rel=1e-2) and (found.frames == keep).all()
    assert any("7 of 120 samples are missing" in sentence(d) for d in found.doubts)


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 1000.0])
@pytest.mark.parametrize("sigma", [0.1, 0.2, 0.25])
def test_strong_jitter_is_no_loss(rng: np.random.Generator, rate_hz: float, sigma: float) -> None:
    """Gaussian jitter up to a quarter of a step at 1 sigma, sorted by arrival: every sample is there."""
    t = np.sort((np.arange(3000) + rng.normal(0, sigma, 3000)) / rate_hz)
    found = _clock.grid(HERE, t)
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    assert (found.frames == np.arange(3000)).all()


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.2])
def test_losses_are_counted_and_placed(rng: np.random.Generator, sigma: float) -> None:
    """Bursts of 1 to 20 lost samples: their number is right, and each is placed within a few samples."""
    n = 4000
    keep = np.ones(n, bool)
    for at in range(100, n - 100, 200):
        keep[at + rng.integers(40) : at + 40 + rng.integers(1, 20)] = False
    k = np.flatnonzero(keep)
    t = (k + rng.normal(0, sigma, len(k))) / 60
    found = _clock.grid(HERE, np.sort(t))
    assert found.frames[-1] == k[-1] - k[0]
    off = np.abs(found.frames - (k - k[0]))
    assert off.max() <= 1 and (off > 0).mean() < 0.01
    assert any(f"{n - len(k) - k[0] - (n - 1 - k[-1])} of" in sentence(d) for d in found.doubts)


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_clock_that_wanders_is_followed(rng: np.random.Generator, jitter: float) -> None:
    """A rate that changes by 500 ppm and comes back: no sample is lost, the wandering is said."""
    k = np.arange(20_000)
    rate = 100 * (1 + 5e-4 * np.sin(2 * np.pi * k / len(k)))
    true = np.cumsum(1 / rate)
    t = np.sort(true + jitter * rng.normal(0, 0.01, len(k)))
    found = _clock.grid(HERE, t)
    assert (found.frames == k).all()
    assert found.rate_hz == pytest.approx((len(k) - 1) / (true[-1] - true[0]), rel=2e-4)
    assert any("the clock wanders by up to" in sentence(d) for d in found.doubts)
    assert np.abs(found.slow_s - true).max() < 0.2 / 100


def test_an_even_clock_says_nothing() -> None:
    found = _clock.grid(HERE, np.arange(500) / 60)
    assert found.rate_hz == pytest.approx(60) and not found.doubts


@pytest.mark.parametrize(
    ("t", "message"),
    [
        ([0.0], "fewer than two samples"),
        ([0.0, 0.01, 0.01], "frame 2, time: 0.01 s after 0.01 s, must rise"),
        ([0.0, 0.01, np.nan], "frame 2, time: is nan"),
        (np.r_[0:50, 50:150:1.6] / 100, "where .* is usual, expected a constant rate"),
        (np.cumsum(np.random.default_rng(1).exponential(1, 900)), "expected a constant rate"),
        (np.r_[np.arange(900) / 60, 15 + np.arange(900) / 50], "expected a constant rate"),
        ([0, 0.01, 0.02, 1e6], "a gap of 1e.06 s"),
    ],
)
def test_what_is_no_clock_is_refused(t: list[float], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        _clock.grid(HERE, np.asarray(t, float))


def test_a_long_recording_with_jitter_and_losses(rng: np.random.Generator) -> None:
    """An hour at 100 Hz, one sample in a hundred lost at random: few losses are missed or made up."""
    k = np.flatnonzero(rng.random(360_000) > 0.01)
    found = _clock.grid(HERE, np.sort((k + rng.normal(0, 0.2, len(k))) / 100))
    lost = k[-1] - k[0] + 1 - len(k)
    assert abs(int(found.frames[-1]) + 1 - len(k) - lost) < 0.03 * lost
    assert found.rate_hz == pytest.approx(100, rel=1e-3)
