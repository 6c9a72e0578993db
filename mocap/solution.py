"""What an offline solve returns, and how it reports on itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mocap.motion import Motion
from mocap.orientation import Array


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved motion.

    cost: half the robust sum of squares per term, in units of sigma^2. residuals: per term the array of
    whitened residuals (in sigmas; layout in the term's docstring). sigmas: per term the root mean square
    of its whitened residual, 1 where the model fits as its sigma says. iterations and seconds count the
    solving alone (not reading files). Where the recording was solved in windows, every frame counts once, in
    the window that keeps it. status: how it ended, in words; converged says the same for
    programs. std_rad: (T,24,3) posterior standard deviation of the joint angles in rad. gradient_norm:
    largest |gradient| entry at the end, each over the root of its own entry in the Gauss-Newton matrix
    (sigmas). sensors: self-calibrated mounting, heading and bias with their standard deviations, per
    sensor name. report: further figures: windows, seam_deg between them, samples_beyond_150_deg per sensor.
    """

    motion: Motion
    cost: dict[str, float]
    residuals: dict[str, Array]
    sigmas: dict[str, float]
    iterations: int
    seconds: float
    status: str
    converged: bool
    std_rad: Array | None = None
    gradient_norm: float = float("nan")
    sensors: dict[str, dict[str, Any]] | None = None
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def total_cost(self) -> float:
        """Sum over terms."""
        return float(sum(self.cost.values()))
