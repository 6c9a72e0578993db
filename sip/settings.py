"""Every number of the optimizer, with its unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from mocap import checked
from mocap.errors import SolveError
from mocap.motion import Motion
from sip.prior import Prior, shipped

if TYPE_CHECKING:
    from mocap.recording import Recording
    from sip.sensor_kinematics import SensorKinematics
    from sip.terms.base import Term

DEG = np.pi / 180
POSITIVE = ("sigma_orientation", "sigma_acceleration", "sigma_gauge", "robust_delta")
# Where infinity leaves something out, or never forgets it.
UNBOUNDED = (
    "sigma_acceleration", "sigma_contact", "sigma_gauge", "sigma_limits", "robust_delta", "network_memory_s",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What to minimise and how.

    terms: "sip", or "sop" without accelerations. solver: "ipopt" (banded start, IPOPT finish),
    "ipopt-cold" (IPOPT alone), "banded" (no finish). start: "prior" or a motion.
    Sigmas are one standard deviation of the measurement in SI units. smooth_*: sigma of the difference of
    order smooth_order (2: rad/s^2 and m/s^2; 3: per s^3; 0: none). robust_delta: sigmas at which the
    acceleration's cost turns from quadratic to linear.
    self_calibration: mounting, heading and acceleration bias of each sensor are unknowns with the sigmas
    below (per window, in a long recording). prior_weight_calibrating then replaces prior_weight: frames of
    one clip share their deviation from the mean pose, and a prior that counts them as independent would
    explain it by mounting.
    network_weight, network_memory_s, network_doubt: how a network's poses count where they are given
    (`sip.belief`); prior_weight_listening then replaces prior_weight and prior_weight_calibrating.
    sigma_contact: m/s, of a point of the sole that stands (infinite: no contact); contact_passes: how often
    what stands is judged anew by the poses found; contact_height (m), contact_speed (m/s): see `sip.soles`.
    max_iterations: of the banded solver, IPOPT has its own. Recordings longer than `window` frames are
    solved in windows that overlap by `overlap` frames at up to 60 Hz, and by the same time above that, as
    far as the window allows.
    correlation_s: neighbouring frames err alike, so rate * correlation_s of them count as one piece of
    evidence on a constant (the constants' sigmas shrink by the root of that number). It is raised until
    the constants' spread over sensors is no larger than their sigmas.
    extra: terms of one's own. Each entry is called with the recording of a window (or of the coarse start:
    fewer frames, its own rate and start_s) and its kinematics, and gives a `sip.terms.base.Term`;
    `examples/own_term.py`.
    """

    terms: Literal["sop", "sip"] = "sip"
    solver: Literal["ipopt", "ipopt-cold", "banded"] = "ipopt"
    start: Literal["prior"] | Motion = "prior"
    prior: Prior = field(default_factory=shipped)
    sigma_orientation: float = 3.5 * DEG
    sigma_acceleration: float = 1.0
    robust_delta: float = 4.0
    prior_weight: float = 0.3
    prior_floor: float = 3 * DEG
    sigma_limits: float = 5 * DEG
    smooth_order: Literal[0, 2, 3] = 2
    smooth_angle: float = 75.0
    smooth_root: float = 75.0
    smooth_position: float = 7.5
    sigma_gauge: float = 100.0
    self_calibration: bool = False
    prior_weight_calibrating: float = 0.1
    sigma_mounting: float = 4 * DEG
    sigma_heading: float = 3 * DEG
    sigma_bias: float = 0.1
    correlation_s: float = 0.15
    network_weight: float = 0.1
    network_memory_s: float = 0.5
    network_doubt: float = 1.0
    prior_weight_listening: float = 0.3
    sigma_contact: float = 0.3
    contact_passes: int = 1
    contact_height: float = 0.04
    contact_speed: float = 0.2
    max_iterations: int = 60
    tolerance: float = 3e-4
    coarse_hz: float = 15.0
    window: int = 1200
    overlap: int = 90
    uncertainty: bool = False
    extra: tuple[Callable[[Recording, SensorKinematics], Term], ...] = ()

    def static_weight(self, listening: bool) -> float:
        """Weight of the static pose prior. listening: whether a network's poses are given."""
        if listening:
            return self.prior_weight_listening
        return self.prior_weight_calibrating if self.self_calibration else self.prior_weight

    def __post_init__(self) -> None:
        checked.settings(self, positive=POSITIVE, infinite=UNBOUNDED, error=SolveError)
        if not isinstance(self.start, Motion) and self.start != "prior":
            raise SolveError(f'Settings: start must be "prior" or a Motion, got {self.start!r:.60}')
        checked.instance(self.prior, Prior, "Settings: prior", SolveError)
        for name in ("terms", "solver"):
            allowed = {"terms": ("sop", "sip"), "solver": ("ipopt", "ipopt-cold", "banded")}[name]
            if getattr(self, name) not in allowed:
                raise SolveError(f"{name} must be one of {', '.join(allowed)}")
        if self.overlap < 0 or self.window < max(8, 2 * self.overlap):
            raise SolveError(
                f"window must be at least 8 frames and twice the overlap, got {self.window} and "
                f"{self.overlap}"
            )
