"""Every number of the tracker, with its unit."""

from __future__ import annotations

from dataclasses import dataclass, field

from hybrid.motion_filter import FilterNoise
from mocap.errors import PoserError

POSITIVE = (
    "orientation_sigma_deg",
    "network_floor_deg",
    "step_sigma_deg",
    "step_memory_s",
    "position_gate_sigma",
    "position_robust_sigma",
    "restart_after_s",
    "rate_limit_deg_s",
    "gap_s",
)


@dataclass(frozen=True)
class TrackerSettings:
    """Sigmas are one standard deviation per axis.

    orientation_sigma_deg: measured bone orientation (mounting, heading, soft tissue).
    network_sigma_deg: of a joint for which the network states none. network_scale: factor on what the
    network states. Each is one number, or 24 of them.
    Where poses carry the covariance of the network's errors, that is used instead of all three.
    network_floor_deg, network_ceiling_deg: what a stated sigma is kept within. network_memory_s: of the
    filter that smooths the network's poses (`hybrid.refinement.smoothed`); 0 leaves them. step_sigma_deg:
    change of the refinement (network's joint to ours) in one second, growing with the root of time; it
    keeps its momentum over step_memory_s.
    positions: whether the predicted sensor positions count. With the shipped DIP they make validation
    errors 3 % larger (sip_deg): the network has read the same accelerations already.
    position_gate_sigma: predicted positions further off are refused; after restart_after_s of refusals
    in a row the sensor's filter starts anew. position_robust_sigma: beyond it the cost is linear.
    rate_limit_deg_s: of any component of a joint's rotation vector. gap_s: a longer silence of the clock
    restarts the filters. spine: whether the trunk's joints move too. translation: whether the root's path
    is replaced by that of the contact filter.
    """

    orientation_sigma_deg: float = 8.0
    network_sigma_deg: float | tuple[float, ...] = 12.0
    network_scale: float | tuple[float, ...] = 1.0
    network_floor_deg: float = 1.0
    network_ceiling_deg: float = 60.0
    network_memory_s: float = 0.033
    step_sigma_deg: float = 20.0
    step_memory_s: float = 0.05
    positions: bool = False
    position_gate_sigma: float = 4.0
    position_robust_sigma: float = 2.0
    restart_after_s: float = 0.25
    rate_limit_deg_s: float = 1500.0
    gap_s: float = 0.25
    spine: bool = True
    translation: bool = True
    filter_noise: FilterNoise = field(default_factory=FilterNoise)

    def __post_init__(self) -> None:
        if not 0 <= self.network_memory_s < float("inf"):
            raise PoserError("TrackerSettings: network_memory_s must be zero or more")
        for name in POSITIVE:
            value = getattr(self, name)
            if not 0 < value < float("inf"):
                raise PoserError(f"TrackerSettings: {name} must be positive, got {value!r}")
        if not self.network_floor_deg <= self.network_ceiling_deg <= 180:
            raise PoserError("TrackerSettings: network_ceiling_deg must lie between floor and 180")
        for name in ("network_sigma_deg", "network_scale"):
            value = getattr(self, name)
            values = value if isinstance(value, tuple) else (value,)
            if isinstance(value, tuple) and len(value) != 24:
                raise PoserError(f"TrackerSettings: {name} needs 24 values, got {len(value)}")
            if not all(0 < v < float("inf") for v in values):
                raise PoserError(f"TrackerSettings: {name} must be positive")
