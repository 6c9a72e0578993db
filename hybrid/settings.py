"""Every number of the tracker, with its unit."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any

from hybrid.motion_filter import FilterNoise
from mocap import checked
from mocap.errors import PoserError
from mocap.estimator import Estimator, tracker_hints
from sip import Settings

# Above zero; the other sizes may be zero.
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
    "horizon_memory_s",
    "valley_s",
    "shown_memory_s",
    "deviations_s",
    "steps",
)


@cache
def window_cost() -> Settings:
    """SIP's with the sensors' constants estimated."""
    return Settings(self_calibration=True)


@dataclass(frozen=True)
class TrackerSettings:
    """Sigmas are one standard deviation per axis. Where poses carry the covariance of the network's errors,
    that is used instead of network_sigma_deg, network_scale and network_ceiling_deg.

    orientation_sigma_deg: of a measured bone orientation (mounting, heading, soft tissue).
    network_sigma_deg: of a joint for which the network states none; one number or 24.
    network_scale: factor on what the network states; one number or 24.
    network_floor_deg: least sigma that is believed.
    network_ceiling_deg: greatest sigma that is used.
    network_memory_s: of the filter that smooths the network's poses (`hybrid.refinement.smoothed`); 0: none.
    step_sigma_deg: change of the refinement (network's joint to ours) in one second, growing as the
    root of time.
    step_memory_s: how long that change keeps its momentum.
    positions: whether the predicted sensor positions count. With the shipped DIP they make validation errors
    3 % larger (sip_deg): the network has read the same accelerations already.
    position_gate_sigma: predicted positions further off are refused.
    position_robust_sigma: beyond it the cost of a predicted position is linear.
    restart_after_s: of refusals in a row, after which a sensor's filter starts anew.
    rate_limit_deg_s: of any component of a joint's rotation vector.
    gap_s: a longer silence of the clock restarts the filters.
    spine: whether the trunk's joints move too.
    translation: whether the root's path is replaced by that of the contact filter.
    filter_noise: of the sensors' motion filters.

    The moving horizon:
    horizon_s: length of the window; 0: none, each pose is the single frame's QP.
    lag: frames that the poses are behind the newest sample. None: the network's look-ahead, as always without
    a window.
    steps: Gauss-Newton steps a frame at most.
    budget_s: time of a frame, network included: under it further steps are taken, over it the window gets
    shorter. None: no clock is read, so that the same samples give the same poses.
    horizon_memory_s: in this time what has left the window counts less by 1/e.
    valley_s: how often a window that explains its frames badly is compared with one in the network's poses
    (`hybrid.valley`; infinite: never).
    shown_memory_s: in which what successive windows disagree about dies away (`sip.emission`).
    deviations_s: how often the poses' deviations are computed anew (infinite: never, and none is stated).
    cost: of the window (`sip.Settings`), its self_calibration included.
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
    horizon_s: float = 0.4
    lag: int | None = None
    steps: int = 1
    budget_s: float | None = None
    horizon_memory_s: float = 0.8
    valley_s: float = 0.25
    shown_memory_s: float = 0.03
    deviations_s: float = 0.1
    cost: Settings = field(default_factory=window_cost)

    @classmethod
    def around(cls, network: Estimator, **changes: Any) -> TrackerSettings:
        """The defaults around this network (`mocap.estimator.tracker_hints`), with these changes.

        Raises PoserError for a hint or a change that is no setting.
        """
        stated = {**tracker_hints(network), **changes}
        if odd := sorted(stated.keys() - {f.name for f in fields(cls)}):
            raise PoserError(f"TrackerSettings: no setting {', '.join(odd)}")
        return cls(**stated)

    def __post_init__(self) -> None:
        checked.settings(
            self,
            positive=POSITIVE,
            infinite=("horizon_memory_s", "valley_s", "deviations_s"),
            free=("network_sigma_deg", "network_scale"),
            error=PoserError,
        )
        for name in ("network_sigma_deg", "network_scale"):
            value = getattr(self, name)
            for one in value if isinstance(value, tuple) else (value,):
                checked.number(one, f"TrackerSettings: {name}", above=0, error=PoserError)
            if isinstance(value, tuple) and len(value) != 24:
                raise PoserError(f"TrackerSettings: {name} needs 24 values, got {len(value)}")
        if self.budget_s is not None:
            checked.number(self.budget_s, "TrackerSettings: budget_s", above=0, error=PoserError)
        if self.lag is not None and (self.lag < 0 or not self.horizon_s):
            raise PoserError(
                "TrackerSettings: lag must be zero or more, and needs a window (horizon_s)"
            )
        if not self.network_floor_deg <= self.network_ceiling_deg <= 180:
            raise PoserError("TrackerSettings: network_ceiling_deg must lie between floor and 180")
