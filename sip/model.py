"""What the cost is made of: the parts that stay, built once, and the evidence of some frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mocap.orientation import Array
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip import kinematics as kin
from sip.belief import FrameBeliefs
from sip.sensor_kinematics import SensorKinematics
from sip.settings import Settings
from sip.soles import Soles, standing
from sip.solvers.band import Band
from sip.terms.acceleration import Acceleration
from sip.terms.anthropometric import Limits, PosePrior
from sip.terms.base import CONSTANTS, Point, Term
from sip.terms.calibration import SensorConstants
from sip.terms.contact import Contact
from sip.terms.network import NetworkPose
from sip.terms.orientation import Orientation
from sip.terms.smoothness import Gauge, LinearSmoothness, RootSmoothness

_MEASURED = ("R", "acc", "ori_valid", "acc_valid")


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of some frames: time is the first axis of every part.

    R (T,S,3,3) and acc (T,S,3) m/s^2 as measured, the identity and zero where invalid; ori_valid, acc_valid
    (T,S). belief: what a network says of the poses, or None. stands: (T,P) belief that each point of the
    soles stands until the next frame, or None.
    """

    R: Array
    acc: Array
    ori_valid: NDArray[np.bool_]
    acc_valid: NDArray[np.bool_]
    belief: FrameBeliefs | None = None
    stands: Array | None = None

    @classmethod
    def of(cls, recording: Recording, belief: FrameBeliefs | None = None) -> Self:
        """That of a recording."""
        ok, moves = recording.ori_valid, recording.acc_valid
        R = np.where(ok[..., None, None], recording.R_world_bone, np.eye(3))
        return cls(R, np.where(moves[..., None], recording.acc_world, 0.0), ok, moves, belief)

    @classmethod
    def blank(cls, frames: int, sensors: int) -> Self:
        """Frames in which nothing was measured."""
        R = np.tile(np.eye(3), (frames, sensors, 1, 1))
        none = np.zeros((frames, sensors), bool)
        return cls(R, np.zeros((frames, sensors, 3)), none, none)

    def __len__(self) -> int:
        return len(self.R)

    def slice(self, start: int, stop: int) -> Self:
        """Frames start to stop-1."""
        cut = slice(start, stop)
        belief, stands = self.belief, self.stands
        return replace(
            self,
            **{name: getattr(self, name)[cut] for name in _MEASURED},
            belief=belief and belief.slice(start, stop),
            stands=None if stands is None else stands[cut],
        )

    def then(self, other: Self) -> Self:
        """These frames and those; what both have."""
        belief, stands = self.belief, self.stands
        both = belief is not None and other.belief is not None
        return replace(
            self,
            **{n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in _MEASURED},
            belief=belief.then(other.belief) if both else None,  # type: ignore[union-attr, arg-type]
            stands=None
            if stands is None or other.stands is None
            else np.concatenate([stands, other.stands]),
        )


class Model:
    """A body with sensors under settings, at a rate: all of the cost that no measurement is in.

    CasADi functions and the terms that hold for any frames are made here, once; `terms` adds those of some
    evidence, which is cheap. listening: whether a network's poses are part of it.
    anchored: whether every frame is drawn, ever so lightly, to the origin, so that a whole path has a place.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        settings: Settings,
        kinematics: SensorKinematics,
        rate_hz: float,
        listening: bool = False,
        anchored: bool = True,
    ):
        self.skeleton, self.settings, self.kinematics = skeleton, settings, kinematics
        self.rate_hz, self.listening = rate_hz, listening
        self.prior = settings.prior.given(kinematics.active, settings.prior_floor)
        s = settings
        self.body: list[Term] = [Gauge(s.sigma_gauge)] if anchored else []
        self._constant: dict[tuple[int, int], tuple[list[Term], Band]] = {}
        if (weight := s.static_weight(listening)) > 0:
            mean, covariance = self.prior.mean, self.prior.covariance
            self.body.append(PosePrior(mean, covariance, s.prior_floor, weight))
        if s.sigma_limits > 0:
            self.body.append(Limits(self.prior.lower, self.prior.upper, s.sigma_limits))
        if order := s.smooth_order:
            angles = s.smooth_angle * self.prior.roughness
            place = np.full(3, s.smooth_position)
            self.body += [
                LinearSmoothness("smoothness", kin.BODY, order, angles, rate_hz),
                LinearSmoothness("smoothness", kin.ROOT_P, order, place, rate_hz),
                RootSmoothness(order, s.smooth_root, rate_hz),
            ]

    def constant(self, frames: int, reach: int) -> tuple[list[Term], Band]:
        """The terms here whose Gauss-Newton matrix is the same everywhere, and it; not to be written to."""
        if (frames, reach) not in self._constant:
            terms = [t for t in self.body if t.constant and t.reach < frames]
            band = Band.zeros(frames, reach, self.kinematics.n, self.border)
            nothing = np.zeros(0)
            blank = Point(np.zeros((frames, self.kinematics.n)), *[nothing] * 4)
            for term in terms:
                term.hessian(blank, band)
            self._constant[frames, reach] = terms, band
        return self._constant[frames, reach]

    @cached_property
    def soles(self) -> Soles:
        """The points that may stand."""
        return Soles(self.skeleton, self.kinematics.active, self.prior)

    @property
    def has_contact(self) -> bool:
        """Whether feet that stand are part of the cost."""
        return bool(np.isfinite(self.settings.sigma_contact)) and self.soles.P > 0

    def standing(self, x: Array, R_ref: Array) -> Array:
        """(T,P): what stands in these poses until the next frame; zero in the last."""
        s, q = self.settings, self.soles.places(x, R_ref)
        belief = standing(q, x, self.rate_hz, s.contact_height, s.contact_speed)
        return np.concatenate([belief, np.zeros((1, self.soles.P))])

    @property
    def border(self) -> int:
        """Number of unknowns that live through all frames."""
        return CONSTANTS * self.kinematics.S if self.settings.self_calibration else 0

    @property
    def constants_sigma(self) -> Array:
        """(7,) of a sensor's constants, as they count against the evidence of frames that err alike."""
        s = self.settings
        sigma = np.r_[[s.sigma_mounting] * 3, s.sigma_heading, [s.sigma_bias] * 3]
        return sigma / np.sqrt(overcount(self.rate_hz, s))

    def frame_terms(self, evidence: Evidence, reach: int | None = None) -> list[Term]:
        """The terms of these frames, or those of one reach, without those on the sensors' constants alone."""
        s, calibrating = self.settings, self.settings.self_calibration

        def wanted(r: int) -> bool:
            return r < len(evidence) and reach in (None, r)

        terms: list[Term] = []
        if wanted(0):
            terms.append(Orientation(s.sigma_orientation, evidence.ori_valid, calibrating))
        if s.terms == "sip" and wanted(Acceleration.reach):
            # A bias lies in the sensor's frame: without an orientation nothing is known of it.
            R = np.where(evidence.ori_valid[..., None, None], evidence.R, 0.0)
            sigma, delta = s.sigma_acceleration, s.robust_delta
            moving = evidence.acc, R, evidence.acc_valid, calibrating
            terms.append(Acceleration(sigma, delta, self.rate_hz, *moving))
        terms += [t for t in self.body if wanted(t.reach)]
        if evidence.belief is not None and wanted(0):
            terms.append(NetworkPose(evidence.belief))
        if evidence.stands is not None and wanted(Contact.reach):
            stands = evidence.stands[:-1]
            terms.append(Contact(self.soles, stands, s.sigma_contact, self.rate_hz))
        return terms

    def terms(self, evidence: Evidence) -> list[Term]:
        """All terms of these frames."""
        constants = [SensorConstants(self.constants_sigma)] if self.border else []
        return [*self.frame_terms(evidence), *constants]


def overcount(rate_hz: float, settings: Settings) -> float:
    """How many frames count as one piece of evidence on the sensors' constants."""
    return max(1.0, rate_hz * settings.correlation_s)
